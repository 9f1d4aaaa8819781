"""One-producer one-consumer ring in shared memory: rows of ticks and their items.

Two rings side by side: `rows` has one element per tick; `items` has one per frame, operator command or piece
of an event's text. `ends` has the end of each tick's items. Each side stores only its own counters, as
aligned eight-byte words, after the data that they count. The consumer therefore never sees an unfinished
tick.
"""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Sequence
from threading import Lock
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Ints, Rows
from drivers.frame_array import FRAME

RECEIVED, SENT, OPERATOR, EVENT = range(4)
"""Kinds of item: a frame, an operator command or a piece of an event, each in the form of a frame.

Operator: id is the command, data its numbers (`pack_numbers`). Event: id is the number of pieces that follow,
flags the level."""


def pack_numbers(numbers: Sequence[float]) -> bytes:
    """Bytes of at most eight numbers of a command, as float64, for the data of an item."""
    return struct.pack(f"<{len(numbers)}d", *numbers)


def unpack_numbers(data: bytes) -> tuple[float, ...]:
    """Numbers of a command from the data bytes of an item."""
    return struct.unpack(f"<{len(data) // 8}d", data)


ITEMS_PER_TICK = 16
_HEADER = 4096
WRITTEN, EVENTS, DROPPED, READ, READ_ITEMS = 0, 1, 2, 16, 17
"""Counters of the producer: rows published, items published by events, ticks dropped; of the consumer: rows
and items read."""

Scalar = TypeVar("Scalar", bound=np.generic)
_lock = Lock()


def fence() -> None:
    """Order this process's memory accesses, by two locks: none moves across this call."""
    with _lock:
        pass
    with _lock:
        pass


class Batch(NamedTuple):
    """Consecutive ticks from the ring with their items, possibly with events after the last tick."""

    rows: Rows
    items: Rows
    tick: Ints
    """(items,) index in `rows` of the row of each item; len(rows) for events after the last row."""


class Ring:
    """Ring in shared memory: `create` makes one, `Ring(fd, ...)` maps an inherited one; fd -1: no sharing."""

    def __init__(self, fd: int, dtype: np.dtype[np.void], capacity: int) -> None:
        self.fd = fd
        self.capacity = capacity
        self.item_capacity = capacity * ITEMS_PER_TICK
        ends = _HEADER
        rows = ends + _aligned(8 * capacity)
        items = rows + _aligned(dtype.itemsize * capacity)
        size = items + FRAME.itemsize * self.item_capacity
        if fd < 0:
            self._map = mmap.mmap(-1, size)
        else:
            if os.fstat(fd).st_size < size:
                os.ftruncate(fd, size)
            # map all pages now: else each first access in the loop costs a page fault
            self._map = mmap.mmap(fd, size, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE)
        self._view = memoryview(self._map)
        self.counters = self._view[:_HEADER].cast("q")
        self.ends = self._view[ends : ends + 8 * capacity].cast("q")
        self._ends_array: Ints = np.ndarray(capacity, np.int64, self._map, ends)
        self.rows: Rows = np.ndarray(capacity, dtype, self._map, rows)
        self._row_bytes = self._view[rows : rows + dtype.itemsize * capacity]
        self._items: Rows = np.ndarray(self.item_capacity, FRAME, self._map, items)
        self.item_bytes = self._view[items:size]

    @classmethod
    def create(cls, dtype: np.dtype[np.void], capacity: int) -> Ring:
        """New ring for rows of `dtype`, with room for `capacity` ticks, in a memory file (Linux)."""
        return cls(os.memfd_create("hil-ring") if hasattr(os, "memfd_create") else -1, dtype, capacity)

    def close_fd(self) -> None:
        """Close the file descriptor; the memory stays mapped."""
        if self.fd >= 0:
            os.close(self.fd)
        self.fd = -1

    def put(self, number: int, data: bytes) -> None:
        """Copy the bytes of items to the places from item `number` on; the caller checks for room."""
        _put(self.item_bytes, number % self.item_capacity * FRAME.itemsize, data)

    def put_rows(self, number: int, rows: Rows, ends: Ints) -> None:
        """Copy rows, and the end of each row's items, to the places of row `number` and the next ones."""
        place = number % self.capacity
        if rows.dtype is not self.rows.dtype:
            rows = rows.astype(self.rows.dtype)
        _put(self._row_bytes, place * rows.dtype.itemsize, rows.tobytes())  # far faster than field by field
        _put(self._ends_array, place, ends)

    def ready(self, limit: int) -> bool:
        """True if `limit` rows wait for the consumer, or if items take a quarter of their room."""
        events = self.counters[EVENTS]
        written, read = self.counters[WRITTEN], self.counters[READ]
        end = self.ends[(written - 1) % self.capacity]
        return (
            written - read >= limit or max(end, events) - self.counters[READ_ITEMS] >= self.item_capacity // 4
        )

    def take(self, limit: int) -> Batch:
        """Up to `limit` published rows with their items, for the consumer; `release` frees their memory.

        Fewer rows if their items take a quarter of the room: the end of a batch depends on the content of the
        ring, not on the time of the read. The arrays may be views of the ring, valid until `release`.
        """
        events = self.counters[EVENTS]  # first: every row that precedes these events is then visible
        fence()
        written = self.counters[WRITTEN]
        fence()
        read, first = self.counters[READ], self.counters[READ_ITEMS]
        count = min(written - read, limit)
        rows = _span(self.rows, read, read + count)
        ends = _span(self._ends_array, read, read + count)
        full = np.flatnonzero(ends - first >= self.item_capacity // 4)
        if len(full):
            count = int(full[0]) + 1
            rows, ends = rows[:count], ends[:count]
        end = int(ends[-1]) if count else first
        tick = np.repeat(np.arange(count), np.diff(ends, prepend=first))
        if read + count == written and events > end:
            tick = np.concatenate((tick, np.full(events - end, count)))
            end = events
        return Batch(rows, _span(self._items, first, end), tick)

    def since(self, row: int) -> Rows:
        """Published rows from number `row` on, which must not be released yet; may be a view of the ring."""
        written = self.counters[WRITTEN]
        fence()
        return _span(self.rows, row, written)

    def release(self, batch: Batch) -> None:
        """Free the memory of the last batch for the producer."""
        fence()
        self.counters[READ_ITEMS] += len(batch.items)
        self.counters[READ] += len(batch.rows)


def _aligned(size: int) -> int:
    return (size + 4095) // 4096 * 4096


def _put(ring: Any, first: int, values: Any) -> None:
    here = min(len(values), len(ring) - first)
    ring[first : first + here] = values[:here]
    ring[: len(values) - here] = values[here:]


def _span(ring: NDArray[Scalar], start: int, stop: int) -> NDArray[Scalar]:
    """Elements start .. stop of an endless sequence whose last elements the ring holds."""
    first, last = start % len(ring), stop % len(ring)
    if start == stop:
        return ring[:0]
    return ring[first:last] if first < last else np.concatenate((ring[first:], ring[:last]))
