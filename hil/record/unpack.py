"""Decode the buffer of a chunk into arrays: record offsets, rows, frames.

Pure functions. Offsets and sizes of records lie within the buffer; no content of it leads outside.
"""

import struct

import numpy as np

from drivers.arrays import Bytes, Ints, Rows
from drivers.frame_array import FRAME
from hil.record.layout import FRAME_FLAGS, MAX_DATA, Layout
from hil.record.schema import RX, TX

ITEM = np.dtype([("frame", FRAME), ("tick", "<i8"), ("index", "<i8")])
"""CAN frame with its tick and its index within the tick."""
SHORTEST = 23
"""Length of the shortest record in a chunk, an empty schema, bytes."""
_LENGTH = struct.Struct("<Q")
_SEVEN_BITS = 1 << 7 * np.arange(5)
_FLAG_BITS = np.array(list(FRAME_FLAGS.values()))


def scan(data: bytes) -> tuple[Ints, int]:
    """Offsets (n,) of the complete MCAP records in a buffer, and the offset of the end of the last one."""
    starts: list[int] = []
    at, size = 0, len(data)
    while at + SHORTEST <= size:
        end = at + 9 + _LENGTH.unpack_from(data, at + 1)[0]
        if not at + SHORTEST <= end <= size:
            break
        starts.append(at)
        at = end
    return np.array(starts, np.int64), at


def words_of(data: bytes) -> Ints:
    """View (n - 7,) of a buffer of n bytes: the 8-byte integer that begins at each byte."""
    return np.ndarray((max(len(data) - 7, 0),), "<i8", data, strides=(1,))


def unpack_rows(data: bytes, starts: Ints, layout: Layout, places: Ints, rows: Ints) -> bool:
    """Fill rows (n, m or more) from the records at `starts` (n,); True if all have the layout.

    places: (m,) offsets of a row's words in its record.
    """
    records = _stacked(data, starts, len(layout.template))
    if ((records ^ layout.template) & layout.mask).any():
        return False
    size = records.shape[1]
    words = np.ndarray((len(starts), size - 7), "<i8", records, strides=(size, 1))
    rows[:, : len(places)] = words[:, places]
    return True


def unpack_frames(
    data: bytes, starts: Ints, sizes: Ints, epoch_ns: int, layout: Layout, table: Ints, items: Rows
) -> bool:
    """Fill zeroed items (n,) of ITEM from the records at `starts` with `sizes` bytes, (n,).

    The result is True if each has the layout of a bus. layout, table: of `hil.record.layout.frame_table`.
    """
    left = np.ones(len(starts), np.bool_)
    for first, size, at, *places in table.tolist():
        template, mask = layout.template[first : first + size], layout.mask[first : first + size]
        for length in {*(sizes[left] - size).tolist()} & {*range(MAX_DATA + 1)}:
            mine = np.flatnonzero(left & (sizes == size + length))
            records = _stacked(data, starts[mine], size + length)
            constant = np.delete(records, np.s_[at : at + length], axis=1)
            found = _frames(constant, places, epoch_ns)
            found["frame"]["length"] = length
            found["frame"]["data"][:, :length] = records[:, at : at + length]
            good = ~((constant ^ template) & mask).any(axis=1) & (constant[:, at - 1] == length)
            good &= found["frame"]["kind"] <= TX - RX
            items[mine[good]] = found[good]
            left[mine[good]] = False
    return not left.any()


def _stacked(data: bytes, starts: Ints, size: int) -> Bytes:
    """Copy records of equal size into an array (n, size) of bytes."""
    packed = b"".join([data[start : start + size] for start in starts.tolist()])
    return np.frombuffer(packed, np.uint8).reshape(len(starts), size)


def _frames(records: Bytes, places: list[int], epoch_ns: int) -> Rows:
    """Frames (n,) of ITEM from records without their data bytes; places: a row of `frame_table`."""
    seconds, nanos, can_id, _, direction, tick, index, bus, *flags = places

    def number(place: int, kind: str) -> Ints:
        size = np.dtype(kind).itemsize
        found: Ints = np.ascontiguousarray(records[:, place : place + size]).view(kind)[:, 0]
        return found

    def varint(place: int) -> Ints:
        found: Ints = (records[:, place : place + 5] & 0x7F) @ _SEVEN_BITS
        return found

    items = np.zeros(len(records), ITEM)
    frames = items["frame"]
    frames["t_ns"] = varint(seconds) * 1_000_000_000 + varint(nanos) - epoch_ns
    frames["id"], frames["bus"] = number(can_id, "<u4"), records[:, bus]
    frames["kind"] = records[:, direction] - RX
    frames["flags"] = (records[:, flags] != 0) @ _FLAG_BITS
    items["tick"], items["index"] = number(tick, "<i8"), number(index, "<u4")
    return items
