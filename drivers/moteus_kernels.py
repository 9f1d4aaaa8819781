"""What a command and a reply of a moteus say, compiled."""

from typing import Any

import numpy as np

from drivers import moteus_registers as r
from drivers import motor_device_kernels as drives
from drivers import motor_kernels as motors
from drivers.arrays import Array
from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import pointed
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, place_of, signed, whole
from drivers.motor_kernels import OWN_CODE
from drivers.protocol import BRS, ERROR, EXTENDED, FD, REMOTE
from drivers.signals import DriveFault, DriveState

ALL_NODES = 0x7F
"""As destination: all drives."""
STOPPED, FAULTED, POSITION, TIMED_OUT = 0, 1, 10, 11
"""Modes."""
STRANGE = REMOTE | ERROR
_REGISTERS = *range(r.MODE, r.TORQUE + 1), r.FAULT, r.FIRMWARE, *range(r.SERIAL_NUMBER, r.SERIAL_NUMBER + 3)
"""Those that are read."""
_MODE, _PLACE, _SPEED, _TORQUE, _FAULT_CODE, _FIRMWARE, _SERIAL = range(7)
_STATE = 0b11111
"""The first five of them."""
_WRITTEN = r.MODE, r.COMMAND + 2, r.COMMAND + 3, r.COMMAND + 4, r.COMMAND + 5, r.TIMEOUT
"""Those that are obeyed: mode, torque, scales of the gains, most torque, time."""
REPLY_WANTED = 0x8000
"""Bit of an identifier."""
VERSION = 0x010000
"""Of the emulated drives' firmware."""
UNKNOWN_MODE, NO_TORQUE_COMMAND, UNFINISHED = range(1, 4)
"""Why a frame is rejected."""
_LONGEST_NS = float(1 << 61)
_OFF, _RUN, _FAULT = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)
_WATCHDOG = int(DriveFault.WATCHDOG)


@helper
def _raw(data: Any, at: int, width: int) -> float:
    """Return a value as it is packed, signed."""
    if width == r.FLOAT:
        return motors.single(data, at)
    size = r.SIZES[width]
    return float(signed(whole(data, at, size), 8 * size))


@helper
def read(data: Any, size: int, of: int, names: tuple[int, ...], values: Array) -> int:
    """Read registers of subframes of a kind into `values`; return bits of those there, -1 if not whole."""
    has = at = 0
    while at < size:
        kind, width, first, count, at = r.group(data, size, at)
        if kind == r.ERRORS:
            break
        if kind in (r.NOTHING, r.READ):
            continue
        if kind != of or count > size or at + count * r.SIZES[width] > size:
            return -1
        for k in range(len(names)):
            place = names[k] - first
            if 0 <= place < count:
                values[k] = r.value(names[k], width, _raw(data, at + place * r.SIZES[width], width))
                has |= 1 << k
        at += count * r.SIZES[width]
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
    has = max(read(frame.data, int(frame.length), r.REPLY, _REGISTERS, values), 0)
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


# drives' end


@helper
def _ask(d: Any, leg: int, source: int, data: Any, size: int) -> None:
    """Remember who asks a drive for what, in its order, up to where it is not whole."""
    d.host[leg], at, found = source, 0, 0
    while at < size:
        kind, width, first, count, at = r.group(data, size, at)
        if kind in (r.ERRORS, r.NOT_WHOLE):
            break
        if kind == r.READ:
            for k in range(min(count, drives.MOST_ASKED - found)):
                d.wanted[leg, found], d.widths[leg, found] = first + k, width
                found += 1
        elif kind != r.NOTHING:
            at += min(count, size) * r.SIZES[width]
    d.asked[leg] = found


@helper
def _take_torque(d: Any, values: Array, order: Any) -> int:
    """Take a command of position mode."""
    torque, most, timeout_s = values[1], values[4], values[5]
    if np.isnan(torque) or most <= 0.0 or values[2] != 0.0 or values[3] != 0.0:
        return drives.rejects(order, NO_TORQUE_COMMAND, 0.0)
    if order.enabled:
        drives.tells(order, drives.RUN, True)
    else:
        drives.enables(order)
        drives.configures(d, order, -1)
        if timeout_s > 0.0:
            order.watchdog_ns = np.int64(np.rint(min(timeout_s * 1e9, _LONGEST_NS)))
    order.torque = min(max(torque, -most), most) if most > 0.0 else torque
    return 1


