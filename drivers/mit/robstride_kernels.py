"""What a command and a feedback of a RobStride say, compiled."""

from typing import Any

from drivers import motor_kernels as motors
from drivers.compiled.compiler import helper
from drivers.frame_pointers import place_of, value, whole
from drivers.mit.fields import TURN
from drivers.motor_kernels import OWN_CODE
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.signals import DriveState

WHO, CONTROL, FEEDBACK, ENABLE, STOP, READ, WRITE = 0, 1, 2, 3, 4, 17, 18
RESETTING, CALIBRATING, RUNNING = range(3)
"""Mode of a feedback."""
STRANGE = FD | REMOTE | ERROR
_OFF, _RUN, _FAULT = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)


@helper
def _feedback(ear: Any, data: Any, leg: int, mode: int, faults: int, heard: Any) -> int:
    """Take a feedback."""
    p, v = int(data[0]) << 8 | int(data[1]), int(data[2]) << 8 | int(data[3])
    t = int(data[4]) << 8 | int(data[5])
    at_end = p in (0, 0xFFFF)
    motors.says(heard, leg, motors.FEEDBACK | motors.TORQUE | motors.POWER | (0 if at_end else motors.MOTION))
    if not at_end:
        heard.turns = value(p, -ear.position, ear.position, 16) / TURN
        heard.speed = value(v, -ear.velocity, ear.velocity, 16) / TURN
    heard.torque = value(t, -ear.torque, ear.torque, 16)
    heard.power = _FAULT if faults else _RUN if mode == RUNNING else _OFF
    heard.fault = OWN_CODE + faults if faults else 0
    return 1


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Take a feedback, or a register's answer."""
    if not frame.flags & EXTENDED or frame.flags & STRANGE:
        return 0
    identifier = int(frame.id)
    kind, middle, target = identifier >> 24, identifier >> 8 & 0xFFFF, identifier & 0xFF
    to = place_of(target, ear.nodes)
    if to >= 0 and kind in (CONTROL, ENABLE, STOP, READ, WRITE):
        return motors.says(heard, to, motors.FOREIGN)
    leg = place_of(middle & 0xFF, ear.nodes)
    if target != ear.host or leg < 0 or kind not in (FEEDBACK, READ):
        return 0
    if frame.length != 8:
        return motors.says(heard, leg, motors.BROKEN)
    data = frame.data
    if kind == READ:
        motors.says(heard, leg, motors.ANSWER)
        heard.register, heard.value = whole(data, 0, 2), float(data[4])
        return 1
    return _feedback(ear, data, leg, middle >> 14, middle >> 8 & 0x3F, heard)
