"""What the recorder shows of a run: how many ticks wait, the last events, and the end of it."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.protocol import Frame, Received
from drivers.signals import Warn
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record.publish import Publisher
from hil.record.ring import Ring
from hil.record.row import TICKS


class Shown:
    """A mirror that keeps what was written last, and whether it was closed after that."""

    def __init__(self) -> None:
        self.tick, self.waiting, self.closed = -1, -1, False
        self.events: list[tuple[int, str]] = []
        self.told: list[dict[str, Any]] = []
        self.size = 0
        self.figures: dict[str, int] = {}

    def write(self, row, figures, text):
        assert not self.closed
        self.tick, self.waiting = int(row["tick"]), int(figures["waiting"])
        self.figures = {name: int(figures[name]) for name in figures.dtype.names}
        self.told, self.size = json.loads(text), len(text)
        self.events = [(each["number"], each["text"]) for each in self.told]

    def close(self):
        self.closed = True


class Bench:
    """Both ends of a ring, a publisher between them."""

    def __init__(self) -> None:
        self.ring = Ring.create(TICKS.dtype, 256)
        nobody: Any = None
        self.recording = Recording(self.ring, nobody, Path("a.mcap"), lockstep=False)
        self.shown = Shown()
        mirror: Any = self.shown
        self.publisher = Publisher(self.ring, mirror)

    def run(self, ticks, **columns):
        row = np.zeros((), ROW)
        for name, value in columns.items():
            row[name] = value
        for _ in range(ticks):
            row["tick"] = self.recording.ticks
            self.recording.tick(row, (), ())

    def drain(self, limit=256):
        batch = self.ring.take(limit)
        self.publisher.drained(batch)
        self.ring.release(batch)


@pytest.fixture
def bench():
    bench = Bench()
    yield bench
    bench.ring.close_fd()


def test_so_many_ticks_wait_as_were_recorded_and_not_written_yet(bench):
    bench.run(7)
    bench.publisher.publish(0)
    assert (bench.shown.tick, bench.shown.waiting) == (6, 7)
    bench.drain(3)
    bench.publisher.publish(0)
    assert bench.shown.waiting == 4
    bench.run(2)
    bench.publisher.publish(0)
    assert (bench.shown.tick, bench.shown.waiting) == (8, 6)
    bench.drain()
    bench.publisher.publish(0)
    assert bench.shown.waiting == 0


def test_nothing_is_shown_before_the_first_tick(bench):
    bench.publisher.publish(5)
    bench.recording.event(0, "info", "no tick yet")
    bench.drain()
    bench.publisher.publish(5)
    assert bench.shown.tick == -1
    bench.run(1)
    bench.publisher.publish(5)
    assert (bench.shown.tick, bench.shown.events) == (0, [(1, "no tick yet")])
    assert (bench.shown.figures["ticks"], bench.shown.figures["capacity"]) == (1, 256)


@pytest.mark.parametrize("look", [[], [1], [3], [1, 3, 4], [5]], ids=str)
def test_every_tick_is_counted_once_whether_it_was_looked_at_before_it_was_written_or_not(bench, look):
    late = [4_000, 9_000, 2_000, 3_000, 1_000]
    for k, lateness_ns in enumerate(late, start=1):
        bench.run(1, warnings=Warn.STALE, skipped=k, lateness_ns=lateness_ns, compute_ns=10 * lateness_ns)
        if k in look:
            bench.publisher.publish(0)
    bench.drain(2)
    bench.drain()
    bench.publisher.publish(777)
    figures = bench.shown.figures
    found = [figures[name] for name in ("ticks", "stale", "skipped", "late_ns", "compute_ns", "log_bytes")]
    assert found == [5, 5, 15, 9_000, 90_000, 777]


def test_of_many_events_the_last_ones_are_shown(bench):
    count = 40 + 25
    for k in range(count):
        bench.recording.event(k, "info", f"event {k}")
        bench.run(1)
        if k % 10 == 9:
            bench.drain()
    bench.drain()
    bench.publisher.publish(0)
    assert bench.shown.events == [(k + 1, f"event {k}") for k in range(count - 40, count)]


def test_events_of_several_pieces_that_follow_each_other_are_shown_each_with_its_own_text(bench):
    """Frames stand before and behind them, and what a piece carries is 64 bytes."""
    texts = ["a" * 64 + "b" * 64 + "c", "d" * 130, "short", "", "e" * 128, "f"]
    row, frame = np.zeros((), ROW), Received(0, Frame(0x701, b"\x05", 0))
    for k in range(3):
        bench.recording.tick(row, [frame] * k, ())
        for text in texts:
            bench.recording.event(7, "info", text)
    bench.recording.tick(row, [frame], ())
    bench.drain()
    bench.publisher.publish(0)
    assert bench.shown.events == list(enumerate(3 * texts, start=1))


def test_the_end_of_a_run_is_shown_before_its_picture_is_closed(bench):
    bench.run(3)
    bench.publisher.publish(0)
    bench.run(2)
    bench.recording.event(5, "error", "why it ended")
    bench.drain()
    assert (bench.shown.tick, bench.shown.events) == (2, [])
    bench.publisher.close()
    assert (bench.shown.tick, bench.shown.events) == (4, [(1, "why it ended")])
    assert bench.shown.closed


def test_an_event_is_shown_with_its_time_its_level_and_600_signs_of_its_text(bench):
    levels = ["debug", "info", "warning", "error"]
    for k, level in enumerate(levels):
        bench.recording.event(1000 + k, level, "é" * (599 + k))
    bench.run(1)
    batch = bench.ring.take(256)
    of_another_version = np.flatnonzero(batch.items["id"] == 0)[0]
    batch.items["flags"][of_another_version] = 77
    bench.publisher.drained(batch)
    bench.ring.release(batch)
    bench.publisher.publish(0)
    texts = ["é" * 599, "é" * 600, "é" * 600 + " …", "é" * 600 + " …"]
    assert bench.shown.told == [
        {"number": k + 1, "t_ns": 1000 + k, "level": level, "text": text}
        for k, (level, text) in enumerate(zip(["info", *levels[1:]], texts, strict=True))
    ]


@pytest.mark.parametrize("more", [0, 1])
def test_the_oldest_events_go_where_all_that_are_shown_take_more_than_24000_bytes(bench, more):
    """The last one is as long as fits, or a byte longer."""

    def show(*texts):
        for text in texts:
            bench.recording.event(1, "info", text)
        bench.run(1)
        bench.drain()
        bench.publisher.publish(0)

    show(*["\x01" * 500] * 7)
    assert len(bench.shown.told) == 7
    per_event = (bench.shown.size - 2 - 6 * 2) // 7
    room = 24000 - bench.shown.size - 2 - (per_event - 6 * 500)
    show("\x01" * (room // 6) + "x" * (room % 6 + more))
    assert [number for number, _ in bench.shown.events] == list(range(1 + more, 9))
    assert bench.shown.size == (24000 if not more else 24001 - per_event - 2)
    show("one more")
    assert [number for number, _ in bench.shown.events] == list(range(2, 10))


def test_the_largest_delays_are_those_of_the_last_one_to_two_seconds(bench, monkeypatch):
    now = [50 * 10**9]
    monkeypatch.setattr(time, "monotonic_ns", lambda: now[0])
    found = []
    steps = [
        (0, 0, 0),
        (1, 9, 5),
        (10**9 - 1, 4, 7),
        (1, 3, 1),
        (10**9 - 1, 2, 2),
        (2, 1, 8),
        (10**9 + 1, 2, 3),
    ]
    steps += [(10**9 + 1, 0, 0), (10**9 + 1, 0, 0)]
    for after_ns, lateness_ns, compute_ns in steps:
        now[0] += after_ns
        bench.run(1, lateness_ns=lateness_ns, compute_ns=compute_ns)
        bench.publisher.publish(0)
        found.append((bench.shown.figures["late_ns"], bench.shown.figures["compute_ns"]))
        assert bench.shown.figures["seen_ns"] == now[0]
    assert found == [(0, 0), (9, 5), (9, 7), (9, 7), (9, 7), (3, 8), (2, 8), (2, 3), (0, 0)]


def test_rows_that_nobody_looked_at_are_counted_when_they_are_written_and_not_those_of_later(bench):
    """The ring turns before the next look, so what was not counted then would be lost."""
    bench.run(10)
    bench.drain()
    bench.run(10, skipped=1, warnings=Warn.FORCE_LIMIT)
    bench.run(246)
    bench.drain()
    bench.publisher.publish(0)
    figures = bench.shown.figures
    assert (figures["ticks"], figures["skipped"], figures["stale"]) == (266, 10, 0)


def test_ticks_that_were_lost_are_told_and_the_row_shown_is_the_newest_when_the_ring_has_turned(bench):
    bench.run(256)
    bench.drain(200)
    bench.run(200)
    bench.publisher.publish(9)
    assert (bench.shown.tick, bench.shown.waiting, bench.shown.figures["dropped"]) == (455, 256, 0)
    bench.run(3)
    bench.publisher.publish(10)
    assert (bench.shown.tick, bench.shown.figures["dropped"], bench.shown.figures["log_bytes"]) == (
        455,
        3,
        10,
    )
    bench.publisher.close()
    assert (bench.shown.figures["log_bytes"], bench.shown.closed) == (10, True)
