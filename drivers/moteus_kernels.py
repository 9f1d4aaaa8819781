"""The subframes of moteus, and what a command and a reply say, compiled.

mjlib multiplex, as the package moteus 1.1.1 has it: a head says kind, width (int8, int16, int32, float) and
count, 0 for a count that follows; counts and registers are varuints, values little-endian. The smallest
integer of a width stands for "not known".
"""

from bisect import bisect_left
from math import nan
from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.arrays import Array
from drivers.compiled.compiler import helper
from drivers.frame_pointers import place_of, signed, whole
from drivers.motor_kernels import OWN_CODE
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.signals import DriveFault, DriveState

NOP = 0x50
WRITE, READ, REPLY, ERRORS = 0x00, 0x10, 0x20, 0x30
"""Kinds of subframes."""
NOT_WHOLE, NOTHING = -1, -2
"""In place of a kind: the data end within a group, or there is no group left."""
_MOST_BITS = 63
"""Of a number; no register and no count is as large."""
MODE, PLACE, SPEED, TORQUE = 0x000, 0x001, 0x002, 0x003
TRAJECTORY_COMPLETE, HOME_STATE, VOLTAGE, TEMPERATURE, FAULT = 0x00B, 0x00C, 0x00D, 0x00E, 0x00F
COMMAND, TIMEOUT = 0x020, 0x027
"""COMMAND begins position, velocity, feed-forward torque, scales of kp and kd, most torque."""
FIRMWARE, SERIAL_NUMBER = 0x101, 0x120
"""SERIAL_NUMBER begins three registers of 32 bits, the lowest first."""
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
    """Return the value of a register of a width; NaN where the drive does not know it."""
    scale = scale_of(register, width)
    if scale == 0.0:
        return float(raw)
    return nan if raw == -(1 << (8 * SIZES[width] - 1)) else raw * scale


ALL_NODES = 0x7F
"""As destination: all drives."""
STOPPED, FAULTED, POSITION, TIMED_OUT = 0, 1, 10, 11
"""Modes."""
STRANGE = REMOTE | ERROR
_REGISTERS = *range(MODE, TORQUE + 1), FAULT, FIRMWARE, *range(SERIAL_NUMBER, SERIAL_NUMBER + 3)
"""Those that are read."""
_MODE, _PLACE, _SPEED, _TORQUE, _FAULT_CODE, _FIRMWARE, _SERIAL = range(7)
_STATE = 0b11111
"""The first five of them."""
REPLY_WANTED = 0x8000
"""Bit of an identifier."""
_OFF, _RUN, _FAULT = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)
_WATCHDOG = int(DriveFault.WATCHDOG)


@helper
def read(data: Any, size: int, of: int, names: tuple[int, ...], values: Array) -> int:
    """Read registers of subframes of a kind into `values`; return bits of those there, -1 if not whole."""
    has = at = 0
    while at < size:
        kind, width, first, count, at = group(data, size, at)
        if kind == ERRORS:
            break
        if kind in (NOTHING, READ):
            continue
        wide = SIZES[width]
        if kind != of or count > size or at + count * wide > size:
            return -1
        for k in range(len(names)):
            place = names[k] - first
            if 0 <= place < count:
                start = at + place * wide
                if width == FLOAT:
                    raw = motors.single(data, start)
                else:
                    raw = float(signed(whole(data, start, wide), 8 * wide))
                values[k] = value(names[k], width, raw)
                has |= 1 << k
        at += count * wide
    return has


@helper
def _is_whole(number: float) -> bool:
    """Tell whether this is a whole number."""
    return bool(np.isfinite(number) and number == np.floor(number))


@helper
def _is_code(number: float) -> bool:
    """Tell whether this is a mode or a fault: both are asked for as int8."""
    return 0.0 <= number < 128.0 and _is_whole(number)


@helper
def _names_drive(has: int, values: Array) -> bool:
    """Tell whether registers say who a drive is."""
    if has >> _FIRMWARE & 1:
        return _is_whole(values[_FIRMWARE])
    for k in range(_SERIAL, _SERIAL + 3):  # noqa: SIM110 - compiled
        if not (has >> k & 1 and _is_whole(values[k])):
            return False
    return True


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Take a reply."""
    identifier = int(frame.id)
    if frame.flags & STRANGE or not frame.flags & FD:
        return 0
    if (frame.flags & EXTENDED != 0) != (identifier > 0x7FF):
        return 0
    to = place_of(identifier & ALL_NODES, ear.nodes)
    if identifier <= 0xFFFF and (to >= 0 or identifier & ALL_NODES == ALL_NODES):
        return motors.says(heard, max(to, 0), motors.FOREIGN)
    leg = place_of(identifier, ear.replies)
    if leg < 0:
        return 0
    values = np.zeros(len(_REGISTERS))
    has = max(read(frame.data, int(frame.length), REPLY, _REGISTERS, values), 0)
    if has & _STATE != _STATE:
        return motors.says(heard, leg, 0 if _names_drive(has, values) else motors.BROKEN)
    place, speed, torque = values[_PLACE], values[_SPEED], values[_TORQUE]
    infinite = np.isinf(place) or np.isinf(speed) or np.isinf(torque)
    if not (_is_code(values[_MODE]) and _is_code(values[_FAULT_CODE])) or infinite:
        return motors.says(heard, leg, motors.BROKEN)
    mode = int(values[_MODE])
    motors.says(heard, leg, motors.FEEDBACK | motors.POWER)
    heard.power = _RUN if mode == POSITION else _OFF
    if mode in (FAULTED, TIMED_OUT):
        heard.power = _FAULT
        heard.fault = _WATCHDOG if mode == TIMED_OUT else OWN_CODE + int(values[_FAULT_CODE])
    if not (np.isnan(place) or np.isnan(speed)):
        heard.has |= motors.MOTION
        heard.turns, heard.speed = place, speed
    if not np.isnan(torque):
        heard.has |= motors.TORQUE
        heard.torque = torque
    return 1
