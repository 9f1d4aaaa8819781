"""What a command and a reply of MIT framing say, compiled."""

from typing import Any

from drivers import motor_kernels as motors
from drivers.compiled.compiler import helper
from drivers.frame_pointers import place_of, whole
from drivers.mit.fields import TURN, unpack_motion
from drivers.motor_kernels import OWN_CODE
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.signals import DriveFault, DriveState

STRANGE = EXTENDED | FD | REMOTE | ERROR
REGISTERS = 0x7FF
"""Identifier of Damiao's requests."""
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
TIMEOUT, CTRL_MODE, SW_VER, SN, PMAX, VMAX, TMAX = 9, 10, 14, 15, 21, 22, 23
ENABLE, DISABLE, CLEAR, ZERO = 0xFC, 0xFD, 0xFB, 0xFE
"""After seven FF."""
TICKS_PER_S = 20_000
"""Of Damiao's TIMEOUT."""
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


@motors.hearing
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
