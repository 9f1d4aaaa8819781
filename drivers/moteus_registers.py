"""The subframes of moteus: registers that are written, asked for and answered. Pure.

mjlib multiplex, as the package moteus 1.1.1 has it: a head says kind, width (int8, int16, int32, float) and
count, 0 for a count that follows; counts and registers are varuints, values little-endian. The smallest
integer of a width stands for "not known".
"""

from bisect import bisect_left
from math import nan
from typing import Any

from drivers.compiled.compiler import helper

NOP = 0x50
WRITE, READ, REPLY, ERRORS = 0x00, 0x10, 0x20, 0x30
"""Kinds of subframes."""
NOT_WHOLE, NOTHING = -1, -2
"""Instead of a kind: the data end within a group, or there is none."""
_MOST_BITS = 63
"""Of a number; no register and no count is as large."""
MODE, PLACE, SPEED, TORQUE = 0x000, 0x001, 0x002, 0x003
TRAJECTORY_COMPLETE, HOME_STATE, VOLTAGE, TEMPERATURE, FAULT = 0x00B, 0x00C, 0x00D, 0x00E, 0x00F
COMMAND, TIMEOUT = 0x020, 0x027
"""COMMAND begins position, velocity, feed-forward torque, scales of kp and kd, most torque."""
FIRMWARE, SERIAL_NUMBER = 0x101, 0x120
"""SERIAL_NUMBER begins three registers of 32 bits, the lowest first."""
READ_ERROR, NO_REGISTER = 0x31, 1
READABLE = 0x10
"""Registers below are states of the drive."""
FLOAT = 3
SIZES = (1, 2, 4, 4)
"""Bytes of a value, by its width."""
LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def pad(data: bytes) -> bytes:
    """Return the data filled up to the next length of CAN FD."""
    return data + bytes((NOP,)) * (LENGTHS[bisect_left(LENGTHS, len(data))] - len(data))


@helper
def _varuint(data: Any, size: int, at: int) -> tuple[int, int]:
    """Return a number of seven bits a byte, and where it ends; NOT_WHOLE if the data end before."""
    number = shift = 0
    while at < size:
        byte = int(data[at])
        at += 1
        if shift < _MOST_BITS:
            number |= (byte & 0x7F) << shift
        elif byte & 0x7F:
            number |= 1 << (_MOST_BITS - 1)
        shift += 7
        if byte < 0x80:
            return number, at
    return 0, NOT_WHOLE


@helper
def group(data: Any, size: int, at: int) -> tuple[int, int, int, int, int]:
    """Return kind, width, first register and count of the group at a place, and where its values begin.

    Kind NOTHING: it has none; ERRORS: it ends the frame; NOT_WHOLE.
    """
    head = int(data[at])
    at += 1
    kind, width, count = head & 0xF0, head >> 2 & 3, head & 3
    if head == NOP or kind == ERRORS:
        return NOTHING if head == NOP else kind, width, 0, 0, at
    if count == 0:
        count, at = _varuint(data, size, at)
        if count == 0:
            return NOTHING if at >= 0 else NOT_WHOLE, width, 0, 0, at
    first, at = _varuint(data, size, at)
    return kind if at >= 0 else NOT_WHOLE, width, first, count, at


@helper
def scale_of(register: int, width: int) -> float:
    """Return the scale of a register, 0 where it comes as it is."""
    if width == FLOAT:
        return 0.0
    if register in (PLACE, COMMAND):
        return (0.01, 0.0001, 0.00001)[width]
    if register in (SPEED, COMMAND + 1):
        return (0.1, 0.00025, 0.00001)[width]
    if register in (TORQUE, COMMAND + 2, COMMAND + 5):
        return (0.5, 0.01, 0.001)[width]
    if register == VOLTAGE:
        return (0.5, 0.1, 0.001)[width]
    if register == TEMPERATURE:
        return (1.0, 0.1, 0.001)[width]
    return (0.01, 0.001, 0.000001)[width] if register == TIMEOUT else 0.0


@helper
def value(register: int, width: int, raw: float) -> float:
    """Return what a register of a width holds, NaN for what is not known."""
    scale = scale_of(register, width)
    if scale == 0.0:
        return float(raw)
    return nan if raw == -(1 << (8 * SIZES[width] - 1)) else raw * scale
