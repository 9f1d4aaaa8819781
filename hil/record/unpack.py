"""From the bytes of a chunk to arrays: where its messages are, and what rows and frames of our own hold.

Pure functions. They run as they are written, or compiled, which pays where a log is not short. All look at
the buffer through its `words`; a message of a table lies within the buffer, whatever it says.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from drivers.arrays import Ints
from hil.record.layout import (
    DIRECTION,
    FLAGS,
    FRAME_FLAGS,
    ID,
    MAX_DATA,
    NANOS,
    RECORD_HEADER,
    SECONDS,
    TICK,
    Layout,
)
from hil.record.schema import RX, TX

SHORTEST = RECORD_HEADER - 9
"""Bytes of a message's record before its data, without opcode and length."""
_SHORT = 1 << 20
"""Bytes of a log that is read in the time in which the compiler is loaded."""
_WORD = 8
_BYTE, _TWO_BYTES, _FOUR_BYTES, _FIVE_BYTES = 0xFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFFFF
_BITS = tuple(FRAME_FLAGS.values())
ITEM_WORDS = 4 + MAX_DATA // _WORD
"""Words of one element of `hil.record.decode.ITEM`."""


def words_of(data: bytes) -> Ints:
    """Return the eight bytes from each position of a buffer on, as integers (n - 7,): views of it."""
    return np.ndarray((max(len(data) - _WORD + 1, 0),), "<i8", data, strides=(1,))


def scan(words: Ints, size: int, position: int, table: Ints, n: int) -> tuple[int, int]:
    """Go through the whole messages of a buffer of `size` bytes, from a position on to the first other thing.

    Fills `table` (4, m) from its column n on: channel, log time, offset and length of each record. Returns
    the position behind the last one and the columns that are filled.
    """
    while position + RECORD_HEADER <= size:
        count = words[position + 1]
        if words[position] & _BYTE != 5 or count < SHORTEST or count > size - position - 9:
            break
        table[0, n] = words[position + 9] & _TWO_BYTES
        table[1, n] = words[position + 15]
        table[2, n] = position
        table[3, n] = count + 9
        position += count + 9
        n += 1
    return position, n


def constants_of(layout: Layout) -> tuple[Ints, Ints]:
    """Return the values and the masks of the words of a layout, from each of its bytes on."""
    template, mask = (words_of(each.tobytes()).copy() for each in layout)
    return template, mask


def unpack_rows(words: Ints, starts: Ints, template: Ints, mask: Ints, places: Ints, rows: Ints) -> bool:
    """Fill rows (n, m) from records that start at `starts` (n,); return whether all have the layout.

    template, mask : as `constants_of`; places : (m,) where a record has the words of a row. Without a
    compiler `gather_rows` is faster.
    """
    last = len(template) - 1
    for i in range(len(starts)):
        at, other = starts[i], 0
        for k in range(RECORD_HEADER, last + _WORD, _WORD):
            place = min(k, last)
            other |= (words[at + place] ^ template[place]) & mask[place]
        if other:
            return False
        for k in range(len(places)):
            rows[i, k] = words[at + places[k]]
    return True


def gather_rows(words: Ints, starts: Ints, template: Ints, mask: Ints, places: Ints, rows: Ints) -> bool:
    """Do the same by NumPy."""
    at, last = starts[:, None], len(template) - 1
    k = np.minimum(np.arange(RECORD_HEADER, last + _WORD, _WORD), last)
    if ((words[at + k] ^ template[k]) & mask[k]).any():
        return False
    rows[:] = words[at + places]
    return True


def unpack_frames(
    words: Ints,
    starts: Ints,
    sizes: Ints,
    epoch_ns: int,
    template: Ints,
    mask: Ints,
    table: Ints,
    items: Ints,
) -> int:
    """Fill items (n, ITEM_WORDS), which are 0, from records that start at `starts`, of `sizes` bytes, (n,).

    Returns how many of them, from the first one on, have the layout of a bus. template, mask : as
    `constants_of`; table : as `hil.record.layout.frame_table`.
    """
    for i in range(len(starts)):
        at, end = starts[i], starts[i] + sizes[i]
        bus = length = data = 0
        fits = False
        while not fits and bus < len(table):
            start, size, data = table[bus, 0], table[bus, 1], table[bus, 2]
            length = sizes[i] - size
            fits = 0 <= length <= MAX_DATA and words[at + data - _WORD] >> 56 & _BYTE == length
            k = RECORD_HEADER
            while fits and k < size:
                place = min(k, (data if k < data else size) - _WORD)
                word = words[at + place + (0 if k < data else length)]
                fits = (word ^ template[start + place]) & mask[start + place] == 0
                k = place + _WORD
            bus += 1
        bus -= 1
        behind = at + length
        direction = words[behind + table[bus, DIRECTION]] & _BYTE
        if not fits or not RX <= direction <= TX:
            return i
        stamp = 0
        for field, unit in ((SECONDS, 1_000_000_000), (NANOS, 1)):
            varint = words[at + table[bus, field]] & _FIVE_BYTES
            for k in range(5):
                stamp += (varint >> 8 * k & 0x7F) * unit << 7 * k
        flags = 0
        for k in range(len(_BITS)):
            place = table[bus, FLAGS + k]
            if words[(behind if place > data else at) + place] & _BYTE:
                flags |= _BITS[k]
        last = words[end - _WORD]
        items[i, 0] = stamp - epoch_ns
        items[i, 1] = words[at + table[bus, ID]] & _FOUR_BYTES | (direction - RX) << 32 | length << 40
        items[i, 1] |= flags << 48 | (last >> 56 & _BYTE) << 56
        for k in range(length // _WORD):
            items[i, 2 + k] = words[at + data + k * _WORD]
        if length % _WORD:
            rest = words[at + data + length // _WORD * _WORD]
            items[i, 2 + length // _WORD] = rest & (1 << 8 * (length % _WORD)) - 1
        items[i, ITEM_WORDS - 2] = words[behind + table[bus, TICK]]
        items[i, ITEM_WORDS - 1] = last >> 16 & _FOUR_BYTES
    return len(starts)


class Kernels(NamedTuple):
    """The functions as they are called."""

    scan: Callable[..., tuple[int, int]]
    rows: Callable[..., bool]
    frames: Callable[..., int]


PLAIN = Kernels(scan, gather_rows, unpack_frames)


@cache
def compiled() -> Kernels:
    """Return the functions compiled."""
    from drivers.compiled import compiler as c  # noqa: PLC0415 - it takes a quarter of a second

    words, numbers, filled = c.WORDS, c.INTEGERS, c.OUT_INTEGER_MATRIX
    of_frames = words, numbers, numbers, c.INTEGER, numbers, numbers, c.MATRIX_OF_INTEGERS, filled
    return Kernels(
        c.kernel(words, c.INTEGER, c.INTEGER, filled, c.INTEGER)(scan),
        c.kernel(words, numbers, numbers, numbers, numbers, filled)(unpack_rows),
        c.kernel(*of_frames)(unpack_frames),
    )


def kernels_for(size: int) -> Kernels:
    """Return the functions for a log of so many bytes."""
    there = "drivers.compiled.compiler" in sys.modules
    return compiled() if there or size > _SHORT else PLAIN
