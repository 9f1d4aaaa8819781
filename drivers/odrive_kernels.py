"""What a frame of an ODrive says, and what an axis is sent in a tick, compiled."""

from typing import Any

import numpy as np

from drivers import motor_device_kernels as drives
from drivers import motor_kernels as motors
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, pointed
from drivers.ends import frame_at
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, place_of, whole
from drivers.motor_kernels import OWN_CODE, RETRY_TICKS
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState

ADDRESS = 0x06
"""Asked for by a remote frame it is answered with node number, serial number and connection."""
HEARTBEAT, ESTOP, AXIS_STATE, ESTIMATES, MODES, TORQUE, CLEAR = 0x01, 0x02, 0x07, 0x09, 0x0B, 0x0E, 0x18
IDLE, CLOSED_LOOP = 1, 8
"""Axis states."""
TORQUE_CONTROL = 1
"""Control mode."""
STRANGE_SIZE, NO_COMMAND, NO_STATE, NO_TORQUE_CONTROL, NO_TORQUE = range(1, 6)
"""Why a frame is rejected."""
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


@helper
def _fits(kind: int, size: int) -> bool:
    """Tell whether an axis takes so many bytes of what it hears."""
    if kind == CLEAR:
        return size <= 1
    return size == 8 or (size == 4 and kind != MODES)


@helper
def _ask_state(d: Any, data: Any, order: Any) -> int:
    """Take an axis state that is asked for."""
    leg, state, ready = order.leg, whole(data, 0), order.enabled != 0
    if state not in (IDLE, CLOSED_LOOP):
        return drives.rejects(order, NO_STATE, state)
    first = drives.register(d, leg, AXIS_STATE, -1.0) < 0.0
    if state == IDLE:
        drives.tells(order, drives.OFF, False)
        drives.configures(d, order, 1)
    else:
        if drives.register(d, leg, MODES, -1.0) != TORQUE_CONTROL:
            return drives.rejects(order, NO_TORQUE_CONTROL, 0.0)
        if not ready:
            drives.enables(order)
        if first:
            drives.configures(d, order, -1)
    if state == IDLE or first:
        drives.write(d, leg, AXIS_STATE, state)
    return 1


@pointed(record(drives.DEVICES), record(FRAME), record(drives.ORDER))
def obey(d: Any, frame: Any, order: Any) -> int:
    """Take a command, or the question for estimates."""
    kind, size, data = int(frame.id) & 0x1F, int(frame.length), frame.data
    if frame.flags & STRANGE:
        return 0
    if frame.flags & REMOTE:
        order.answers = kind == ESTIMATES and size == 0
        return FAILED if kind == ADDRESS and size == 0 else order.answers
    if kind == ESTOP:
        return FAILED
    if not COMMANDS >> kind & 1:
        return 0
    if kind not in (AXIS_STATE, MODES, TORQUE, CLEAR):
        return drives.rejects(order, NO_COMMAND, 0.0)
    if not _fits(kind, size):
        return drives.rejects(order, STRANGE_SIZE, 0.0)
    if kind == AXIS_STATE:
        return _ask_state(d, data, order)
    if kind == MODES:
        drives.write(d, order.leg, MODES, whole(data, 0))
    elif kind == CLEAR:
        drives.tells(order, drives.RESET, False)
    elif order.enabled:
        drives.tells(order, drives.RUN, True)
        order.torque = motors.single(data, 0)
        if not np.isfinite(order.torque):
            return drives.rejects(order, NO_TORQUE, 0.0)
    return 1


@pointed(record(drives.DEVICES), record(drives.SAID), record(FRAME))
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in estimates; a lost encoder has none: they are NaN."""
    begin_sent(frame, d.nodes[said.leg] << 5 | ESTIMATES, 8, 0, d.bus_of[said.leg])
    motors.put_single(np.nan if said.lost else said.turns, frame.data, 0)
    motors.put_single(np.nan if said.lost else said.speed, frame.data, 4)
    return 0


@pointed(record(drives.DEVICES), *[INTEGER] * 7)
def beat(
    d: Any, leg: int, state: int, fault: int, _watchdog_ns: int, _reaction: int, due: int, into: int
) -> int:
    """Fill in a heartbeat: error, state, procedure result, trajectory done. Changes wait for it."""
    if not due:
        return 0
    frame = frame_at(into)
    begin_sent(frame, d.nodes[leg] << 5 | HEARTBEAT, 8, 0, d.bus_of[leg])
    error = drives.ear_at(d.ear).codes[fault]
    for k in range(4):
        frame.data[k] = error >> 8 * k & 0xFF
    frame.data[4] = CLOSED_LOOP if state == _RUN else IDLE
    return 1
