"""The index that the writer of a log puts behind its records: where each lies, what the figures say of them."""

import struct
import zlib
from io import BytesIO
from itertools import accumulate
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    MessageIndex,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from hil.record.encode import Messages
from hil.record.mcap_file import MAGIC, McapFile
from hil.record.recorder import Recorder
from tools.fuzz import container

CHUNKS = (
    ((7, 500, 3), (300, 420, 0), (7, 440, 9), (2, 910, 5), (300, 600, 1), (300, 430, 2), (7, 431, 40)),
    ((2, 310, 4),),
    ((300, 315, 2), (2, 305, 7), (300, 330, 1)),
    ((7, 650, 1), (300, 640, 6), (7, 620, 3)),
    ((300, 700, 2),),
)
"""Channel, time in ns and bytes of data of each message."""
MESSAGES = {2: 3, 7: 5, 300: 7}
TIMES = [(420, 910), (310, 310), (305, 330), (620, 650), (700, 700)]
ATTACHMENTS = (("a.yaml", b"a: 1\n", 11, "text/yaml"), ("other.dbc", b"VERSION", 23, "text/plain"))
METADATA = ("one", "the second", "3", "fourth")


def message(channel, time, size):
    return struct.pack("<BQHIQQ", 5, 22 + size, channel, 0, time, time) + bytes(size)


def arrays(chunk):
    """The records of a chunk, and channel, time and offset of each."""
    data = [message(*each) for each in chunk]
    offset = np.array(list(accumulate(map(len, data), initial=0))[:-1], np.int64)
    columns = (np.array([each[k] for each in chunk], np.int64) for k in (0, 1))
    return b"".join(data), *columns, offset


