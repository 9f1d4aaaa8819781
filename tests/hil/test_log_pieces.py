"""Messages that another program has moved come in their order or are refused; of a cut chunk, whole ticks count."""

import struct

import pytest

from drivers.errors import LogError
from drivers.protocol import Frame, Received
from hil.record.log import Log, LogStatistics, Tick
from hil.record.mcap_file import MAGIC
from tests.hil.samples import log_of, random_rows
from tools.fuzz import container

COUNT = 300
TIMES = (1_999_999_999, 2_000_000_000, 3_000_000_000, 2_000_000_000, 3_000_000_000, 3_500_000_000)
"""t_ns of the frames that tick 0 has received, in the order of the log."""


class Parts:
    """A log taken apart: what stands before its messages and behind them, its rows and its frames."""

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
        """Write a whole log of these records between head and tail; return its path."""
        path.write_bytes(container.whole([*self.head, *records, *self.tail]))
        return path

    def packed(self, messages):
        return container.CHUNK, container.packed(self.chunk, container.joined(messages))

    def cut(self, path, messages, left_out):
        """Write a log that is cut `left_out` bytes before the end of a chunk without compression."""
        inside = container.joined(messages)
        content = struct.pack("<QQQIIQ", 0, 1, len(inside), 0, 0, len(inside)) + inside
        whole = MAGIC + container.joined([*self.head, (container.CHUNK, content)])
        path.write_bytes(whole[: len(whole) - left_out])
        return path


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Of a log whose every tick has sent one frame, its identifier one more than the number of the tick."""
    rows = random_rows(COUNT)
    ticks = [Tick(row, (), (Frame(k + 1, b"", 0),), (), (), ()) for k, row in enumerate(rows)]
    return Parts(log_of(ticks, tmp_path_factory))


@pytest.fixture(scope="module")
def received(tmp_path_factory):
    """Of a log whose first tick has received frames at TIMES, its second one none."""
    first, second = random_rows(2)
    frames = tuple(Received(t_ns, Frame(k, b"", 0)) for k, t_ns in enumerate(TIMES))
    ticks = [Tick(first, frames, (), (), (), ()), Tick(second, (), (), (), (), ())]
    return Parts(log_of(ticks, tmp_path_factory))


@pytest.fixture
def chunked(parts, tmp_path):
    """Write the log with its messages in other chunks; return it."""
    return lambda *groups: Log(parts.write(tmp_path / "a.mcap", *map(parts.packed, groups)))


@pytest.mark.parametrize("read", ["ticks", "blocks"])
def test_a_row_may_come_64_ticks_late_and_no_later(parts, chunked, read):
    def late(tick):
        first = [row for k, row in enumerate(parts.rows[:257]) if k != tick]
        return chunked(first, [parts.rows[tick], *parts.rows[257:]])

    log = late(192)
    assert [int(tick.row["tick"]) for tick in log.ticks()] == list(range(COUNT))
    assert [int(t) for block in log.blocks("tick") for t in block["tick"]] == list(range(COUNT))
    with pytest.raises(LogError, match="messages stand more than 64 ticks out of order"):
        list(getattr(late(191), read)())


def test_a_frame_may_come_in_a_later_chunk_than_its_tick(parts, chunked):
    def late(tick):
        frames = [frame for k, frame in enumerate(parts.frames) if k != tick]
        return chunked(
            [*parts.rows[:256], *frames[:250]], [parts.frames[tick], *frames[250:], *parts.rows[256:]]
        )

    assert [frame.id for tick in late(192).ticks() for frame in tick.sent] == list(range(1, COUNT + 1))
    with pytest.raises(LogError, match="out of order"):
        list(late(191).ticks())


@pytest.mark.parametrize("order", [[3, 2, 1, 0], [0, 3, 3, 1], [2, 2, 1, 1]])
def test_rows_come_in_tick_order_wherever_they_stand(parts, chunked, order):
    log = chunked(*([parts.rows[k]] for k in order))
    assert log.rows("tick", "q")["tick"].tolist() == sorted(order)
    assert [int(t) for block in log.blocks("tick") for t in block["tick"]] == sorted(order)
    assert [int(tick.row["tick"]) for tick in log.ticks()] == sorted(order)


@pytest.mark.parametrize("first", [0, 40])
def test_a_span_is_measured_from_the_first_row_of_the_log(parts, chunked, first):
    """The first row of all is at 12 345 ns; there is one each ms."""
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


def test_frames_of_several_chunks_come_by_time_then_by_place(received, tmp_path):
    groups = (received.rows, received.frames[:3], received.frames[3:])
    log = Log(received.write(tmp_path / "a.mcap", *map(received.packed, groups)))
    found = [(frame.t_ns, frame.id) for frame in log.can_frames()]
    assert found == [(TIMES[k], k) for k in (0, 1, 3, 2, 4, 5)]


@pytest.mark.parametrize(("left_out", "ticks"), [(1, 4), (60, 4), (400, 3)])
def test_a_cut_chunk_gives_every_tick_but_the_last_begun(parts, tmp_path, left_out, ticks):
    """The frame of the fifth tick is cut off, or some of its row."""
    inside = [each for pair in zip(parts.rows[:5], parts.frames[:5], strict=True) for each in pair]
    log = Log(parts.cut(tmp_path / "a.mcap", inside, left_out))
    found = list(log.ticks())
    assert [int(tick.row["tick"]) for tick in found] == list(range(ticks))
    assert [frame.id for frame in log.can_frames()] == list(range(1, ticks + 1))
    assert log.summary._replace(duration_s=0.0) == LogStatistics(ticks, ticks, 0.0, 0, "cut")
    assert log.summary.duration_s == pytest.approx((ticks - 1) * 1e-3)


def test_a_cut_log_lasts_from_its_earliest_message_to_its_latest(parts, tmp_path):
    groups = parts.rows[5:15], parts.rows[20:30][::-1], parts.rows[:5]
    chunks = [parts.packed(group) for group in groups]
    (tmp_path / "a.mcap").write_bytes(MAGIC + container.joined([*parts.head, *chunks]))
    log = Log(tmp_path / "a.mcap")
    assert (log.summary.ticks, log.summary.closed) == (25, "cut")
    assert log.summary.duration_s == pytest.approx(29e-3)
