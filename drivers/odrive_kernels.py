"""What a frame of an ODrive says, and what an axis is sent in a tick, compiled."""

from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import FAILED, pointed
from drivers.frame_array import FRAME
from drivers.frame_pointers import place_of, whole
from drivers.motor_dialogue import OWN_CODE, RETRY_TICKS
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState

ADDRESS = 0x06
"""Asked for by a remote frame it is answered with node number, serial number and connection."""
HEARTBEAT, ESTOP, AXIS_STATE, ESTIMATES, MODES, TORQUE, CLEAR = 0x01, 0x02, 0x07, 0x09, 0x0B, 0x0E, 0x18
CLOSED_LOOP = 8
"""Axis state."""
COMMANDS = sum(
    1 << kind
    for kind in {
        ESTOP, AXIS_STATE, MODES, TORQUE, CLEAR,
        0x04, ADDRESS, 0x0C, 0x0D, *range(0x0F, 0x14), 0x16, 0x19, 0x1A, 0x1B, 0x1F,
    }
)  # fmt: skip
"""Bits of what a controller sends with data; the emulated axis has the first five."""
WATCHDOG_EXPIRED, STOP_REQUESTED = 0x1000000, 0x2000000
"""Errors of an axis that have a DriveFault of their own."""
STRANGE = EXTENDED | FD | ERROR
_UNHEARD = STRANGE | REMOTE
_OFF, _RUN, _FAULT = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)
_WATCHDOG, _ESTOP = int(DriveFault.WATCHDOG), int(DriveFault.ESTOP)
_ASKS_RUN, _ASKS_RESET = int(DriveMode.RUN), int(DriveMode.RESET)
_FRAME_BYTES = FRAME.itemsize


@pointed(record(motors.EAR), record(FRAME), record(motors.HEARD))
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Take estimates or a heartbeat."""
    identifier, data = int(frame.id), frame.data
    node, kind = identifier >> 5, identifier & 0x1F
    leg = place_of(node, ear.nodes)
    if frame.flags & _UNHEARD or identifier > 0x7FF or leg < 0:
        return 0
    if COMMANDS >> kind & 1:
        # an address that is set names another node
        own_address = kind == ADDRESS and frame.length == 8 and data[0] == node
        return 0 if own_address else motors.says(heard, leg, motors.FOREIGN)
    if kind not in (HEARTBEAT, ESTIMATES):
        return 0
    if frame.length != 8:
        return motors.says(heard, leg, motors.BROKEN)
    if kind == HEARTBEAT:
        motors.says(heard, leg, motors.POWER)
        error = whole(data, 0)
        heard.power = _FAULT if error else _RUN if data[4] == CLOSED_LOOP else _OFF
        if error == WATCHDOG_EXPIRED:
            heard.fault = _WATCHDOG
        elif error == STOP_REQUESTED:
            heard.fault = _ESTOP
        elif error:
            heard.fault = OWN_CODE + error
        return 1
    turns, speed = motors.single(data, 0), motors.single(data, 4)
    if not (np.isfinite(turns) and np.isfinite(speed)):
        return motors.says(heard, leg, motors.FEEDBACK)
    motors.says(heard, leg, motors.FEEDBACK | motors.MOTION)
    heard.turns, heard.speed = turns, speed
    return 1


@pointed(record(motors.MOTORS), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def push(m: Any, number: int, mode: int, _stop: int, force_at: int, into: int) -> int:
    """Put one frame an axis at an address, and one more where its loop is to be closed or errors cleared.

    Returns how many they are, or FAILED: a force does not fit.
    """
    before = m.mode
    if not motors.remember(m, mode, force_at):
        return FAILED
    begins = mode == _ASKS_RUN and before != _ASKS_RUN
    sent = 0
    for leg in range(LEGS):
        # a heartbeat of before RUN ended may have said that it was off
        if before == _ASKS_RUN and mode != _ASKS_RUN and m.power[leg] == _OFF:
            m.power[leg] = _RUN
        has_had_time = m.said[leg] - m.asked[leg] >= RETRY_TICKS
        idle = has_had_time and m.power[leg] == _OFF and not m.ran[leg]
        if begins or (mode == _ASKS_RUN and idle):
            m.asked[leg] = number
            motors.send(m, motors.ENABLE, leg, into + sent * _FRAME_BYTES)
            sent += 1
        motors.send_next(m, leg, into + sent * _FRAME_BYTES)
        sent += 1
        if mode == _ASKS_RESET:
            motors.send(m, motors.CLEAR, leg, into + sent * _FRAME_BYTES)
            sent += 1
    return sent
