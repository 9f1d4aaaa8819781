"""Wire layout of the log's own messages: protobuf with a fixed size for every field.

Fields are fixed64, fixed32, double, one-byte varints, or varints padded to five bytes. A message is therefore
a template: `hil.record.packer` fills the places of a table, and functions here decode the buffer of a chunk.
Offsets and sizes of records lie within the buffer; no content of it leads outside.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Bytes, Ints, Rows
from drivers.frame_array import FRAME
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE
from hil.record.schema import RX, TX

RECORD_HEADER = 31
"""Bytes of an MCAP Message record before its data."""
MAX_DATA = 64
VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
"""Protobuf wire types."""
_WIRE_TYPES = {1: VARINT, 4: FIXED32, 8: FIXED64}
"""Size of a value in bytes -> protobuf wire type."""
FRAME_FLAGS = {
    "is_rtr": REMOTE, "is_extended": EXTENDED, "is_error": ERROR, "fdf": FD, "brs": BRS, "esi": ESI,
}  # fmt: skip
"""Field of hil.Frame -> flag of `drivers.protocol.Frame`."""
_PLACES = ("seconds", "nanos", "id", "dlc", "direction", "tick", "index", "bus", *FRAME_FLAGS)
SECONDS, NANOS, ID, DLC, DIRECTION, TICK, INDEX, BUS, FLAGS = range(3, 12)
"""Columns of a `frame_table` with the offsets of fields; from FLAGS on, those of FRAME_FLAGS."""

ITEM = np.dtype([("frame", FRAME), ("tick", "<i8"), ("index", "<i8")])
"""CAN frame with its tick and its index within the tick."""
SHORTEST = 23
"""Length of the shortest record in a chunk, an empty schema, bytes."""
_LENGTH = struct.Struct("<Q")
_SEVEN_BITS = 1 << 7 * np.arange(5)
_FLAG_BITS = np.array(list(FRAME_FLAGS.values()))


class Layout(NamedTuple):
    """Constant bytes of one MCAP record, or of several back to back."""

    template: Bytes
    """(size,) all constant bytes in place, the header of the MCAP Message record first."""
    mask: Bytes
    """(size,) 0xFF for each message byte that is equal in every record, else 0."""


class Builder:
    """Builds the layout of one protobuf message from its fields. State: template and mask of the record."""

    def __init__(self, channel: int) -> None:
        self._template = bytearray(RECORD_HEADER)
        self._template[0], self._template[9] = 5, channel
        self._mask = bytearray(RECORD_HEADER)

    def constant(self, data: bytes) -> None:
        """Append bytes that are equal in every record."""
        self._template += data
        self._mask += b"\xff" * len(data)

    def room(self, size: int) -> int:
        """Reserve `size` bytes for a value; return their offset in the record."""
        place = len(self._template)
        self._template += bytes(size)
        self._mask += bytes(size)
        return place

    def field(self, number: int, size: int) -> int:
        """Add a field of 1, 4 or 8 bytes; return the offset of its value in the record."""
        self.constant(varint(number << 3 | _WIRE_TYPES[size]))
        return self.room(size)

    def packed(self, number: int, size: int, count: int) -> list[int]:
        """Add a packed list of `count` values; return their offsets in the record."""
        self.constant(varint(number << 3 | LENGTH) + varint(count * size))
        return [self.room(size) for _ in range(count)]

    def message(self, number: int, size: int, count: int) -> list[int]:
        """Add a nested message of `count` fields, numbered from 1; return the offsets of their values.

        All its tags have one size: with more than 15 fields they are varints padded to two bytes.
        """
        width = 1 if count <= 15 else 2
        self.constant(varint(number << 3 | LENGTH) + varint(count * (width + size)))
        places = []
        for k in range(1, count + 1):
            tag = k << 3 | _WIRE_TYPES[size]
            self.constant(bytes([tag] if width == 1 else [tag & 0x7F | 0x80, tag >> 7]))
            places.append(self.room(size))
        return places

    def layout(self) -> Layout:
        """Layout of the record with all fields added so far."""
        self._template[1:9] = (len(self._template) - 9).to_bytes(8, "little")
        return Layout(
            np.frombuffer(bytes(self._template), np.uint8), np.frombuffer(bytes(self._mask), np.uint8)
        )


def varint(value: int) -> bytes:
    """Shortest protobuf varint of a number >= 0."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _frame_layout(bus: bytes, channel: int) -> tuple[Layout, int, list[int]]:
    """Layout of a hil.Frame on a bus without data bytes, offset of the data, offsets of its fields."""
    frame, places = Builder(channel), {}
    frame.constant(b"\x0a\x0e\x0a\x0c\x08")
    places["seconds"] = frame.room(5)
    frame.constant(b"\x10")
    places["nanos"] = frame.room(5)
    places["id"] = frame.field(2, 4)
    for name, number in {"is_rtr": 3, "is_extended": 4, "is_error": 5, "dlc": 6}.items():
        places[name] = frame.field(number, 1)
    frame.constant(varint(7 << 3 | LENGTH))
    data = frame.room(1) + 1  # after the byte of their length
    frame.constant(varint(8 << 3 | LENGTH) + varint(len(bus)) + bus)
    for name, number in {"direction": 9, "fdf": 10, "brs": 11, "esi": 12}.items():
        places[name] = frame.field(number, 1)
    places |= {"tick": frame.field(13, 8), "index": frame.field(14, 4), "bus": frame.field(15, 1)}
    return frame.layout(), data, [places[name] for name in _PLACES]


def frame_table(buses: Sequence[bytes], channel: int = 0) -> tuple[Layout, Ints]:
    """Layouts of frames without data, one per bus, and their table (buses, 17).

    Columns of the table: start of the template, its size, offset of the data, offsets of the fields.
    """
    layouts, data, places = zip(*(_frame_layout(bus, channel) for bus in buses), strict=True)
    sizes = [len(each.template) for each in layouts]
    table = np.column_stack((np.cumsum([0, *sizes[:-1]]), sizes, data, places))
    both = (np.concatenate(each) for each in zip(*layouts, strict=True))
    return Layout(*both), np.ascontiguousarray(table, np.int64)


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

    The result is True if each has the layout of a bus. layout, table: of `frame_table`.
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
