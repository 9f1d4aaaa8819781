"""Emulated moteus drives: one answers whoever asks what he asks for.

Of modes it has stop and torque; it refuses others, and still answers.
"""

from typing import Any

import numpy as np

from drivers import moteus as k
from drivers.arrays import Array
from drivers.can.bus_time import FD_LENGTHS
from drivers.compiled.compiler import helper
from drivers.frame_pointers import begin_sent
from drivers.protocol import BRS, EXTENDED, FD
from drivers.signals import LEGS, DriveFault
from drivers.tick_columns import Record
from plant_fmu.drives import motors as drives

READ_ERROR, NO_REGISTER = 0x31, 1
READABLE = 0x10
"""Registers below are states of the drive."""
_WRITTEN = k.MODE, k.COMMAND + 2, k.COMMAND + 3, k.COMMAND + 4, k.COMMAND + 5, k.TIMEOUT
"""Those that are obeyed: mode, torque, scales of the gains, most torque, time."""
VERSION = 0x010000
"""Of the emulated drives' firmware."""
_LONGEST_NS = float(1 << 61)
_WATCHDOG = int(DriveFault.WATCHDOG)


@helper
def ask(d: Any, leg: int, source: int, data: Any, size: int) -> None:
    """Remember who asks a drive for what, in its order, up to where it is not whole."""
    d.host[leg], at, found = source, 0, 0
    while at < size:
        kind, width, first, count, at = k.group(data, size, at)
        if kind in (k.ERRORS, k.NOT_WHOLE):
            break
        if kind == k.READ:
            for n in range(min(count, drives.MOST_ASKED - found)):
                d.wanted[leg, found], d.widths[leg, found] = first + n, width
                found += 1
        elif kind != k.NOTHING:
            at += min(count, size) * k.SIZES[width]
    d.asked[leg] = found


@helper
def _take_torque(d: Any, leg: int, values: Array, messages: int) -> int:
    torque, most, timeout_s = values[1], values[4], values[5]
    if np.isnan(torque) or most <= 0.0 or values[2] != 0.0 or values[3] != 0.0:
        return drives.rejects(leg, messages)
    torque = min(max(torque, -most), most) if most > 0.0 else torque
    if d.enabled[leg]:
        return drives.commands(d, leg, drives.RUN, torque, messages, 0)
    watchdog_ns = d.watchdog_ns
    if timeout_s > 0.0:
        watchdog_ns = np.int64(np.rint(min(timeout_s * 1e9, _LONGEST_NS)))
    count = drives.configures(d, leg, watchdog_ns, messages, 0)
    return drives.enables(d, leg, torque, messages, count)


@drives.obeying
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Take a command of any controller; obey, then answer."""
    identifier, size, data, count = int(frame.id), int(frame.length), frame.data, 0
    if frame.flags & k.STRANGE or not frame.flags & FD:
        return 0
    if identifier > (0xFFFF if frame.flags & EXTENDED else 0x7FF):
        return 0
    values = np.array((0.0, 0.0, 1.0, 1.0, np.nan, np.nan))
    has = k.read(data, size, k.WRITE, _WRITTEN, values)
    if has < 0:
        return drives.ALONE | drives.rejects(leg, messages)
    if has & 1 and values[0] == k.STOPPED:
        count = drives.commands(d, leg, drives.RESET, 0.0, messages, 0)
        count = drives.configures(d, leg, d.watchdog_ns, messages, count)
    elif has & 1 and values[0] == k.POSITION:
        count = _take_torque(d, leg, values, messages)
    elif has & 1:
        count = drives.rejects(leg, messages)
    if not identifier & k.REPLY_WANTED:
        return count
    ask(d, leg, identifier >> 8 & 0x7F, data, size)
    return drives.answers(leg, messages, count)


@helper
def _is_known(name: int) -> bool:
    return name == k.FIRMWARE or k.SERIAL_NUMBER <= name < k.SERIAL_NUMBER + 3


@helper
def _held(d: Any, said: Any, name: int) -> float:
    """Return the value of a register of a drive, in its own unit; NaN: not known."""
    timed_out = said.fails and said.fault == _WATCHDOG
    if name == k.MODE:
        mode = k.POSITION if said.runs else k.STOPPED
        return float(k.TIMED_OUT if timed_out else k.FAULTED if said.fails else mode)
    if name == k.FAULT:
        return 0.0 if timed_out else float(said.code)
    if name in (k.PLACE, k.SPEED):
        return np.nan if said.lost else float(said.turns if name == k.PLACE else said.speed)
    if name == k.TORQUE:
        return float(said.torque)
    if name in (k.VOLTAGE, k.TEMPERATURE):
        return 24.0 if name == k.VOLTAGE else 30.0
    if name == k.SERIAL_NUMBER:
        return float(d.nodes[said.leg])
    if name == k.FIRMWARE:
        return float(VERSION)
    return 0.0 if name in (k.TRAJECTORY_COMPLETE, k.HOME_STATE) or _is_known(name) else np.nan


@helper
def _put(frame: Any, number: int) -> None:
    """Put a byte at the end of a frame, if there is room."""
    if frame.length < FD_LENGTHS[-1]:
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
    size, raw = k.SIZES[width], 0
    if width == k.FLOAT:
        word = np.empty(1, np.float32)
        word[0] = number
        raw = int(word.view(np.uint32)[0])
    else:
        most = (1 << (8 * size - 1)) - 1
        scale = k.scale_of(name, width)
        scaled = number / (scale if scale != 0.0 else 1.0)
        raw = int(min(max(scaled, -float(most)), float(most))) if np.isfinite(number) else -most - 1
    for n in range(size):
        _put(frame, raw >> 8 * n & 0xFF)


@helper
def _together(d: Any, leg: int, at: int) -> int:
    """Return how many of the registers that are asked for, from a place on, one k.group answers; 0: none."""
    first, width, count = d.wanted[leg, at], d.widths[leg, at], 0
    while at + count < d.asked[leg]:
        name = d.wanted[leg, at + count]
        if name != first + count or d.widths[leg, at + count] != width:
            break
        if (first < READABLE <= name) or (name >= READABLE and not _is_known(name)):
            break
        count += 1
    return count


@drives.encoding
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
        _put(frame, k.REPLY | width << 2 | (count if count < 4 else 0))
        if count > 3:
            _put(frame, count)
        _put_register(frame, first)
        for name in range(first, first + count):
            _put_value(frame, _held(d, said, name), name, width)
        at += count
    for length in FD_LENGTHS:
        if length >= frame.length:
            break
    while frame.length < length:
        _put(frame, k.NOP)
    return 0


class MoteusDrives(drives.MotorDrives):
    """Six drives."""

    obey, encode = obey, encode
    everyone = k.ALL_NODES
    codes, otherwise = {DriveFault.OVERFORCE: 33, DriveFault.SENSOR: 35, DriveFault.STROKE: 39}, 33

    def power_up(self, d: Record) -> None:
        """Let drives that have heard nothing answer our query."""
        for leg in range(LEGS):
            ask(d.view(np.recarray), leg, self.family.host, k.QUERY, len(k.QUERY))
