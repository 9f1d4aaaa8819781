"""A complete log restores the recorded data; a cut, reordered or foreign one is refused or read partially."""

import struct
import tracemalloc

import numpy as np
import pytest
from mcap.records import Attachment
from mcap.writer import CompressionType, Writer

from drivers.errors import LogError
from drivers.protocol import Frame, Received
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record.log import Log, LogStatistics, Tick
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.salvage import salvage
from tests.hil.rewrite import mcap_summary, rewrite_log
from tests.hil.samples import assert_same, log_of, random_rows, random_ticks, record
from tools.fuzz import container

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


def test_configuration_metadata_attachments_events_and_summary_are_read(path):
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
    ],
    ids=str,
)
def test_ticks_and_rows_are_restored_to_the_bit_from_any_writer(path, tmp_path, options):
    """options: None for a log of our recorder, else for the writer of the mcap library."""
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


def test_reading_in_blocks_needs_memory_for_one_block_only(tmp_path):
    count = 10_000
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


@pytest.mark.parametrize("fraction", [0.15, 0.5, 0.98])
def test_truncated_log_gives_the_same_data_as_its_salvaged_copy(path, tmp_path, fraction):
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
    assert log.summary.duration_s == pytest.approx(1e-9 * (t_ns[-1] - t_ns[0]), abs=2e-3), "of all chunks"
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


def test_missing_empty_foreign_and_truncated_log_files_are_refused(path, tmp_path):
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


