"""From the bytes of a chunk to arrays: where its messages are, and what rows and frames of our own hold.

Pure functions. They run as they are written, or compiled, which pays where a log is not short. All look at
the buffer through its `words`; a message of a table lies within the buffer, whatever it says.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Bytes, Flags, Ints
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE
from hil.record.layout import MAX_DATA, RECORD_HEADER, frame_layout

SHORTEST = RECORD_HEADER - 9
"""Bytes of a message's record before its data, without opcode and length."""
_SHORT = 1 << 20
"""Bytes of a log that is read in the time in which the compiler is loaded."""
_WORD = 8
_BYTE, _TWO_BYTES, _FOUR_BYTES, _FIVE_BYTES = 0xFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFFFF
_FIELDS: Any = frame_layout(0, b"").payload.fields
_SECONDS, _NANOS, _ID, _RTR, _DIRECTION, _TICK = (
    _FIELDS[name][1] for name in ("seconds", "nanos", "id", "is_rtr", "direction", "tick")
)
_DATA = _FIELDS["dlc"][1] + 3
"""Where fields of a frame are, and its data, behind their number; those behind the bus's name, of a frame
without data and name."""
_SIZE = frame_layout(0, b"").payload.itemsize
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


def unpack_rows(words: Ints, starts: Ints, constants: Ints, places: Ints, rows: Ints) -> bool:
    """Fill rows (n, m) from messages that start at `starts` (n,); return whether all have the layout.

    constants : (3, k) as `constants_of`; places : (m,) where a message has the words of a row. Without a
    compiler `gather_rows` is faster.
    """
    for i in range(len(starts)):
        at, other = starts[i], 0
        for k in range(constants.shape[1]):
            other |= (words[at + constants[0, k]] ^ constants[1, k]) & constants[2, k]
        if other:
            return False
        for k in range(len(places)):
            rows[i, k] = words[at + places[k]]
    return True


def gather_rows(words: Ints, starts: Ints, constants: Ints, places: Ints, rows: Ints) -> bool:
    """Do the same by NumPy."""
    at = starts[:, None]
    if ((words[at + constants[0]] ^ constants[1]) & constants[2]).any():
        return False
    rows[:] = words[at + places]
    return True


def constants_of(template: Bytes, mask: Bytes, first: int = 0, last: int | None = None) -> Ints:
    """Return the words of a layout with bytes that are the same in every message: (3, n).

    Their places from `first` to before `last`, their values, and the bits that count. template, mask :
    (size,) of a message without its record's header.
    """
    last = len(mask) if last is None else last
    places = np.array([*range(first, last - _WORD, _WORD), last - _WORD])
    values, bits = words_of(template.tobytes())[places], words_of(mask.tobytes())[places]
    counts = bits != 0
    return np.array([places[counts], values[counts], bits[counts]])


class FrameTable(NamedTuple):
    """The layouts of frames on several buses, of whatever number of data bytes."""

    shortest: Ints
    """(buses,) bytes of a message without data."""
    ends: Ints
    """(buses + 1,) where the constants of each bus begin and end."""
    constants: Ints
    """(3, n) as `constants_of`; places behind the data are counted from the end and negative."""


def frame_table(buses: Sequence[bytes]) -> FrameTable:
    """Return the layouts for the names of buses."""
    shortest, ends, constants = [], [0], []
    for name in buses:
        layout = frame_layout(0, name)
        template, mask = layout.template[RECORD_HEADER:], layout.mask()
        mask[_DATA - 1] = 0  # how many data bytes there are
        before, behind = constants_of(template, mask, 0, _DATA), constants_of(template, mask, _DATA)
        behind[0] -= len(mask)
        constants += [before, behind]
        shortest.append(len(mask))
        ends.append(ends[-1] + before.shape[1] + behind.shape[1])
    return FrameTable(
        np.array(shortest, np.int64), np.array(ends, np.int64), np.concatenate(constants, axis=1)
    )


