import os
import platform
import random
import runpy
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from drivers.frame_array import FRAME
from drivers.frame_array import pack_frame as pack_item
from drivers.protocol import Frame, Received
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record import recording as producer
from hil.record import ring as module
from hil.record.ring import DROPPED, EVENT, EVENTS, READ, READ_ITEMS, SENT, WRITTEN, Ring
from hil.signals import Operator, Order, SetPoint

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


def test_rows_and_their_items_come_out_once_and_in_order_over_many_turns(ring):
    rng = random.Random(3)
    writer = Writer(ring)
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


def test_a_tick_that_is_not_published_is_not_seen(ring):
    writer = Writer(ring)
    writer.row(2)
    writer.row(3, publish=False)
    batch = ring.take(100)
    assert len(batch.rows) == 1
    assert len(batch.items) == 2


def test_events_come_before_the_tick_that_follows_them_and_without_one_after_the_last(ring):
    writer = Writer(ring)
    writer.row(1)
    writer.item(EVENT, 77)
    ring.counters[EVENTS] = writer.items
    batch = ring.take(100)
    assert batch.tick.tolist() == [0, 1]
    ring.release(batch)
    writer.item(EVENT, 78)
    ring.counters[EVENTS] = writer.items
    writer.row(1)
    batch = ring.take(100)
    assert batch.items["t_ns"].tolist() == [78, 1]
    assert batch.tick.tolist() == [0, 0]
    ring.release(batch)
    assert not len(ring.take(100).items)


@pytest.mark.parametrize("rows", [0, 1, 3])
@pytest.mark.parametrize("events", [1, 2, 5])
def test_as_many_events_as_follow_the_last_tick_come_with_its_batch(ring, rows, events):
    writer = Writer(ring)
    for _ in range(rows):
        writer.row(2)
    for k in range(events):
        writer.item(EVENT, 70 + k)
    ring.counters[EVENTS] = writer.items
    batch = ring.take(100)
    assert len(batch.rows) == rows
    assert batch.tick.tolist() == [k for k in range(rows) for _ in range(2)] + [rows] * events
    assert batch.items["t_ns"][2 * rows :].tolist() == [70 + k for k in range(events)]
    ring.release(batch)
    assert not len(ring.take(100).items)


@pytest.mark.parametrize("turns", [0, 5])
def test_a_batch_is_ready_with_so_many_rows_or_a_quarter_of_the_items_however_far_the_ring_has_turned(
    ring, turns
):
    writer = Writer(ring)
    for _ in range(turns):
        for _ in range(100):
            writer.row(9)
        ring.release(ring.take(100))
    assert not ring.ready(1)
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
    for k in range(1024):
        assert not ring.ready(1), k
        writer.item(EVENT, 70)
        ring.counters[EVENTS] = writer.items
    assert ring.ready(1), "as many events"


def test_a_batch_that_leaves_rows_behind_leaves_the_events_behind_them_too(ring):
    writer = Writer(ring)
    for _ in range(3):
        writer.row(1)
    writer.item(EVENT, 77)
    ring.counters[EVENTS] = writer.items
    batch = ring.take(2)
    assert batch.tick.tolist() == [0, 1]
    ring.release(batch)
    batch = ring.take(2)
    assert batch.items["t_ns"].tolist() == [2, 77]
    assert batch.tick.tolist() == [0, 1]


def test_a_batch_ends_with_the_row_whose_items_fill_a_quarter_of_the_room(ring):
    writer = Writer(ring)
    for items in (1100, 1, 1022, 1, 1):
        writer.row(items)
    sizes = []
    for _ in range(3):
        batch = ring.take(10)
        sizes.append((len(batch.rows), len(batch.items)))
        ring.release(batch)
    assert sizes == [(1, 1100), (3, 1024), (1, 1)]


def test_a_second_mapping_of_the_descriptor_sees_the_same_memory(ring):
    other = Ring(ring.fd, DTYPE, 256)
    Writer(ring).row(1)
    ring.counters[DROPPED] = 5
    assert other.counters[WRITTEN] - other.counters[READ] == 1
    assert other.counters[DROPPED] == 5
    other.release(other.take(1))
    assert ring.counters[READ] == 1


ROW_0 = np.zeros((), ROW)
EMPTY = Frame(1, b"", 0)
ITEMS: dict[str, tuple[Any, ...]] = {
    "received": ([Received(0, EMPTY)], (), (), (), ()),
    "sent": ((), [EMPTY], (), (), ()),
    "command": ((), (), [int(Operator.STOP)], (), ()),
    "set-point": ((), (), (), [SetPoint(*range(6))], ()),
    "order": ((), (), (), (), [Order(Operator.HOLD)]),
}


def test_a_ring_whose_descriptor_is_closed_twice_closes_none_of_others(tmp_path):
    ring = Ring.create(DTYPE, 256)
    number = ring.fd
    ring.close_fd()
    with (tmp_path / "a").open("wb") as file:
        assert file.fileno() == number, "the lowest that is free"
        ring.close_fd()
        file.write(b"1")
    assert ring.fd == -1
    assert (tmp_path / "a").read_bytes() == b"1"


@pytest.mark.parametrize("second", ITEMS)
@pytest.mark.parametrize("first", ITEMS)
def test_a_tick_with_two_items_of_any_kinds_takes_room_for_two(first, second):
    """4096 items have room beside 256 rows, and what is refused leaves nothing behind."""
    ring = Ring.create(ROW, 256)
    nobody: Any = None
    recording = Recording(ring, nobody, Path("a.mcap"), lockstep=False)
    given = [[*a, *b] for a, b in zip(ITEMS[first], ITEMS[second], strict=True)]
    recording.tick(ROW_0, *given)
    batch = ring.take(10)
    assert len(batch.items) == 2
    recording._items = 4096 - 2
    recording.tick(ROW_0, *given)
    assert (recording.ticks, recording.dropped, recording._items) == (2, 0, 4096)
    recording.tick(ROW_0, *given)
    assert (recording.ticks, recording.dropped, recording._items) == (2, 1, 4096)
    ring.close_fd()