def test_damaged_chunk_of_a_log_is_reported_with_its_place(path, tmp_path):
    index = mcap_summary(path).chunk_indexes[1]
    content = bytearray(path.read_bytes())
    content[index.chunk_start_offset + index.chunk_length // 2] ^= 0x10
    (tmp_path / "bad.mcap").write_bytes(content)
    with pytest.raises(LogError, match=f"damaged at byte {index.chunk_start_offset}"):
        list(Log.open(tmp_path / "bad.mcap").ticks())


# -- other chunks and cuts --------------------------------------------------------------------------------------

PIECES = 300
TIMES = (1_999_999_999, 2_000_000_000, 3_000_000_000, 2_000_000_000, 3_000_000_000, 3_500_000_000)
"""t_ns of the frames received in tick 0, in the order of the log."""


class Parts:
    """Parts of a log: records before and after its messages, its rows and its frames."""

    def __init__(self, path):
        parts = container.split(path.read_bytes())
        kinds = [kind for kind, _ in parts]
        first = kinds.index(container.CHUNK)
        self.head, self.chunk = parts[:first], parts[first][1]
        self.tail = [
            part for part in parts[first:] if part[0] not in {container.CHUNK, container.MESSAGE_INDEX}
        ]
        inside = [
            each
            for kind, content in parts
            if kind == container.CHUNK
            for each in container.split(container.unpacked(content))
        ]
        channels = [content[:2] for _, content in inside]
        self.rows, self.frames = (
            [each for each, channel in zip(inside, channels, strict=True) if channel == wanted]
            for wanted in channels[:2]
        )

    def write(self, path, *records):
        """Write a complete log with these records between head and tail; return its path."""
        path.write_bytes(container.whole([*self.head, *records, *self.tail]))
        return path

    def packed(self, messages):
        return container.CHUNK, container.packed(self.chunk, container.joined(messages))

    def cut(self, path, messages, left_out):
        """Write a log cut `left_out` bytes before the end of an uncompressed chunk."""
        inside = container.joined(messages)
        content = struct.pack("<QQQIIQ", 0, 1, len(inside), 0, 0, len(inside)) + inside
        whole = MAGIC + container.joined([*self.head, (container.CHUNK, content)])
        path.write_bytes(whole[: len(whole) - left_out])
        return path


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Parts of a log with one sent frame in each tick; its identifier is the tick number plus 1."""
    rows = random_rows(PIECES)
    ticks = [Tick(row, (), (Frame(k + 1, b"", 0),), (), (), ()) for k, row in enumerate(rows)]
    return Parts(log_of(ticks, tmp_path_factory))


@pytest.fixture(scope="module")
def received(tmp_path_factory):
    """Parts of a log of two ticks; the first has received frames at TIMES, the second none."""
    first, second = random_rows(2)
    frames = tuple(Received(t_ns, Frame(k, b"", 0)) for k, t_ns in enumerate(TIMES))
    ticks = [Tick(first, frames, (), (), (), ()), Tick(second, (), (), (), (), ())]
    return Parts(log_of(ticks, tmp_path_factory))


@pytest.fixture
def chunked(parts, tmp_path):
    """Write the log with its messages in other chunks; return it."""
    return lambda *groups: Log(parts.write(tmp_path / "a.mcap", *map(parts.packed, groups)))


def test_tick_may_continue_in_the_next_chunk(parts, chunked):
    rows, frames = parts.rows, parts.frames
    log = chunked([rows[0], frames[0], rows[1]], [], [frames[1], rows[2]], [frames[2]])
    assert [frame.id for tick in log.ticks() for frame in tick.sent] == [1, 2, 3]
    assert [len(block) for block in log.blocks("tick")] == [2, 1]


READERS = {
    "replay": lambda log: list(log.ticks()),
    "report": lambda log: log.rows("tau"),
    "export": lambda log: list(log.can_frames()),
    "events": lambda log: log.events(),
    "open": lambda log: Log.open(log.path),
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
@pytest.mark.parametrize(
    "order",
    [
        ("r1", "r0"), ("r0", "r0"), ("r0", "f1", "r1"), ("f0", "r0"), ("r0", "f0", "r1", "f0"), ("r0 f0", "r1 f1", "f0"),
        ("r0 f0 r1", "r2 f1"), ("r0", "r2", "r1"),
    ],
    ids=" | ".join,
)  # fmt: skip
def test_log_out_of_order_is_refused_by_every_reader(parts, chunked, order, read):
    """r0: the row of tick 0, f0: its frame; each group is a chunk."""
    kinds = {"r": parts.rows, "f": parts.frames}
    log = chunked(*([kinds[each[0]][int(each[1])] for each in chunk.split()] for chunk in order))
    with pytest.raises(
        LogError, match=r"a\.mcap: its messages are not in the order of a recorder, near tick \d"
    ):
        read(log)


def test_log_sorted_by_time_is_refused(path, tmp_path):
    rewrite_log(path, tmp_path / "b.mcap", log_time_order=True)
    with pytest.raises(LogError, match="not in the order of a recorder"):
        Log.open(tmp_path / "b.mcap")


def test_second_attachment_of_the_same_name_is_ignored(path, tmp_path):
    """`mcap add attachment` puts it after the messages."""
    records = container.split(path.read_bytes())
    at = [kind for kind, _ in records].index(container.DATA_END)
    other = Attachment(log_time=0, create_time=0, name="config.yaml", media_type="", data=b"other: 1")
    records.insert(at, (container.ATTACHMENT, record_bytes(other)[9:]))
    (tmp_path / "b.mcap").write_bytes(container.whole(records))
    assert Log.open(tmp_path / "b.mcap").configuration == CONFIGURATION


@pytest.mark.parametrize("first", [0, 40])
def test_time_span_to_read_is_measured_from_the_first_row_of_the_log(parts, chunked, first):
    """The first recorded row is at 12 345 ns; one row each ms."""
    log = chunked(parts.rows[first : first + 9], parts.rows[first + 9 : first + 12])
    for span, ticks in (
        ({"start_s": 1e-5}, range(first + 1, first + 12)),
        ({"start_s": -1e-5}, range(first, first + 12)),
        ({"stop_s": 0.003 - 1e-5}, range(first, first + 3)),
        ({"stop_s": 0.0}, range(first, first + 1)),
        ({"stop_s": -1e-5}, range(0)),
        ({"start_s": 0.002, "stop_s": 0.003 + 1e-5}, range(first + 2, first + 4)),
    ):
        assert log.rows("tick", **span)["tick"].tolist() == list(ticks)
        assert [int(t) for block in log.blocks("tick", **span) for t in block["tick"]] == list(ticks)


def test_frames_of_several_chunks_are_sorted_by_time_then_place(received, tmp_path):
    groups = (received.rows[:1] + received.frames[:3], received.frames[3:] + received.rows[1:])
    log = Log(received.write(tmp_path / "a.mcap", *map(received.packed, groups)))
    found = [(frame.t_ns, frame.id) for frame in log.can_frames()]
    assert found == [(TIMES[k], k) for k in (0, 1, 3, 2, 4, 5)]


@pytest.mark.parametrize(("left_out", "ticks"), [(1, 4), (60, 4), (400, 3)])
def test_truncated_chunk_gives_all_ticks_but_the_last_incomplete_one(parts, tmp_path, left_out, ticks):
    """The frame of the fifth tick is cut off, or a part of its row."""
    inside = [each for pair in zip(parts.rows[:5], parts.frames[:5], strict=True) for each in pair]
    log = Log(parts.cut(tmp_path / "a.mcap", inside, left_out))
    found = list(log.ticks())
    assert [int(tick.row["tick"]) for tick in found] == list(range(ticks))
    assert [frame.id for frame in log.can_frames()] == list(range(1, ticks + 1))
    assert log.summary._replace(duration_s=0.0) == LogStatistics(ticks, ticks, 0.0, 0, "cut")
    assert log.summary.duration_s == pytest.approx((ticks - 1) * 1e-3)
