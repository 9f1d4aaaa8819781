"""Logs rewritten with the mcap library's own reader and writer, and files of MCAP records."""

from itertools import accumulate
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Metadata
from mcap.writer import Writer

from hil.record.mcap_file import MAGIC, record_bytes


def metadata(name, **values):
    return record_bytes(Metadata(name=name, metadata=values))


def placed(tmp_path, *records):
    """File of these records, and the offset of each."""
    starts = list(accumulate(map(len, records), initial=len(MAGIC)))
    file = tmp_path / "records.mcap"
    file.write_bytes(MAGIC + b"".join(records))
    return file, starts


def mcap_summary(path):
    """Summary section of an MCAP file, read by the mcap library."""
    with Path(path).open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    return summary


def rewrite_log(
    src,
    dst,
    edit=lambda topic, data, sequence: data,
    *,
    sequence=lambda topic, number: number,
    log_time_order=False,
    order=iter,
    attached=0,
    end=None,
    **options,
):
    """Copy `src` to `dst`; `edit(topic, data, sequence)` gives the new data, or None to drop a message.

    `sequence(topic, number)` is the new number of a message; `order(messages)` sorts them; `attached` is the
    size of a foreign attachment; `end` changes the summary of the run; `options` go to mcap.writer.Writer (compression, chunk_size, use_chunking).
    """
    with Path(src).open("rb") as source, Path(dst).open("xb") as target:
        reader = make_reader(source, validate_crcs=True)
        writer = Writer(target, **options)
        writer.start()
        for item in reader.iter_attachments():
            writer.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
        if attached:
            writer.add_attachment(0, 0, "video.mp4", "video/mp4", bytes(attached))
        for record in reader.iter_metadata():
            changes = (end or {}) if record.name == "summary" else {}
            writer.add_metadata(record.name, record.metadata | changes)
        schemas, channels = {}, {}
        for schema, channel, message in order(reader.iter_messages(log_time_order=log_time_order)):
            assert schema is not None
            if channel.id not in channels:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            data = edit(channel.topic, message.data, message.sequence)
            if data is not None:
                number = sequence(channel.topic, message.sequence)
                writer.add_message(channels[channel.id], message.log_time, data, message.publish_time, number)
        writer.finish()
