"""Live mirror of the recorder: newest row, counts and delays, last events, and the end."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.signals import Warn
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record.publish import Publisher
from hil.record.ring import Ring
from hil.record.row import TICKS


class Shown:
    """Mirror that keeps the last written piece, and whether it was closed afterwards."""

    def __init__(self) -> None:
        self.tick, self.closed = -1, False
        self.events: list[dict[str, Any]] = []
        self.figures: dict[str, int] = {}

    def write(self, row, figures, text):
        assert not self.closed
        self.tick = int(row["tick"])
        self.figures = {name: int(figures[name]) for name in figures.dtype.names}
        self.events = json.loads(text)

    def close(self):
        self.closed = True


class Bench:
    """Both ends of a ring, with a publisher between them."""

    def __init__(self) -> None:
        self.ring = Ring.create(TICKS.dtype, 256)
        self.ring.close_fd()
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

    def publish(self, *names, log_bytes=0):
        """Publish, and give the newest tick and these figures."""
        self.publisher.publish(log_bytes)
        return self.shown.tick, *(self.shown.figures[name] for name in names)

    def texts(self):
        return [(each["number"], each["text"]) for each in self.shown.events]


@pytest.fixture
def bench():
    return Bench()


def test_recorded_ticks_count_as_waiting_until_they_are_written(bench):
    bench.run(7)
    assert bench.publish("waiting") == (6, 7)
    bench.drain(3)
    assert bench.publish("waiting") == (6, 4)
    bench.run(2)
    assert bench.publish("waiting") == (8, 6)
    bench.drain()
    assert bench.publish("waiting") == (8, 0)


@pytest.mark.parametrize("look", [[], [1], [3], [1, 3, 4], [5]], ids=str)
def test_every_tick_is_counted_once_whenever_the_mirror_is_updated(bench, look):
    for k, lateness_ns in enumerate([4_000, 9_000, 2_000, 3_000, 1_000], start=1):
        bench.run(1, warnings=Warn.STALE, skipped=k, lateness_ns=lateness_ns, compute_ns=10 * lateness_ns)
        if k in look:
            bench.publish()
    bench.drain(2)
    bench.drain()
    names = "ticks", "stale", "skipped", "late_ns", "compute_ns", "log_bytes"
    assert bench.publish(*names, log_bytes=777) == (4, 5, 5, 15, 9_000, 90_000, 777)
    bench.run(10, skipped=1, warnings=Warn.FORCE_LIMIT)
    bench.run(246)
    bench.drain()
    assert bench.publish("ticks", "skipped", "stale") == (260, 261, 25, 5), "the ring wraps between two reads"


def test_dropped_ticks_are_counted_and_the_newest_row_is_shown(bench):
    bench.run(256)
    bench.drain(200)
    bench.run(200)
    assert bench.publish("waiting", "dropped") == (455, 256, 0)
    bench.run(3)
    assert bench.publish("dropped", "log_bytes", log_bytes=10) == (455, 3, 10)
    bench.publisher.close()
    assert (bench.shown.figures["log_bytes"], bench.shown.closed) == (10, True)


def test_the_largest_delays_cover_the_last_one_to_two_seconds(bench, monkeypatch):
    now = [50 * 10**9]
    monkeypatch.setattr(time, "monotonic_ns", lambda: now[0])
    s = 10**9
    steps = [
        (0, 0, 0), (1, 9, 5), (s - 1, 4, 7), (1, 3, 1), (s - 1, 2, 2), (2, 1, 8), (s + 1, 2, 3), (s + 1, 0, 0), (s + 1, 0, 0),
    ]  # fmt: skip
    found = []
    for after_ns, lateness_ns, compute_ns in steps:
        now[0] += after_ns
        bench.run(1, lateness_ns=lateness_ns, compute_ns=compute_ns)
        found.append(bench.publish("late_ns", "compute_ns")[1:])
        assert bench.shown.figures["seen_ns"] == now[0]
    assert found == [(0, 0), (9, 5), (9, 7), (9, 7), (9, 7), (3, 8), (2, 8), (2, 3), (0, 0)]


def test_only_the_last_40_events_are_shown(bench):
    for k in range(65):
        bench.recording.event(k, "info", f"event {k}")
        bench.run(1)
        if k % 10 == 9:
            bench.drain()
    bench.drain()
    bench.publish()
    assert bench.texts() == [(k + 1, f"event {k}") for k in range(25, 65)]


def test_an_event_is_shown_with_at_most_600_characters_of_its_text(bench):
    levels = ["debug", "info", "warning", "error"]
    for k, level in enumerate(levels):
        bench.recording.event(1000 + k, level, "é" * (599 + k))
    bench.run(1)
    bench.drain()
    bench.publish()
    texts = ["é" * 599, "é" * 600, "é" * 600 + " …", "é" * 600 + " …"]
    assert bench.shown.events == [
        {"number": k + 1, "t_ns": 1000 + k, "level": level, "text": text}
        for k, (level, text) in enumerate(zip(levels, texts, strict=True))
    ]


def test_the_last_row_and_events_are_shown_before_the_mirror_closes(bench):
    bench.run(3)
    bench.publish()
    bench.run(2)
    bench.recording.event(5, "error", "why it ended")
    bench.drain()
    assert (bench.shown.tick, bench.texts()) == (2, [])
    bench.publisher.close()
    assert (bench.shown.tick, bench.texts()) == (4, [(1, "why it ended")])
    assert bench.shown.closed
