"""A whole log gives back what was recorded; a cut, damaged or foreign one is refused or read as far as it goes."""

import tracemalloc

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from mcap.writer import CompressionType, Writer

from drivers.errors import LogError
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record.log import Log
from hil.record.salvage import salvage
from tests.hil.rewrite import mcap_summary, rewrite_log
from tests.hil.samples import assert_same, random_rows, random_ticks, record

COUNT = 900
TICKS = random_ticks(COUNT, seed=9)
ROWS = np.array([tick.row for tick in TICKS])
CONFIGURATION = "loop: {rate_Hz: 1000.0}\n"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    with Recording.start(
        path,
        configuration=CONFIGURATION,
        attachments=[("legs.dbc", b"VERSION")],
        metadata={"kind": "sim", "seed": 9},
        lockstep=True,
    ) as recording:
        record(recording, TICKS[:500])
        recording.event(17, "warning", "leg 3 is stale")
        record(recording, TICKS[500:])
    return path


def test_configuration_metadata_attachments_events_and_summary(path):
    log = Log.open(path)
    assert log.configuration == CONFIGURATION
    assert log.attachments["legs.dbc"] == b"VERSION"
    assert (log.metadata["hil"]["kind"], log.metadata["hil"]["seed"]) == ("sim", "9")
    assert log.metadata["environment"]["kernel"]
    assert [tuple(event) for event in log.events()] == [(17, "warning", "leg 3 is stale")]
    assert log.lockstep
    assert log.figures()["ticks"] == COUNT
    frames = sum(len(tick.received) + len(tick.sent) for tick in TICKS)
    times = [t_ns for tick in TICKS for t_ns, _ in tick.received] + ROWS["t_ns"].tolist()
    found = log.summary
    assert (found.ticks, found.frames, found.dropped, found.closed) == (COUNT, frames, 0, "clean")
    assert found.duration_s == pytest.approx(1e-9 * (max(times) - min(times)), rel=1e-9)
    index = mcap_summary(path).statistics
    assert index.message_start_time == log.epoch_ns + min(times)
    assert index.message_end_time == log.epoch_ns + max(times)


@pytest.mark.parametrize(
    "options",
    [
        None,
        {},
        {"compression": CompressionType.LZ4, "chunk_size": 20_000},
        {"compression": CompressionType.NONE},
        {"log_time_order": True},
    ],
    ids=str,
)
def test_ticks_and_rows_come_back_bit_for_bit_whoever_wrote_them(path, tmp_path, options):
    """None: as our recorder wrote them; else by the mcap library's own writer."""
    log = Log.open(path)
    if options is not None:
        rewrite_log(path, tmp_path / "b.mcap", **options)
        log = Log.open(tmp_path / "b.mcap")
    assert_same(log.ticks(), TICKS)
    assert log.rows().tobytes() == ROWS.tobytes()
    blocks = list(log.blocks())
    assert len(blocks) > 1
    assert np.concatenate(blocks).tobytes() == ROWS.tobytes()
    chosen = np.concatenate(list(log.blocks("tau", "q")))
    assert chosen.dtype.names == ("tau", "q")
    assert chosen["q"].tobytes() == np.ascontiguousarray(ROWS["q"]).tobytes()
    assert log.configuration == CONFIGURATION


def test_all_frames_come_in_the_order_of_their_times(path):
    expected = []
    for tick in TICKS:
        expected += [(t_ns, False, frame) for t_ns, frame in tick.received]
        expected += [(int(tick.row["t_ns"]), True, frame) for frame in tick.sent]
    expected.sort(key=lambda item: item[0])
    assert [(f.t_ns, f.sent, f.id, f.data, f.flags, f.bus) for f in Log(path).can_frames()] == [
        (t_ns, sent, frame.id, frame.data, frame.flags % 256, frame.bus) for t_ns, sent, frame in expected
    ]


def test_unknown_levels_of_events_are_info(tmp_path):
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


def test_reading_in_pieces_takes_memory_for_a_piece_only(tmp_path):
    count = 20_000
    with Recording.start(tmp_path / "a.mcap", configuration="", lockstep=True) as recording:
        for row in random_rows(count):
            recording.tick(np.asarray(row), (), ())
    log = Log(tmp_path / "a.mcap")
    tracemalloc.start()
    try:
        assert sum(len(block) for block in log.blocks("q")) == count
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.2 * count * ROW.itemsize


@pytest.mark.parametrize("fraction", [0.15, 0.3, 0.5, 0.77, 0.9, 0.98])
def test_a_cut_log_gives_what_a_salvage_gives(path, tmp_path, fraction):
    size = int(path.stat().st_size * fraction)
    bad = tmp_path / "cut.mcap"
    bad.write_bytes(path.read_bytes()[:size])
    log = Log(bad)
    report = salvage(bad, tmp_path / "whole.mcap")
    assert f"cut at {size} bytes" in log.cut
    assert 0 < report.ticks < COUNT
    assert_same(log.ticks(), TICKS[: report.ticks])
    assert log.rows().tobytes() == ROWS[: report.ticks].tobytes()
    assert len(log.frame("q")) == report.ticks
    frames = sum(len(tick.received) + len(tick.sent) for tick in TICKS[: report.ticks])
    assert (log.summary[:2], log.summary.closed) == ((report.ticks, frames), "cut")
    t_ns = log.rows("t_ns")["t_ns"]
    assert log.summary.duration_s == pytest.approx(1e-9 * (t_ns[-1] - t_ns[0]), abs=2e-3), "over all chunks"
    assert log.configuration == CONFIGURATION
    whole = Log(tmp_path / "whole.mcap")
    assert whole.cut == ""
    assert whole.rows().tobytes() == log.rows().tobytes()
    with pytest.raises(LogError, match="--salvage"):
        Log.open(bad)


def test_messages_outside_chunks_are_refused(path, tmp_path):
    rewrite_log(path, tmp_path / "b.mcap", use_chunking=False)
    log = Log(tmp_path / "b.mcap")
    for read in (log.rows, log.events, lambda: list(log.ticks())):
        with pytest.raises(LogError, match=r"damaged at byte \d+: a message outside a chunk"):
            read()


def test_missing_empty_foreign_and_cut_files_are_refused(path, tmp_path):
    with pytest.raises(LogError, match="no such file"):
        Log.open(tmp_path / "nothing.mcap")
    with pytest.raises(LogError, match="cannot be read"):
        Log.open(tmp_path)
    bad = tmp_path / "bad.mcap"
    content = path.read_bytes()
    for data, word in [
        (b"", "empty"),
        (b"(0.000000) can0 123#00\n" * 50, "not an MCAP file"),
        *((content[:size], "--salvage") for size in (3, 8, 50, 5000, len(content) // 2, len(content) - 1)),
    ]:
        bad.write_bytes(data)
        with pytest.raises(LogError, match=word):
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
    (tmp_path / "bad.mcap").write_bytes(content)
    with pytest.raises(LogError, match=f"damaged at byte {index.chunk_start_offset}"):
        list(Log.open(tmp_path / "bad.mcap").ticks())