def describe(file, channels):
    file.add_schema(Schema(id=3, name="s", encoding="", data=b"schema"))
    for number in channels:
        file.add_channel(
            Channel(id=number, topic=f"/{number}", message_encoding="", metadata={}, schema_id=3)
        )


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A whole file."""
    path = tmp_path_factory.mktemp("index") / "a.mcap"
    file = McapFile(path, "a test")
    describe(file, MESSAGES)
    for chunk, name in zip(CHUNKS, (*METADATA, ""), strict=True):
        file.add_chunk(*arrays(chunk))
        if name:
            file.add_metadata(name, {"k": name * 3})
    for name, content, time, kind in ATTACHMENTS:
        file.add_attachment(name, content, time, kind)
    file.finish()
    return path.read_bytes()


def placed(data):
    """Place, opcode and content of each record."""
    parts = container.split(data)
    starts = accumulate((9 + len(content) for _, content in parts), initial=len(MAGIC))
    return [(at, opcode, content) for at, (opcode, content) in zip(starts, parts, strict=False)]


def read(data, kind):
    """Return the records of a kind, as the mcap library reads them."""
    opcode = KINDS[kind]
    return [kind.read(ReadDataStream(BytesIO(body))) for _, found, body in placed(data) if found == opcode]


KINDS = {
    AttachmentIndex: Opcode.ATTACHMENT_INDEX,
    Chunk: Opcode.CHUNK,
    ChunkIndex: Opcode.CHUNK_INDEX,
    MetadataIndex: Opcode.METADATA_INDEX,
    Statistics: Opcode.STATISTICS,
    SummaryOffset: Opcode.SUMMARY_OFFSET,
}


def indexes_behind(data):
    """Return the message indexes behind each chunk: place, channel, entries and bytes of each."""
    found: list[list[tuple[int, int, list[tuple[int, int]], int]]] = []
    for at, opcode, content in placed(data):
        if opcode == Opcode.CHUNK:
            found.append([])
        elif opcode == Opcode.MESSAGE_INDEX:
            index = MessageIndex.read(ReadDataStream(BytesIO(content)))
            found[-1].append((at, index.channel_id, index.records, 9 + len(content)))
    return found


# -- places --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("opcode", "index", "place"),
    [
        (Opcode.CHUNK, ChunkIndex, lambda i: (i.chunk_start_offset, i.chunk_length)),
        (Opcode.ATTACHMENT, AttachmentIndex, lambda i: (i.offset, i.length)),
        (Opcode.METADATA, MetadataIndex, lambda i: (i.offset, i.length)),
    ],
    ids=["chunk", "attachment", "metadata"],
)
def test_the_index_names_the_place_and_the_length_of_each_record(data, opcode, index, place):
    there = [(at, 9 + len(content)) for at, kind, content in placed(data) if kind == opcode]
    assert [place(each) for each in read(data, index)] == there != []


def test_each_message_of_a_chunk_is_indexed_by_its_time_and_its_place_under_its_channel(data):
    for chunk, found in zip(CHUNKS, indexes_behind(data), strict=True):
        starts = list(accumulate((31 + size for _, _, size in chunk), initial=0))
        wanted: dict[int, list[tuple[int, int]]] = {}
        for (channel, time, _), start in zip(chunk, starts, strict=False):
            wanted.setdefault(channel, []).append((time, start))
        assert {channel: entries for _, channel, entries, _ in found} == wanted
        assert len(found) == len(wanted)


def test_the_index_of_a_chunk_names_where_the_messages_of_each_channel_are_indexed(data):
    for index, found in zip(read(data, ChunkIndex), indexes_behind(data), strict=True):
        assert index.message_index_offsets == {channel: at for at, channel, _, _ in found}
        assert index.message_index_length == sum(size for *_, size in found)


def test_the_end_names_where_the_records_of_each_kind_of_the_index_lie(data):
    summary, offsets, _ = struct.unpack_from("<QQI", data, len(data) - len(MAGIC) - 20)
    groups = read(data, SummaryOffset)
    assert len(groups) == 6
    at = summary
    for group in groups:
        inside = container.split(data[at : at + group.group_length])
        assert (group.group_start, {kind for kind, _ in inside}) == (at, {group.group_opcode})
        at += group.group_length
    assert at == offsets == next(at for at, opcode, _ in placed(data) if opcode == Opcode.SUMMARY_OFFSET)
    assert data[summary - 13 : summary - 4] == struct.pack("<BQ", Opcode.DATA_END, 4)


def test_schemas_and_channels_stand_in_the_index_as_they_stand_before_the_messages(data):
    kinds = [(opcode, content) for _, opcode, content in placed(data)]
    described = [each for each in kinds if each[0] in {Opcode.SCHEMA, Opcode.CHANNEL}]
    assert described[:4] == described[4:]
    assert [opcode for opcode, _ in described[4:]] == [Opcode.SCHEMA, *[Opcode.CHANNEL] * 3]


# -- figures -------------------------------------------------------------------------------------------------


def test_the_figures_at_the_end_count_the_records_of_each_kind_and_the_messages_of_each_channel(data):
    (found,) = read(data, Statistics)
    assert found == Statistics(
        attachment_count=2, channel_count=3, channel_message_counts=MESSAGES, chunk_count=5,
        message_count=15, message_end_time=910, message_start_time=305, metadata_count=4, schema_count=1,
    )  # fmt: skip


def test_a_chunk_and_its_index_name_its_earliest_and_its_latest_time_wherever_they_lie_in_it(data):
    for kind in (Chunk, ChunkIndex):
        assert [(each.message_start_time, each.message_end_time) for each in read(data, kind)] == TIMES


def test_the_index_of_a_chunk_has_its_sizes_packed_and_unpacked(data):
    for index, chunk, messages in zip(read(data, ChunkIndex), read(data, Chunk), CHUNKS, strict=True):
        unpacked = sum(31 + size for _, _, size in messages)
        assert (index.uncompressed_size, chunk.uncompressed_size) == (unpacked, unpacked)
        assert (index.compressed_size, index.compression) == (len(chunk.data), "zstd")


def test_the_index_of_an_attachment_has_its_time_its_size_and_its_kind(data):
    found = [
        (i.name, i.data_size, i.log_time, i.create_time, i.media_type) for i in read(data, AttachmentIndex)
    ]
    assert found == [(name, len(text), time, time, kind) for name, text, time, kind in ATTACHMENTS]
    assert [index.name for index in read(data, MetadataIndex)] == list(METADATA)


def test_checksums_stand_over_the_messages_of_a_chunk_over_the_data_and_over_the_index(data):
    for chunk, messages in zip(read(data, Chunk), CHUNKS, strict=True):
        assert chunk.uncompressed_crc == zlib.crc32(b"".join(message(*each) for each in messages))
    summary, _, crc = struct.unpack_from("<QQI", data, len(data) - len(MAGIC) - 20)
    assert crc == zlib.crc32(data[summary : len(data) - len(MAGIC) - 4])
    (data_crc,) = struct.unpack_from("<I", data, summary - 4)
    assert data_crc == zlib.crc32(data[: summary - 13])


# -- borders -------------------------------------------------------------------------------------------------


def ended(path, *chunks):
    """Return the figures of a file with these chunks, each with the messages that are indexed of it."""
    file = McapFile(path, "a test")
    describe(file, [4])
    for chunk, times in chunks:
        columns = np.array([[4, time, 31 * k] for k, time in enumerate(times)], np.int64).reshape(-1, 3)
        file.add_compressed(chunk, *columns.T)
    file.finish()
    (found,) = read(path.read_bytes(), Statistics)
    return found


def plain(start, end):
    return Chunk(
        compression="", data=b"", message_start_time=start, message_end_time=end, uncompressed_crc=0,
        uncompressed_size=0,
    )  # fmt: skip


def test_a_file_without_a_message_has_the_times_zero(tmp_path):
    for k in range(2):
        found = ended(tmp_path / f"{k}.mcap", *[(plain(5, 7), [])] * k)
        assert (found.message_start_time, found.message_end_time, found.message_count) == (0, 0, 0)
        assert (found.chunk_count, found.channel_message_counts) == (k, {})


@pytest.mark.parametrize(("start", "end"), [(0, 0), (0, 2**63), (2**64 - 1, 2**64 - 1)])
def test_times_may_be_the_first_and_the_last_that_the_format_has(tmp_path, start, end):
    found = ended(tmp_path / "a.mcap", (plain(start, end), [8]))
    assert (found.message_start_time, found.message_end_time) == (start, end)


def test_a_chunk_without_a_message_leaves_the_times_as_they_are(tmp_path):
    found = ended(tmp_path / "a.mcap", (plain(50, 60), [50, 60]), (plain(1, 99), []), (plain(55, 58), [56]))
    assert (found.message_start_time, found.message_end_time) == (50, 60)
    assert (found.message_count, found.chunk_count) == (3, 3)


@pytest.mark.parametrize(("more", "chunks"), [(0, 1), (1, 2)])
def test_messages_of_256_KiB_are_one_chunk_and_those_of_a_byte_more_are_two(more, chunks):
    found: list[int] = []
    recorder: Any = Recorder.__new__(Recorder)
    recorder.file = SimpleNamespace(add_chunk=lambda data, *_: found.append(len(data)))
    start = np.append(32 * 1024 * np.arange(8), 256 * 1024 + more)
    tick = np.arange(8)
    recorder._write(Messages(np.zeros(start[-1], np.uint8), start, tick, tick, tick))
    assert (len(found), sum(found)) == (chunks, 256 * 1024 + more)
