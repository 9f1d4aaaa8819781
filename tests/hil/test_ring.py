"""Ring between loop and recorder: rows and items come out once, in order, whole; fences order the
counters.
"""

import random
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from drivers.frame_array import FRAME
from drivers.frame_array import pack_frame as pack_item
from drivers.protocol import Frame
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record import recording as producer
from hil.record import ring as module
from hil.record.ring import EVENT, EVENTS, READ, READ_ITEMS, SENT, WRITTEN, Ring

DTYPE = np.dtype([("tick", "<i8"), ("t_ns", "<i8"), ("x", "<f8", (3,))])


@pytest.fixture
def ring():
    ring = Ring.create(DTYPE, 256)
    yield ring
    ring.close_fd()


class Writer:
    def __init__(self, ring):
        self.ring, self.rows, self.items = ring, 0, 0

    def item(self, kind, value):
        offset = self.items % self.ring.item_capacity * FRAME.itemsize
        pack_item(self.ring.item_bytes, offset, value, value, kind, 1, 0, b"\x01")
        self.items += 1

    def row(self, items, publish=True):
        for _ in range(items):
            self.item(SENT, self.rows)
        row = np.zeros((), DTYPE)
        row["tick"], row["x"] = self.rows, self.rows
        self.ring.rows[self.rows % self.ring.capacity] = row
        self.ring.ends[self.rows % self.ring.capacity] = self.items
        self.rows += 1
        if publish:
            self.ring.counters[WRITTEN] = self.rows

    def events(self, *values):
        for value in values:
            self.item(EVENT, value)
        self.ring.counters[EVENTS] = self.items


@pytest.fixture
def writer(ring):
    return Writer(ring)


def test_ring_returns_rows_and_items_once_and_in_order_after_wrap_rounds(ring, writer):
    rng = random.Random(3)
    counts, ticks, owners = [], [], []
    while writer.rows < 3000:
        for _ in range(rng.randrange(200)):
            if ring.counters[WRITTEN] - ring.counters[READ] < ring.capacity:
                counts.append(rng.randrange(FRAME.itemsize // 10))
                writer.row(counts[-1])
        batch = ring.take(rng.randrange(1, 220))
        assert (batch.rows["x"] == batch.rows["tick"][:, None]).all()
        assert (batch.items["t_ns"] == batch.rows["tick"][batch.tick]).all()
        ticks += batch.rows["tick"].tolist()
        owners += batch.items["t_ns"].tolist()
        ring.release(batch)
    assert ticks == list(range(len(ticks)))
    assert owners == [tick for tick in ticks for _ in range(counts[tick])]


def test_ring_does_not_return_an_unpublished_tick(ring, writer):
    writer.row(2)
    writer.row(3, publish=False)
    batch = ring.take(100)
    assert (len(batch.rows), len(batch.items)) == (1, 2)


@pytest.mark.parametrize("rows", [0, 1, 3])
@pytest.mark.parametrize("events", [1, 2, 5])
def test_ring_returns_events_after_the_tick_that_precedes_them(ring, writer, rows, events):
    for _ in range(rows):
        writer.row(2)
    writer.events(*range(70, 70 + events))
    batch = ring.take(100)
    assert len(batch.rows) == rows
    assert batch.tick.tolist() == [k for k in range(rows) for _ in range(2)] + [rows] * events
    assert batch.items["t_ns"][2 * rows :].tolist() == [70 + k for k in range(events)]
    ring.release(batch)
    assert not len(ring.take(100).items)
    writer.events(90)
    writer.row(1)
    batch = ring.take(100)
    assert batch.items["t_ns"].tolist() == [90, rows], "before the tick that follows them"
    assert batch.tick.tolist() == [0, 0]


def test_batch_of_the_ring_ends_when_items_fill_a_quarter_of_the_room(ring, writer):
    for items in (1100, 1, 1022, 1, 1):
        writer.row(items)
    sizes = []
    for _ in range(3):
        batch = ring.take(10)
        sizes.append((len(batch.rows), len(batch.items)))
        ring.release(batch)
    assert sizes == [(1, 1100), (3, 1024), (1, 1)]


@pytest.mark.parametrize("turns", [0, 5])
def test_a_batch_is_ready_with_its_rows_or_a_quarter_of_the_items(ring, writer, turns):
    for _ in range(turns):
        for _ in range(100):
            writer.row(9)
        ring.release(ring.take(100))
    for _ in range(7):
        assert not ring.ready(7)
        writer.row(1)
    assert ring.ready(7)
    assert not ring.ready(8)
    ring.release(ring.take(7))
    writer.row(1023)
    assert not ring.ready(2)
    writer.row(1)
    assert ring.ready(3), "rows of 1024 items"
    ring.release(ring.take(2))
    writer.events(*[70] * 1023)
    assert not ring.ready(1)
    writer.events(70)
    assert ring.ready(1), "as many events"


def test_full_ring_returns_all_rows_and_items(ring, writer):
    for _ in range(100):
        writer.row(1)
    ring.release(ring.take(100))
    for _ in range(256):
        writer.row(0)
    for first in (100, 101, 256, 355, 356):
        assert ring.since(first)["tick"].tolist() == list(range(first, 356))
    batch = ring.take(256)
    assert batch.rows["tick"].tolist() == list(range(100, 356))
    ring.release(batch)
    writer.events(*range(4096))
    batch = ring.take(256)
    assert batch.items["t_ns"].tolist() == list(range(4096))
    assert batch.tick.tolist() == [0] * 4096


NAMES = {WRITTEN: "rows", EVENTS: "events", READ: "rows read", READ_ITEMS: "items read"}


class Watched:
    """Counters of a ring that note each access and each fence."""

    def __init__(self, ring, noted, monkeypatch):
        self.counters, self.noted = ring.counters, noted
        ring.counters = self
        for place in (module, producer):
            monkeypatch.setattr(place, "fence", lambda: noted.append("fence"))

    def __getitem__(self, number):
        self.noted.append(f"read {NAMES[number]}")
        return self.counters[number]

    def __setitem__(self, number, value):
        self.noted.append(f"store {NAMES[number]}")
        self.counters[number] = value


def test_producer_and_consumer_of_the_ring_order_counters_and_data_by_memory_fences(monkeypatch):
    """The producer stores a counter after its data; the consumer reads data after their counter."""
    noted: list[str] = []
    ring, nobody = Ring.create(ROW, 256), cast("Any", None)
    ring.close_fd()
    Watched(ring, noted, monkeypatch)

    def steps():
        found, noted[:] = [*noted], []
        return found

    recording = Recording(ring, nobody, Path("a.mcap"), lockstep=False)
    recording.tick(np.zeros((), ROW), (), [Frame(1, b"", 0)])
    assert steps()[-2:] == ["fence", "store rows"]
    recording.event(0, "info", "")
    assert steps()[-2:] == ["fence", "store events"]
    batch = ring.take(5)
    assert steps()[:4] == ["read events", "fence", "read rows", "fence"]
    ring.since(0)
    assert steps() == ["read rows", "fence"]
    ring.release(batch)
    released = steps()
    assert released[0] == "fence"
    assert {each for each in released if each.startswith("store")} == {"store items read", "store rows read"}
