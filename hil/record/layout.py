"""The wire layout of the log's own messages: protobuf as NumPy structured types.

Every field has a fixed size (fixed64, fixed32, double, one-byte varints, varints padded to five bytes): a
message is a template in which `hil.record.packer` fills the places of a table, and a batch of messages is
read as one structured array. Any protobuf parser reads them; `hil.record.decode` checks the layout of what it
reads and falls back to one.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Bytes, Ints
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE

RECORD_HEADER = 31
"""Bytes of an MCAP Message record in front of its data."""
MAX_DATA = 64
VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
"""Wire types."""
FRAME_FLAGS = {
    "is_rtr": REMOTE, "is_extended": EXTENDED, "is_error": ERROR, "fdf": FD, "brs": BRS, "esi": ESI,
}  # fmt: skip
"""Field of hil.Frame -> flag of `Frame`."""
FRAME_PLACES = ("seconds", "nanos", "id", "dlc", "direction", "tick", "index", "bus", *FRAME_FLAGS)
"""Fields of hil.Frame in the order of their places in a `frame_table`."""


class Layout(NamedTuple):
    """Constant wire layout of one message type, with the header of its MCAP Message record in front."""

    template: Bytes
    """(size,) all constant bytes in place."""
    payload: np.dtype[np.void]
    """The fields of the message, without the record header."""
    constant: NDArray[np.intp]
    """Positions in the payload that are the same in every message."""

    def of_channel(self, channel: int) -> Bytes:
        """Return the template of the records on a channel."""
        template = self.template.copy()
        template[9] = channel
        return template

    def place(self, name: str) -> int:
        """Return where in the record a field begins."""
        return RECORD_HEADER + int(self.payload.fields[name][1])  # type: ignore[index]

    def mask(self) -> Bytes:
        """Return 0xFF for each byte of the payload that is the same in every message, else 0: (size,)."""
        mask = np.zeros(self.payload.itemsize, np.uint8)
        mask[self.constant] = 0xFF
        return mask


class Builder:
    """Collects constant bytes and fields of one message."""

    def __init__(self) -> None:
        self.template = bytearray()
        self.constant: list[int] = []
        self.fields: dict[str, tuple[Any, int]] = {}
        """Format and offset."""

    def bytes(self, data: bytes) -> None:
        """Add constant bytes."""
        self.constant.extend(range(len(self.template), len(self.template) + len(data)))
        self.template += data

    def field(self, name: str, kind: Any) -> None:
        """Add room for one value."""
        self.fields[name] = kind, len(self.template)
        self.template += bytes(np.dtype(kind).itemsize)

    def tag(self, number: int, wire_type: int) -> None:
        """Add the tag of a field."""
        self.bytes(varint(number << 3 | wire_type))

    def fields_of_message(self, name: str, number: int, kind: str, count: int, wire_type: int) -> None:
        """Add a message of `count` fields, numbered from 1: an array of elements with one field `value`.

        All its tags have one size: beyond 15 fields they are varints padded to two bytes.
        """
        width = 1 if count <= 15 else 2
        size = width + np.dtype(kind).itemsize
        self.tag(number, LENGTH)
        self.bytes(varint(count * size))
        element = {"names": ["value"], "formats": [kind], "offsets": [width], "itemsize": size}
        self.fields[name] = (np.dtype(element), (count,)), len(self.template)  # type: ignore[call-overload]
        for k in range(1, count + 1):
            tag = k << 3 | wire_type
            self.bytes(bytes([tag] if width == 1 else [tag & 0x7F | 0x80, tag >> 7]))
            self.template += bytes(size - width)

    def layout(self) -> Layout:
        """Return the layout of what was added."""
        size = len(self.template)
        opcode_and_length = b"\x05" + (RECORD_HEADER - 9 + size).to_bytes(8, "little")
        template = opcode_and_length + bytes(RECORD_HEADER - 9) + bytes(self.template)
        return Layout(
            np.frombuffer(template, np.uint8),
            _type(self.fields, size),
            np.array(self.constant, np.intp),
        )


def _type(fields: dict[str, tuple[Any, int]], size: int) -> np.dtype[np.void]:
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": size})


def varint(value: int) -> bytes:
    """Return a varint in its shortest form."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


@lru_cache(maxsize=1024)
def frame_layout(length: int, channel: bytes) -> Layout:
    """Return the wire layout of hil.Frame with `length` data bytes on the bus named `channel`."""
    builder = Builder()
    builder.bytes(b"\x0a\x0e\x0a\x0c\x08")
    builder.field("seconds", ("u1", (5,)))
    builder.bytes(b"\x10")
    builder.field("nanos", ("u1", (5,)))
    builder.tag(2, FIXED32)
    builder.field("id", "<u4")
    for name, number in {"is_rtr": 3, "is_extended": 4, "is_error": 5, "dlc": 6}.items():
        builder.tag(number, VARINT)
        builder.field(name, "u1")
    builder.tag(7, LENGTH)
    builder.bytes(varint(length))
    if length:
        builder.field("data", ("u1", (length,)))
    builder.tag(8, LENGTH)
    builder.bytes(varint(len(channel)) + channel)
    for name, number in {"direction": 9, "fdf": 10, "brs": 11, "esi": 12}.items():
        builder.tag(number, VARINT)
        builder.field(name, "u1")
    builder.tag(13, FIXED64)
    builder.field("tick", "<i8")
    builder.tag(14, FIXED32)
    builder.field("index", "<u4")
    builder.tag(15, VARINT)
    builder.field("bus", "u1")
    return builder.layout()


def frame_table(buses: Sequence[bytes], channel: int) -> tuple[Bytes, Ints]:
    """Return the templates of frames without data, one bus after the other, and their places (buses, 17).

    Of each bus: where its template begins, its size, where data go, where each of FRAME_PLACES is.
    """
    layouts = [frame_layout(0, bus) for bus in buses]
    sizes = [each.template.size for each in layouts]
    starts = np.cumsum([0, *sizes[:-1]])
    data = [frame_layout(1, bus).place("data") for bus in buses]
    places = [[each.place(name) for name in FRAME_PLACES] for each in layouts]
    table = np.column_stack((starts, sizes, data, places))
    return np.concatenate([each.of_channel(channel) for each in layouts]), np.ascontiguousarray(
        table, np.int64
    )
