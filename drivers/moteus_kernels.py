"""The subframes of moteus, and what a command and a reply say, compiled.

mjlib multiplex, as the package moteus 1.1.1 has it: a head says kind, width (int8, int16, int32, float) and
count, 0 for a count that follows; counts and registers are varuints, values little-endian. The smallest
integer of a width stands for "not known".
"""

from bisect import bisect_left
from math import nan
from typing import Any

import numpy as np

from drivers import motor_device_kernels as drives
from drivers import motor_kernels as motors
from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import pointed
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, place_of, signed, whole
from drivers.motor_kernels import OWN_CODE
from drivers.protocol import BRS, ERROR, EXTENDED, FD, REMOTE
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
_WRITTEN = MODE, COMMAND + 2, COMMAND + 3, COMMAND + 4, COMMAND + 5, TIMEOUT
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


# drives' end


@helper
def ask(d: Any, leg: int, source: int, data: Any, size: int) -> None:
    """Remember who asks a drive for what, in its order, up to where it is not whole."""
    d.host[leg], at, found = source, 0, 0
    while at < size:
        kind, width, first, count, at = group(data, size, at)
        if kind in (ERRORS, NOT_WHOLE):
            break
        if kind == READ:
            for k in range(min(count, drives.MOST_ASKED - found)):
                d.wanted[leg, found], d.widths[leg, found] = first + k, width
                found += 1
        elif kind != NOTHING:
            at += min(count, size) * SIZES[width]
    d.asked[leg] = found


@helper
def _take_torque(d: Any, leg: int, values: Array, messages: int) -> int:
    """Take a command of position mode."""
    torque, most, timeout_s = values[1], values[4], values[5]
    if np.isnan(torque) or most <= 0.0 or values[2] != 0.0 or values[3] != 0.0:
        return drives.rejects(leg, NO_TORQUE_COMMAND, 0.0, messages)
    torque = min(max(torque, -most), most) if most > 0.0 else torque
    if d.enabled[leg]:
        return drives.commands(d, leg, drives.RUN, torque, messages, 0)
    watchdog_ns = d.watchdog_ns
    if timeout_s > 0.0:
        watchdog_ns = np.int64(np.rint(min(timeout_s * 1e9, _LONGEST_NS)))
    count = drives.configures(d, leg, watchdog_ns, messages, 0)
    return drives.enables(d, leg, torque, messages, count)


@pointed(record(drives.DEVICES), INTEGER, record(FRAME), INTEGER)
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Take a command of any controller; obey, then answer."""
    identifier, size, data, count = int(frame.id), int(frame.length), frame.data, 0
    if frame.flags & STRANGE or not frame.flags & FD:
        return 0
    if identifier > (0xFFFF if frame.flags & EXTENDED else 0x7FF):
        return 0
    values = np.array((0.0, 0.0, 1.0, 1.0, np.nan, np.nan))
    has = read(data, size, WRITE, _WRITTEN, values)
    if has < 0:
        return drives.ALONE | drives.rejects(leg, UNFINISHED, 0.0, messages)
    if has & 1 and values[0] == STOPPED:
        count = drives.commands(d, leg, drives.RESET, 0.0, messages, 0)
        count = drives.configures(d, leg, d.watchdog_ns, messages, count)
    elif has & 1 and values[0] == POSITION:
        count = _take_torque(d, leg, values, messages)
    elif has & 1:
        count = drives.rejects(leg, UNKNOWN_MODE, values[0], messages)
    if not identifier & REPLY_WANTED:
        return count
    ask(d, leg, identifier >> 8 & 0x7F, data, size)
    return drives.answers(leg, messages, count)


@helper
def _known(name: int) -> bool:
    """Tell whether a register is the firmware's version or the serial number."""
    return name == FIRMWARE or SERIAL_NUMBER <= name < SERIAL_NUMBER + 3


@helper
def _held(d: Any, said: Any, name: int) -> float:
    """Return the value of a register of a drive, in its own unit; NaN: not known."""
    in_fault = said.state == _FAULT
    timed_out = in_fault and said.fault == _WATCHDOG
    if name == MODE:
        mode = POSITION if said.state == _RUN else STOPPED
        return float(TIMED_OUT if timed_out else FAULTED if in_fault else mode)
    if name == FAULT:
        return float(drives.ear_at(d.ear).codes[said.fault]) if in_fault and not timed_out else 0.0
    if name in (PLACE, SPEED):
        return np.nan if said.lost else float(said.turns if name == PLACE else said.speed)
    if name == TORQUE:
        return float(said.torque)
    if name in (VOLTAGE, TEMPERATURE):
        return 24.0 if name == VOLTAGE else 30.0
    if name == SERIAL_NUMBER:
        return float(d.nodes[said.leg])
    if name == FIRMWARE:
        return float(VERSION)
    return 0.0 if name in (TRAJECTORY_COMPLETE, HOME_STATE) or _known(name) else np.nan


@helper
def _put(frame: Any, number: int) -> None:
    """Put a byte at the end of a frame, if there is room."""
    if frame.length < LENGTHS[-1]:
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
    size, raw = SIZES[width], 0
    if width == FLOAT:
        word = np.empty(1, np.float32)
        word[0] = number
        raw = int(word.view(np.uint32)[0])
    else:
        most = (1 << (8 * size - 1)) - 1
        scale = scale_of(name, width)
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
        if (first < READABLE <= name) or (name >= READABLE and not _known(name)):
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
            _put(frame, READ_ERROR)
            _put_register(frame, first)
            _put(frame, NO_REGISTER)
            at += 1
            continue
        _put(frame, REPLY | width << 2 | (count if count < 4 else 0))
        if count > 3:
            _put(frame, count)
        _put_register(frame, first)
        for name in range(first, first + count):
            _put_value(frame, _held(d, said, name), name, width)
        at += count
    for length in LENGTHS:
        if length >= frame.length:
            break
    while frame.length < length:
        _put(frame, NOP)
    return 0