@pointed(record(drives.DEVICES), record(FRAME), record(drives.ORDER))
def obey(d: Any, frame: Any, order: Any) -> int:
    """Take a command of any controller; obey, then answer."""
    identifier, size, data = int(frame.id), int(frame.length), frame.data
    if frame.flags & STRANGE or not frame.flags & FD:
        return 0
    if identifier > (0xFFFF if frame.flags & EXTENDED else 0x7FF):
        return 0
    values = np.array((0.0, 0.0, 1.0, 1.0, np.nan, np.nan))
    has = read(data, size, r.WRITE, _WRITTEN, values)
    if has < 0:
        return 1 + drives.rejects(order, UNFINISHED, 0.0)
    order.answers = identifier & REPLY_WANTED != 0
    if order.answers:
        _ask(d, order.leg, identifier >> 8 & 0x7F, data, size)
    if has & 1 and values[0] == STOPPED:
        drives.tells(order, drives.RESET, False)
        drives.configures(d, order, 1)
    elif has & 1 and values[0] == POSITION:
        return _take_torque(d, values, order)
    elif has & 1:
        return drives.rejects(order, UNKNOWN_MODE, values[0])
    return 1


@helper
def _known(name: int) -> bool:
    """Tell whether a register is the firmware's version or the serial number."""
    return name == r.FIRMWARE or r.SERIAL_NUMBER <= name < r.SERIAL_NUMBER + 3


@helper
def _held(d: Any, said: Any, name: int) -> float:
    """Return the value of a register of a drive, in its own unit; NaN: not known."""
    in_fault = said.state == _FAULT
    timed_out = in_fault and said.fault == _WATCHDOG
    if name == r.MODE:
        mode = POSITION if said.state == _RUN else STOPPED
        return float(TIMED_OUT if timed_out else FAULTED if in_fault else mode)
    if name == r.FAULT:
        return float(drives.ear_at(d.ear).codes[said.fault]) if in_fault and not timed_out else 0.0
    if name in (r.PLACE, r.SPEED):
        return np.nan if said.lost else float(said.turns if name == r.PLACE else said.speed)
    if name == r.TORQUE:
        return float(said.torque)
    if name in (r.VOLTAGE, r.TEMPERATURE):
        return 24.0 if name == r.VOLTAGE else 30.0
    if name == r.SERIAL_NUMBER:
        return float(d.nodes[said.leg])
    if name == r.FIRMWARE:
        return float(VERSION)
    return 0.0 if name in (r.TRAJECTORY_COMPLETE, r.HOME_STATE) or _known(name) else np.nan


@helper
def _put(frame: Any, number: int) -> None:
    """Put a byte at the end of a frame, if there is room."""
    if frame.length < r.LENGTHS[-1]:
        frame.data[frame.length] = number
        frame.length += 1


@helper
def _put_register(frame: Any, name: int) -> None:
    while name > 0x7F:
        _put(frame, name & 0x7F | 0x80)
        name >>= 7
    _put(frame, name)


@helper
def _put_value(frame: Any, number: float, name: int, width: int) -> None:
    """Put a value as a float, or as an integer of its scale, within the largest; the smallest for NaN."""
    size, raw = r.SIZES[width], 0
    if width == r.FLOAT:
        word = np.empty(1, np.float32)
        word[0] = number
        raw = int(word.view(np.uint32)[0])
    else:
        most = (1 << (8 * size - 1)) - 1
        scale = r.scale_of(name, width)
        scaled = number / (scale if scale != 0.0 else 1.0)
        raw = int(min(max(scaled, -float(most)), float(most))) if np.isfinite(number) else -most - 1
    for k in range(size):
        _put(frame, raw >> 8 * k & 0xFF)


@helper
def _together(d: Any, leg: int, at: int) -> int:
    """Return how many of the registers that are asked for, from a place on, one group answers; 0: none."""
    first, width, count = d.wanted[leg, at], d.widths[leg, at], 0
    while at + count < d.asked[leg]:
        name = d.wanted[leg, at + count]
        if name != first + count or d.widths[leg, at + count] != width:
            break
        if (first < r.READABLE <= name) or (name >= r.READABLE and not _known(name)):
            break
        count += 1
    return count


@pointed(record(drives.DEVICES), record(drives.SAID), record(FRAME))
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in what a drive answers to what it was asked, to whoever asked; it ends where a frame is full.

    A state that the drive does not know is NaN, or the smallest integer; another register that is not among
    what it says is an error.
    """
    leg, at = said.leg, 0
    identifier = d.nodes[leg] << 8 | d.host[leg]
    flags = FD | BRS | (EXTENDED if identifier > 0x7FF else 0)
    begin_sent(frame, identifier, 0, flags, d.bus_of[leg])
    while at < d.asked[leg]:
        first, width, count = d.wanted[leg, at], d.widths[leg, at], _together(d, leg, at)
        if count == 0:
            _put(frame, r.READ_ERROR)
            _put_register(frame, first)
            _put(frame, r.NO_REGISTER)
            at += 1
            continue
        _put(frame, r.REPLY | width << 2 | (count if count < 4 else 0))
        if count > 3:
            _put(frame, count)
        _put_register(frame, first)
        for name in range(first, first + count):
            _put_value(frame, _held(d, said, name), name, width)
        at += count
    for length in r.LENGTHS:
        if length >= frame.length:
            break
    while frame.length < length:
        _put(frame, r.NOP)
    return 0
