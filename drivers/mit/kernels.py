"""What a command and a reply of MIT framing say, compiled."""

from typing import Any

import numpy as np

from drivers import motor_device_kernels as drives
from drivers import motor_kernels as motors
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import pointed
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, place_of, value, whole
from drivers.mit.fields import TURN, device_motion, unpack_motion
from drivers.motor_kernels import OWN_CODE
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.signals import DriveFault, DriveState

STRANGE = EXTENDED | FD | REMOTE | ERROR
REGISTERS = 0x7FF
"""Identifier of Damiao's requests."""
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
TIMEOUT, CTRL_MODE, SW_VER, SN, PMAX, VMAX, TMAX = 9, 10, 14, 15, 21, 22, 23
HELD = CTRL_MODE, TIMEOUT, PMAX, VMAX, TMAX, SN, SW_VER
"""The registers of an emulated drive, in the order of its record."""
_TIMEOUT_AT = HELD.index(TIMEOUT)
ENABLE, DISABLE, CLEAR, ZERO = 0xFC, 0xFD, 0xFB, 0xFE
"""After seven FF."""
_SPECIAL = (1 << 56) - 1
TICKS_PER_S = 20_000
"""Of Damiao's TIMEOUT."""
CUT, ZEROES = 1, 2
"""Why a frame is rejected."""
_OFF, _RUN, _FAULT = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)
_WATCHDOG = int(DriveFault.WATCHDOG)


@helper
def _answer(data: Any, leg: int, heard: Any) -> int:
    """Take the answer of a Damiao's register; of one that nobody here asks for the leg alone."""
    register = int(data[3])
    is_single = register in (PMAX, VMAX, TMAX)
    if not is_single and register not in (CTRL_MODE, TIMEOUT):
        return motors.says(heard, leg, 0)
    motors.says(heard, leg, motors.ANSWER)
    heard.register = register
    heard.value = motors.single(data, 4) if is_single else float(whole(data, 4))
    return 1


@helper
def _motion(ear: Any, data: Any, leg: int, power: int, code: int, heard: Any) -> int:
    """Take the motion in a reply; power: DriveState, -1 where it does not say."""
    place, position, velocity, torque = unpack_motion(data[1:6], ear)
    at_end = ear.clamps and place in (0, 0xFFFF)
    motors.says(heard, leg, motors.FEEDBACK | motors.TORQUE)
    heard.has |= 0 if power < 0 else motors.POWER
    if not at_end:
        heard.has |= motors.MOTION
        heard.turns, heard.speed = position / TURN, velocity / TURN
    heard.torque, heard.power = torque, max(power, 0)
    if code:
        heard.fault = _WATCHDOG if code == ear.silence else OWN_CODE + code
    return 1


@pointed(record(motors.EAR), record(FRAME), record(motors.HEARD))
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Take a reply: position turns, velocity turns/s, torque N m, status."""
    identifier, size, data = int(frame.id), int(frame.length), frame.data
    if frame.flags & STRANGE:
        return 0
    to = place_of(identifier, ear.nodes)
    if to >= 0 or (ear.registers and identifier == REGISTERS):
        return motors.says(heard, max(to, 0), motors.FOREIGN)
    first = place_of(identifier, ear.replies)
    if first < 0:
        return 0
    if not ear.shortest <= size <= ear.longest:
        return motors.says(heard, first, motors.BROKEN)
    head = int(data[0])
    if not ear.registers:
        leg, fault = place_of(head, ear.nodes), int(data[7]) if size == 8 else 0
        if leg < 0:
            return motors.says(heard, first, motors.BROKEN)
        return _motion(ear, data, leg, _FAULT if fault else -1, fault, heard)
    node = ear.nodes[first]
    # A status is 0, 1 or above 7, so only a disabled drive near the lower end of its position could look
    # like a register's answer: it has the position code 0x0033 or 0x0055 there.
    if head == node and data[1] == 0 and data[2] in (READ, WRITE):
        return _answer(data, first, heard)
    status = head >> 4
    if head & 0xF != node or (status > 1 and not ear.faults >> status & 1):
        return motors.says(heard, first, motors.BROKEN)
    if status > 1:
        return _motion(ear, data, first, _FAULT, status, heard)
    return _motion(ear, data, first, _RUN if status else _OFF, 0, heard)


@pointed(record(drives.DEVICES), INTEGER, record(FRAME), INTEGER)
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Take a command. Every frame to a drive is answered by its feedback."""
    if frame.flags & STRANGE:
        return 0
    if frame.length != 8:
        return drives.rejects(leg, CUT, 0.0, messages)
    ear, data, count = drives.ear_at(d.ear), frame.data, 0
    special = int(data[7]) if whole(data, 0, 7) == _SPECIAL else 0
    if special == ZERO:
        count = drives.rejects(leg, ZEROES, 0.0, messages)
    elif special == ENABLE:
        if not d.enabled[leg]:
            # set to what it was delivered with where no controller has set it up
            ticks = d.registers[leg, _TIMEOUT_AT] if ear.registers else 0.0
            watchdog_ns: Any = d.watchdog_ns
            if ticks > 0.0:
                watchdog_ns = np.int64(np.rint(ticks / TICKS_PER_S * 1e9))
            count = drives.configures(d, leg, watchdog_ns, messages, 0)
            count = drives.enables(d, leg, 0.0, messages, count)
    elif special == DISABLE:
        count = drives.commands(d, leg, drives.OFF, 0.0, messages, 0)
        if not ear.registers:
            count = drives.configures(d, leg, d.watchdog_ns, messages, count)
    elif special == CLEAR and ear.registers:
        count = drives.commands(d, leg, drives.RESET, 0.0, messages, 0)
    elif d.enabled[leg]:
        number = (int(data[6]) & 0xF) << 8 | int(data[7])
        torque = value(number, -ear.torque, ear.torque, 12)
        count = drives.commands(d, leg, drives.RUN, torque, messages, 0)
    return drives.answers(leg, messages, count)


@pointed(record(drives.DEVICES), record(drives.SAID), record(FRAME))
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in a reply. A lost encoder reads the lower end of the range: no field says so."""
    ear, leg = drives.ear_at(d.ear), said.leg
    begin_sent(frame, ear.replies[leg], ear.longest, 0, d.bus_of[leg])
    data, node = frame.data, d.nodes[leg]
    position = -ear.position if said.lost else said.turns * TURN
    motion = device_motion(position, said.speed * TURN, said.torque, ear, ear.clamps != 0)
    for k in range(5):
        data[1 + k] = motion[k]
    code = ear.codes[said.fault] if said.state == _FAULT else 0
    if ear.registers:
        status = code or int(said.state == _RUN)
        data[0], data[6], data[7] = status << 4 | node, 30, 30
    elif ear.longest == 8:
        data[0], data[6], data[7] = node, 30, code
    else:
        data[0], data[6] = node, 0x99
    return 0
