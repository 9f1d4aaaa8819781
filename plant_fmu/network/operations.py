"""Codec of the CAN operations of FMI-LS-BUS 1.0, chapter 4.4.1: little endian, packed, several in a binary.

An operation is op code (4 bytes), length with header (4 bytes), arguments, and for some a data length (2
bytes) with that many data bytes.
"""

import struct
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

from drivers.can.bus_time import FD_LENGTHS
from drivers.protocol import BRS, ESI, EXTENDED, FD, REMOTE, Frame


class Code(IntEnum):
    """Op codes."""

    FORMAT_ERROR = 0x01
    CAN_TRANSMIT = 0x10
    CAN_FD_TRANSMIT = 0x11
    CAN_XL_TRANSMIT = 0x12
    CONFIRM = 0x20
    ARBITRATION_LOST = 0x30
    BUS_ERROR = 0x31
    CONFIGURATION = 0x40
    STATUS = 0x41
    WAKEUP = 0x42


CAN_RATE, FD_RATE, XL_RATE, ARBITRATION_BEHAVIOR = range(1, 5)
"""First argument of CONFIGURATION."""
BUFFER, DISCARD = 1, 2
"""Values of ARBITRATION_BEHAVIOR: the bus keeps a frame that lost, or drops it and notifies the sender."""
ACTIVE, PASSIVE, BUS_OFF = 1, 2, 3
"""Argument of STATUS."""
HEADER = struct.Struct("<II")
MAX_DATA = 0xFFFF
"""Most data bytes of an operation."""
_BYTE, _BOOLEAN, _IDENTIFIER, _WORD = ("B", 0, 255), ("B", 0, 1), ("I", 0, 0x1FFFFFFF), ("I", 0, 0xFFFFFFFF)
"""(format, smallest, largest value) of an argument."""
_KIND, _RATE = ("B", 1, 4), ("I", 1, 0xFFFFFFFF)


class _Layout:
    """Arguments of one operation, and the data lengths that it allows; None: it has no data."""

    def __init__(self, *arguments: tuple[str, int, int], lengths: Iterable[int] | None = None) -> None:
        self.ranges = [(low, high) for _, low, high in arguments]
        self.lengths = None if lengths is None else frozenset(lengths)
        data_length = "" if lengths is None else "H"
        self.packed = struct.Struct("<" + "".join(form for form, _, _ in arguments) + data_length)


_LAYOUTS = {
    Code.FORMAT_ERROR: _Layout(lengths=range(MAX_DATA + 1)),
    Code.CAN_TRANSMIT: _Layout(_IDENTIFIER, _BOOLEAN, _BOOLEAN, lengths=range(9)),
    Code.CAN_FD_TRANSMIT: _Layout(_IDENTIFIER, _BOOLEAN, _BOOLEAN, _BOOLEAN, lengths=FD_LENGTHS),
    Code.CAN_XL_TRANSMIT: _Layout(
        _IDENTIFIER, _BOOLEAN, _BOOLEAN, _BYTE, _BYTE, _WORD, lengths=range(1, 2049)
    ),
    Code.CONFIRM: _Layout(_IDENTIFIER),
    Code.ARBITRATION_LOST: _Layout(_IDENTIFIER),
    Code.BUS_ERROR: _Layout(_IDENTIFIER, ("B", 1, 6), ("B", 1, 2), _BOOLEAN),
    Code.STATUS: _Layout(("B", ACTIVE, BUS_OFF)),
    Code.WAKEUP: _Layout(),
}
_CONFIGURATIONS = {
    **dict.fromkeys((CAN_RATE, FD_RATE, XL_RATE), _Layout(_KIND, _RATE)),
    ARBITRATION_BEHAVIOR: _Layout(_KIND, ("B", BUFFER, DISCARD)),
}
_TRANSMIT = {Code.CAN_TRANSMIT, Code.CAN_FD_TRANSMIT, Code.CAN_XL_TRANSMIT}


class Operation(NamedTuple):
    """One operation: its op code, its arguments in the order of the standard without lengths, its data."""

    code: Code
    arguments: tuple[int, ...] = ()
    data: bytes = b""


class Corrupt(NamedTuple):
    """Bytes of an operation that has an unknown op code, a wrong length or an invalid argument."""

    data: bytes


def encode(operations: Iterable[Operation]) -> bytes:
    """One binary of all `operations`. Their arguments are not checked. Raises struct.error, KeyError."""
    parts = []
    for code, arguments, data in operations:
        layout = _CONFIGURATIONS[arguments[0]] if code is Code.CONFIGURATION else _LAYOUTS[code]
        numbers = arguments if layout.lengths is None else (*arguments, len(data))
        length = HEADER.size + layout.packed.size + len(data)
        parts.append(HEADER.pack(code, length) + layout.packed.pack(*numbers) + data)
    return b"".join(parts)


def decode(binary: bytes) -> list[Operation | Corrupt]:
    """Operations of a binary in their order; never raises.

    An operation whose own length can be trusted is skipped if it is corrupt. Where the header is cut, or the
    length is shorter than the header or longer than the rest, the whole rest is one `Corrupt`.
    """
    found: list[Operation | Corrupt] = []
    at = 0
    while at < len(binary):
        rest = len(binary) - at
        code, length = HEADER.unpack_from(binary, at) if rest >= HEADER.size else (0, 0)
        if not HEADER.size <= length <= rest:
            found.append(Corrupt(binary[at:]))
            break
        operation = binary[at : at + length]
        found.append(_decoded(code, operation) or Corrupt(operation))
        at += length
    return found


def _decoded(number: int, binary: bytes) -> Operation | None:
    """The operation in `binary`, header included; None if it is corrupt."""
    begin = HEADER.size
    try:
        code = Code(number)
        layout = _CONFIGURATIONS[binary[begin]] if code is Code.CONFIGURATION else _LAYOUTS[code]
        values = list(layout.packed.unpack_from(binary, begin))
    except (IndexError, KeyError, ValueError, struct.error):
        return None
    data = binary[begin + layout.packed.size :]
    if layout.lengths is not None:
        stated = values.pop()
        if stated != len(data) or stated not in layout.lengths:
            return None
    elif data:
        return None
    if not all(low <= value <= high for value, (low, high) in zip(values, layout.ranges, strict=True)):
        return None
    if code in _TRANSMIT and not values[1] and values[0] > 0x7FF:
        return None
    return Operation(code, tuple(values), data)


def to_frame(operation: Operation) -> Frame:
    """Frame of a CAN Transmit or CAN FD Transmit."""
    identifier, extended, second, *more = operation.arguments
    flags = FD | BRS * second | ESI * more[0] if more else REMOTE * second
    return Frame(identifier, operation.data, flags | EXTENDED * extended)


def from_frame(frame: Frame) -> Operation:
    """CAN Transmit or CAN FD Transmit of a frame. A CAN FD frame is padded with zeros to a valid length."""
    identifier, data, flags = frame
    extended = int(bool(flags & EXTENDED))
    if not flags & FD:
        return Operation(Code.CAN_TRANSMIT, (identifier, extended, int(bool(flags & REMOTE))), data)
    padded = data.ljust(next(n for n in FD_LENGTHS if n >= len(data)), b"\0")
    switches = int(bool(flags & BRS)), int(bool(flags & ESI))
    return Operation(Code.CAN_FD_TRANSMIT, (identifier, extended, *switches), padded)
