"""Emulated moteus drives: they answer any controller with the registers that it requests.

They have the modes stopped and position, the latter with gains scaled to 0, which is torque control. They
refuse other modes, but still answer.
"""

from typing import Any

import numpy as np

from drivers import moteus as k
from drivers.arrays import Array
from drivers.can.bus_time import FD_LENGTHS
from drivers.compiled.compiler import helper
from drivers.frame_pointers import begin_sent
from drivers.protocol import EXTENDED, FD
from drivers.signals import LEGS, DriveFault
from drivers.tick_columns import Record
from plant_fmu.drives import motors as drives

READ_ERROR, NO_REGISTER = 0x31, 1
READABLE = 0x10
"""First register that is not a state: below it every register can be read."""
_WRITTEN = k.MODE, k.COMMAND + 2, k.COMMAND + 3, k.COMMAND + 4, k.COMMAND + 5, k.TIMEOUT
"""Registers that a write changes: mode, torque, scales of both gains, torque limit, watchdog time."""
VERSION = 0x010000
"""Firmware version of the emulated drives."""
_LONGEST_NS = float(1 << 61)
_WATCHDOG = int(DriveFault.WATCHDOG)


@helper
def ask(d: Any, leg: int, source: int, data: Any, size: int) -> None:
    """Store who requests which registers of a drive, in order, up to the first malformed subframe."""
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
    """Execute any controller's command as MESSAGEs, with an answer if requested; result as in `motors`."""
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
    """Value of a drive's register, in the register's unit; NaN if the drive does not have it."""
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
    """Append a register's value as float32, or as a scaled, saturated integer; NaN as the smallest one."""
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
def _consecutive(d: Any, leg: int, at: int) -> int:
    """Number of requested registers from index `at` that fit one subframe; 0: unknown register."""
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
    """Fill in the reply to the last request, whoever sent it; it ends when the frame is full.

    A state that the drive does not have is NaN or the smallest integer; any other unknown register is an
    error.
    """
    leg, at = said.leg, 0
    identifier = d.nodes[leg] << 8 | d.host[leg]
    flags = drives.ear_at(d.ear).flags | (EXTENDED if identifier > 0x7FF else 0)
    begin_sent(frame, identifier, 0, flags, d.bus_of[leg])
    while at < d.asked[leg]:
        first, width, count = d.wanted[leg, at], d.widths[leg, at], _consecutive(d, leg, at)
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
    """The drives' end of six moteus drives."""

    obey, encode = obey, encode
    everyone = k.ALL_NODES
    codes, otherwise = {DriveFault.OVERFORCE: 33, DriveFault.SENSOR: 35, DriveFault.STROKE: 39}, 33

    def power_up(self, d: Record) -> None:
        """Set our own query as pending, so that drives report its registers before it has arrived."""
        for leg in range(LEGS):
            ask(d.view(np.recarray), leg, self.family.host, k.QUERY, len(k.QUERY))
