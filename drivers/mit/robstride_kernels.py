"""What a command and a feedback of a RobStride say, compiled."""

from typing import Any

from drivers import motor_device_kernels as drives
from drivers import motor_kernels as motors
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, pointed
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, place_of, value, whole
from drivers.mit.fields import TURN, scaled
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


@pointed(record(motors.EAR), record(FRAME), record(motors.HEARD))
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


@pointed(record(drives.DEVICES), INTEGER, record(FRAME), INTEGER)
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Take a command, which is answered by feedback."""
    identifier = int(frame.id)
    kind, count = identifier >> 24, 0
    if not frame.flags & EXTENDED or frame.flags & STRANGE:
        return 0
    if kind not in (WHO, CONTROL, ENABLE, STOP, READ, WRITE):
        return 0
    if kind != WHO and frame.length != 8:
        return drives.rejects(leg, 1, 0.0, messages)
    if kind in (WHO, READ, WRITE):
        return FAILED
    if kind == ENABLE:
        if not d.enabled[leg]:
            count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
            count = drives.enables(d, leg, 0.0, messages, count)
    elif kind == STOP:
        mode = drives.RESET if frame.data[0] == 1 else drives.OFF
        count = drives.commands(d, leg, mode, 0.0, messages, 0)
    elif d.enabled[leg]:
        end = drives.ear_at(d.ear).torque
        torque = (identifier >> 8 & 0xFFFF) * 2.0 * end / 0xFFFF - end
        count = drives.commands(d, leg, drives.RUN, torque, messages, 0)
    return drives.answers(leg, messages, count)


@helper
def _put(data: Any, at: int, number: int) -> None:
    data[at], data[at + 1] = number >> 8, number & 0xFF


@pointed(record(drives.DEVICES), record(drives.SAID), record(FRAME))
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in a feedback; it saturates, a lost encoder reads the lower end."""
    ear, leg = drives.ear_at(d.ear), said.leg
    faults = ear.codes[said.fault] if said.state == _FAULT else 0
    mode = RUNNING if said.state == _RUN else RESETTING
    identifier = FEEDBACK << 24 | mode << 22 | faults << 16 | d.nodes[leg] << 8 | ear.host
    begin_sent(frame, identifier, 8, EXTENDED, d.bus_of[leg])
    position = -ear.position if said.lost else said.turns * TURN
    _put(frame.data, 0, scaled(position, ear.position, 16, True))
    _put(frame.data, 2, scaled(said.speed * TURN, ear.velocity, 16, True))
    _put(frame.data, 4, scaled(said.torque, ear.torque, 16, True))
    _put(frame.data, 6, 250)
    return 0
