"""What a reply of a moteus says, compiled."""

from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.arrays import Array
from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import pointed
from drivers.frame_array import FRAME
from drivers.frame_pointers import place_of, signed, whole
from drivers.moteus_registers import (
    ERRORS,
    FAULT,
    FIRMWARE,
    MODE,
    NOTHING,
    PLACE,
    READ,
    REPLY,
    SERIAL_NUMBER,
    SIZES,
    SPEED,
    TORQUE,
    group,
    value,
)
from drivers.motor_dialogue import OWN_CODE
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.signals import DriveFault, DriveState

ALL_NODES = 0x7F
"""As destination: all drives."""
STOPPED, FAULTED, POSITION, TIMED_OUT = 0, 1, 10, 11
"""Modes."""
STRANGE = REMOTE | ERROR
_FLOAT = 3
_REGISTERS = MODE, PLACE, SPEED, TORQUE, FAULT, FIRMWARE, *range(SERIAL_NUMBER, SERIAL_NUMBER + 3)
"""Those that are read."""
_MODE, _PLACE, _SPEED, _TORQUE, _FAULT_CODE, _FIRMWARE, _SERIAL = range(7)
_STATE = 0b11111
"""The first five of them."""
_OFF, _RUN, _FAULT = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)
_WATCHDOG = int(DriveFault.WATCHDOG)


@helper
def _raw(data: Any, at: int, width: int) -> float:
    """Return a value as it is packed, signed."""
    if width == _FLOAT:
        return motors.single(data, at)
    size = SIZES[width]
    return float(signed(whole(data, at, size), 8 * size))


@helper
def _read(data: Any, size: int, values: Array) -> int:
    """Read a reply into `values`, as _REGISTERS are; return bits of those there, 0 if it is not whole."""
    has = at = 0
    while at < size:
        kind, width, first, count, at = group(data, size, at)
        if kind == ERRORS:
            break
        if kind in (NOTHING, READ):
            continue
        if kind != REPLY or count > size or at + count * SIZES[width] > size:
            return 0
        for k in range(len(_REGISTERS)):
            place = _REGISTERS[k] - first
            if 0 <= place < count:
                values[k] = value(_REGISTERS[k], width, _raw(data, at + place * SIZES[width], width))
                has |= 1 << k
        at += count * SIZES[width]
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


@pointed(record(motors.EAR), record(FRAME), record(motors.HEARD))
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
    has = _read(frame.data, int(frame.length), values)
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