def unpack_frames(
    words: Ints,
    starts: Ints,
    sizes: Ints,
    epoch_ns: int,
    shortest: Ints,
    ends: Ints,
    constants: Ints,
    items: Ints,
    fit: Flags,
) -> None:
    """Fill items (n, ITEM_WORDS), which are 0, from messages that start at `starts`, of `sizes` bytes, (n,).

    `fit` (n,) becomes true where a message has the layout of a bus; the others are left alone. For
    `shortest`, `ends` and `constants` see FrameTable.
    """
    for i in range(len(starts)):
        at, end = starts[i], starts[i] + sizes[i]
        for bus in range(len(shortest)):
            length = sizes[i] - shortest[bus]
            if length < 0 or length > MAX_DATA or words[at + _DATA - _WORD] >> 56 & _BYTE != length:
                continue
            fits = True
            for k in range(ends[bus], ends[bus + 1]):
                place = constants[0, k] + (at if constants[0, k] >= 0 else end)
                if (words[place] ^ constants[1, k]) & constants[2, k]:
                    fits = False
                    break
            if not fits:
                continue
            fit[i] = True
            stamp = 0
            for field, unit in ((_SECONDS, 1_000_000_000), (_NANOS, 1)):
                varint = words[at + field] & _FIVE_BYTES
                for k in range(5):
                    stamp += (varint >> 8 * k & 0x7F) * unit << 7 * k
            before, behind = words[at + _RTR], words[end - _SIZE + _DIRECTION]
            flags = REMOTE if before & _BYTE else 0
            flags += EXTENDED if before >> 16 & _BYTE else 0
            flags += ERROR if before >> 32 & _BYTE else 0
            flags += FD if behind >> 16 & _BYTE else 0
            flags += BRS if behind >> 32 & _BYTE else 0
            flags += ESI if behind >> 48 & _BYTE else 0
            last = words[end - _WORD]
            items[i, 0] = stamp - epoch_ns
            items[i, 1] = words[at + _ID] & _FOUR_BYTES | (behind & _BYTE) << 32 | length << 40
            items[i, 1] |= flags << 48 | (last >> 56 & _BYTE) << 56
            for k in range(length // _WORD):
                items[i, 2 + k] = words[at + _DATA + k * _WORD]
            if length % _WORD:
                rest = words[at + _DATA + length // _WORD * _WORD]
                items[i, 2 + length // _WORD] = rest & (1 << 8 * (length % _WORD)) - 1
            items[i, ITEM_WORDS - 2] = words[end - _SIZE + _TICK]
            items[i, ITEM_WORDS - 1] = last >> 16 & _FOUR_BYTES
            break


class Kernels(NamedTuple):
    """The functions as they are called."""

    scan: Callable[..., tuple[int, int]]
    rows: Callable[..., bool]
    frames: Callable[..., None]


PLAIN = Kernels(scan, gather_rows, unpack_frames)


@cache
def compiled() -> Kernels:
    """Return the functions compiled."""
    from drivers.compiled import compiler as c  # noqa: PLC0415 - it takes a quarter of a second

    numbers, matrix, filled = c.INTEGERS, c.MATRIX_OF_INTEGERS, c.OUT_INTEGER_MATRIX
    of_frames = c.WORDS, numbers, numbers, c.INTEGER, numbers, numbers, matrix, filled, c.OUT_FLAGS
    return Kernels(
        c.kernel(c.WORDS, c.INTEGER, c.INTEGER, filled, c.INTEGER)(scan),
        c.kernel(c.WORDS, numbers, matrix, numbers, filled)(unpack_rows),
        c.kernel(*of_frames)(unpack_frames),
    )


def kernels_for(size: int) -> Kernels:
    """Return the functions for a log of so many bytes."""
    there = "drivers.compiled.compiler" in sys.modules
    return compiled() if there or size > _SHORT else PLAIN
