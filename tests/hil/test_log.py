import time

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from mcap.writer import CompressionType, Writer

from drivers.errors import LogError
from hil.record import Recording
from hil.record.log import Log
from tests.hil.rewrite import mcap_summary, rewrite_log
from tests.hil.samples import assert_same, random_ticks, record

COUNT = 900
TICKS = random_ticks(COUNT, seed=9)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    with Recording.start(
        path,
        configuration="loop: {rate_Hz: 1000.0}\n",
        attachments=[("legs.dbc", b"VERSION")],
        metadata={"kind": "sim", "seed": 9},
        lockstep=True,
    ) as recording:
        record(recording, TICKS[:500])
        recording.event(17, "warning", "leg 3 is stale")
        record(recording, TICKS[500:])
    return path


def test_ticks_come_back_bit_for_bit(path):
    assert_same(Log.open(path).ticks(), TICKS)


def test_rows_come_back_as_one_array(path):
    rows = Log.open(path).rows()
    assert rows.tobytes() == b"".join(tick.row.tobytes() for tick in TICKS)


def test_configuration_metadata_attachments_events_and_summary(path):
    log = Log.open(path)
    assert log.configuration == "loop: {rate_Hz: 1000.0}\n"
    assert log.attachments["legs.dbc"] == b"VERSION"
    assert (log.metadata["hil"]["kind"], log.metadata["hil"]["seed"]) == ("sim", "9")
    assert log.metadata["environment"]["kernel"]
    assert [tuple(event) for event in log.events()] == [(17, "warning", "leg 3 is stale")]
    assert log.lockstep
    frames = sum(len(tick.received) + len(tick.sent) for tick in TICKS)
    assert (log.summary.ticks, log.summary.frames, log.summary.closed) == (COUNT, frames, "clean")


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4, "chunk_size": 20_000},
        {"compression": CompressionType.NONE},
        {"log_time_order": True},
    ],
    ids=str,
)
def test_a_log_rewritten_by_the_mcap_library_reads_the_same(path, tmp_path, options):
    rewrite_log(path, tmp_path / "b.mcap", **options)
    log = Log.open(tmp_path / "b.mcap")
    assert_same(log.ticks(), TICKS)
    assert log.configuration == "loop: {rate_Hz: 1000.0}\n"


def test_messages_outside_chunks_are_refused(path, tmp_path):
    rewrite_log(path, tmp_path / "b.mcap", use_chunking=False)
    log = Log(tmp_path / "b.mcap")
    for read in (log.rows, log.events, lambda: list(log.ticks())):
        with pytest.raises(LogError, match=r"damaged at byte \d+: a message outside a chunk"):
            read()


def test_one_flipped_bit_in_one_frame_is_the_only_difference(path, tmp_path):
    chosen = next(
        i
        for i, tick in enumerate(TICKS)
        if i > 300 and tick.received and len(tick.received[0].frame.data) > 7
    )
    frame = TICKS[chosen].received[0].frame
    seen: list[int] = []

    def flip(topic, data, sequence):
        if topic != "/can" or sequence != chosen or seen:
            return data
        seen.append(sequence)
        return data.replace(frame.data, bytes([frame.data[0] ^ 1]) + frame.data[1:])

    rewrite_log(path, tmp_path / "b.mcap", flip)
    found = list(Log.open(tmp_path / "b.mcap").ticks())
    assert [i for i, (a, b) in enumerate(zip(found, TICKS, strict=True)) if a.received != b.received] == [
        chosen
    ]
    changed = found[chosen].received[0].frame
    assert changed.data == bytes([frame.data[0] ^ 1]) + frame.data[1:]


def test_missing_empty_foreign_and_cut_files_are_told_apart(path, tmp_path):
    with pytest.raises(LogError, match="no such file"):
        Log.open(tmp_path / "nothing.mcap")
    with pytest.raises(LogError, match="cannot be read"):
        Log.open(tmp_path)
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"")
    with pytest.raises(LogError, match="empty"):
        Log.open(bad)
    bad.write_bytes(b"(0.000000) can0 123#00\n" * 50)
    with pytest.raises(LogError, match="not an MCAP file"):
        Log.open(bad)
    content = path.read_bytes()
    for size in (3, 8, 50, 5000, len(content) // 2, len(content) - 1):
        bad.write_bytes(content[:size])
        with pytest.raises(LogError, match="--salvage"):
            Log.open(bad)
    with bad.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(LogError, match="not a log of this product"):
        Log.open(bad)


def test_a_damaged_chunk_is_reported_with_its_place(path, tmp_path):
    index = mcap_summary(path).chunk_indexes[1]
    content = bytearray(path.read_bytes())
    content[index.chunk_start_offset + index.chunk_length // 2] ^= 0x10
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(content)
    with pytest.raises(LogError, match=f"damaged at byte {index.chunk_start_offset}"):
        list(Log.open(bad).ticks())


def test_an_event_has_the_level_that_its_number_names_and_any_other_is_an_info(tmp_path):
    """Other programs may write 0, 5 and more."""
    with Recording.start(tmp_path / "a.mcap", configuration="", lockstep=True) as recording:
        for k in range(8):
            recording.event(k, "info", str(k))

    def levelled(topic, data, sequence):
        if topic != "/events":
            return data
        message = LogMessage.FromString(data)
        message.level = LogMessage.Level.ValueType(int(message.message))
        return message.SerializeToString()

    rewrite_log(tmp_path / "a.mcap", tmp_path / "b.mcap", levelled)
    levels = ["info", "debug", "info", "warning", "error", "error", "info", "info"]
    assert Log(tmp_path / "b.mcap").events() == [(k, levels[k], str(k)) for k in range(8)]


def test_messages_far_out_of_order_are_refused(path, tmp_path):
    """A tick's frames moved to the end of the file cannot be handed out with their tick."""
    late = []

    def hold(topic, data, sequence):
        if topic == "/can" and 10 <= sequence < 14:
            late.append(data)
            return None
        return data

    rewrite_log(path, tmp_path / "b.mcap", hold)
    assert late

    def swap(topic, data, sequence):
        return late[0] if topic == "/can" and sequence == 800 else data

    rewrite_log(path, tmp_path / "c.mcap", swap)
    with pytest.raises(LogError, match="out of order"):
        list(Log.open(tmp_path / "c.mcap").ticks())


def test_reading_speed_is_reported(path, record_property):
    """Mark: 20 000 ticks a second; asserted ten times lower."""
    begin = time.perf_counter()
    count = sum(1 for _ in Log.open(path).ticks())
    speed = count / (time.perf_counter() - begin)
    record_property("ticks_per_second", speed)
    print(f"{speed:.0f} ticks/s")
    assert speed > 2000
