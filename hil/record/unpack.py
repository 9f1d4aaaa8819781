"""From the bytes of a chunk to arrays: where its messages are, and what rows and frames of our own hold.

Pure functions. Two run as they are written, or compiled, which pays where a log is not short: they look at
the buffer through its `words`. A message of a table lies within the buffer, whatever it says.
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

SHORTEST = 23
"""Bytes of the shortest record that a chunk may hold, an empty schema."""
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


def scan(words: Ints, size: int, table: Ints) -> tuple[int, int]:
    """Find the whole records in a buffer of `size` bytes.

    Fills table (6, m): opcode, of messages channel, sequence and log time, offset and length of each. Returns
    the position behind the last one and how many there are.
    """
    position = n = 0
    while position + SHORTEST <= size:
        count = words[position + 1]
        if count < SHORTEST - 9 or count > size - position - 9:
            break
        table[0, n] = words[position] & _BYTE
        table[1, n] = words[position + 9] & _TWO_BYTES
        table[2, n] = words[position + 11] & _FOUR_BYTES
        table[3, n] = words[position + 15]
        table[4, n] = position
        table[5, n] = count + 9
        position += count + 9
        n += 1
    return position, n


def constants_of(layout: Layout) -> tuple[Ints, Ints]:
    """Return the values and the masks of the words of a layout, from each of its bytes on."""
    template, mask = (words_of(each.tobytes()).copy() for each in layout)
    return template, mask


def unpack_rows(data: bytes, starts: Ints, layout: Layout, places: Ints, rows: Ints) -> bool:
    """Fill rows (n, m or more) from records that start at `starts` (n,); return whether all have the layout.

    places : (m,) where a record has the words of a row.
    """
    size = len(layout.template)
    packed = b"".join([data[start : start + size] for start in starts.tolist()])
    records = np.frombuffer(packed, np.uint8).reshape(len(starts), size)
    if ((records ^ layout.template) & layout.mask).any():
        return False
    words = np.ndarray((len(starts), size - _WORD + 1), "<i8", packed, strides=(size, 1))
    rows[:, : len(places)] = words[:, places]
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

    scan: Callable[..., tuple[int, int]] = scan
    frames: Callable[..., int] = unpack_frames


@cache
def compiled() -> Kernels:
    """Return the functions compiled."""
    from drivers.compiled import compiler as c  # noqa: PLC0415 - it takes a quarter of a second

    words, numbers, filled = c.WORDS, c.INTEGERS, c.OUT_INTEGER_MATRIX
    of_frames = words, numbers, numbers, c.INTEGER, numbers, numbers, c.MATRIX_OF_INTEGERS, filled
    return Kernels(
        c.kernel(words, c.INTEGER, filled)(scan),
        c.kernel(*of_frames)(unpack_frames),
    )


def kernels_for(size: int) -> Kernels:
    """Return the functions for a log of so many bytes."""
    return compiled() if "drivers.compiled.compiler" in sys.modules or size > _SHORT else Kernels()