@pytest.mark.parametrize("capacity", [64, 256, 4096])
def test_the_parts_of_the_memory_begin_on_pages_lie_apart_and_are_as_large_as_they_must_be(capacity):
    ring = Ring.create(DTYPE, capacity)
    ends, items = np.asarray(ring.ends), np.asarray(ring.item_bytes)
    parts: list[Any] = [np.asarray(ring.counters), ends, ring.rows.view(np.uint8), items]
    begins = [part.__array_interface__["data"][0] for part in parts]
    sizes = [part.nbytes for part in parts]
    assert sizes == [4096, 8 * capacity, 40 * capacity, 16 * 80 * capacity]
    assert [begin % 4096 for begin in begins] == [0] * 4
    gaps = [begin - before - size for before, size, begin in zip(begins, sizes, begins[1:], strict=False)]
    assert all(0 <= gap < 4096 for gap in gaps)
    assert os.fstat(ring.fd).st_size == begins[-1] + sizes[-1] - begins[0], "and nothing lies behind"
    same: list[Any] = [(ends, ring._ends_array), (items, ring._items.view(np.uint8))]
    for part, other in same:
        assert part.__array_interface__["data"] == other.__array_interface__["data"]
        assert part.nbytes == other.nbytes
    ring.close_fd()


def test_each_counter_has_a_word_and_neither_end_stores_into_a_line_of_the_other():
    producer_s, consumer_s = {WRITTEN, EVENTS, DROPPED}, {READ, READ_ITEMS}
    assert (len(producer_s), len(consumer_s)) == (3, 2)
    assert all(0 <= word < 512 for word in producer_s | consumer_s)
    assert not {word // 8 for word in producer_s} & {word // 8 for word in consumer_s}, "64 bytes a line"


@pytest.mark.parametrize("memfd", [True, False])
def test_a_ring_lies_in_memory_where_the_system_has_such_files_and_is_nowhere_to_be_found(memfd, monkeypatch):
    if not memfd:
        monkeypatch.delattr(os, "memfd_create")
    ring = Ring.create(DTYPE, 256)
    place = str(Path(f"/proc/self/fd/{ring.fd}").readlink())
    assert place.startswith("/memfd:hil-ring") is memfd
    assert "(deleted)" in place
    assert os.fstat(ring.fd).st_nlink == 0
    ring.close_fd()


def test_a_descriptor_of_number_0_is_closed_too(ring, monkeypatch):
    closed: list[int] = []
    number = ring.fd
    monkeypatch.setattr(os, "close", closed.append)
    ring.fd = 0
    ring.close_fd()
    monkeypatch.undo()
    ring.fd = number
    assert closed == [0]


def test_a_ring_that_is_full_comes_out_whole(ring):
    writer = Writer(ring)
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
    for k in range(4096):
        writer.item(EVENT, k)
    ring.counters[EVENTS] = writer.items
    batch = ring.take(256)
    assert batch.items["t_ns"].tolist() == list(range(4096))
    assert batch.tick.tolist() == [0] * 4096


@pytest.mark.parametrize(
    ("machine", "kind"),
    [("x86_64", "no"), ("AMD64", "no"), ("i686", "no"), ("aarch64", "lock"), ("", "lock")],
)
def test_memory_is_put_in_order_by_locks_on_machines_that_do_not_keep_it(machine, kind, monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: machine)
    made = runpy.run_path(module.__file__)
    assert made["fence"].__name__ == f"_{kind}_fence"
    made["fence"]()
    assert not made["_lock"].locked()


class Watched:
    """The counters of a ring; what is done to them is told, and so is each fence."""

    def __init__(self, ring, told, monkeypatch):
        self.counters, self.told = ring.counters, told
        ring.counters = self
        for place in (module, producer):
            monkeypatch.setattr(place, "fence", lambda: told.append("fence"))

    def __getitem__(self, number):
        self.told.append(f"read {NAMES[number]}")
        return self.counters[number]

    def __setitem__(self, number, value):
        self.told.append(f"store {NAMES[number]}")
        self.counters[number] = value


NAMES = {WRITTEN: "rows", EVENTS: "events", READ: "rows read", READ_ITEMS: "items read"}


def test_each_end_orders_its_counters_and_what_they_speak_of_by_fences(monkeypatch):
    """The producer stores a counter behind its data; the consumer reads data behind their counter."""
    told: list[str] = []
    ring, nobody = Ring.create(ROW, 256), cast("Any", None)
    Watched(ring, told, monkeypatch)

    def steps():
        found, told[:] = [*told], []
        return found

    recording = Recording(ring, nobody, Path("a.mcap"), lockstep=False)
    recording.tick(ROW_0, *ITEMS["sent"])
    assert steps()[-2:] == ["fence", "store rows"]
    recording.event(0, "info", "")
    assert steps()[-2:] == ["fence", "store events"]
    batch = ring.take(5)
    assert steps()[:4] == ["read events", "fence", "read rows", "fence"]
    ring.since(0)
    assert steps() == ["read rows", "fence"]
    ring.release(batch)
    said = steps()
    assert said[0] == "fence"
    assert {each for each in said if each.startswith("store")} == {"store items read", "store rows read"}
    ring.close_fd()
