"""Emulated ODrive axes: they implement ESTOP, AXIS_STATE, MODES, TORQUE and CLEAR."""

from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers import odrive as o
from drivers.compiled.compiler import helper
from drivers.compiled.pointed import FAILED
from drivers.frame_pointers import begin_sent, frame_at, whole
from drivers.protocol import REMOTE, Frame
from drivers.sensing.kernels import put_single
from drivers.signals import DriveFault, DriveState
from plant_fmu.drives import motors as drives
from plant_fmu.drives.codec import STOP

_RUN = int(DriveState.RUN)
_STATE, _CONTROL_MODE = 0, 1
"""Registers of an emulated axis: the last requested state, and the control mode; 0: none yet."""


@helper
def _ask_state(d: Any, leg: int, data: Any, messages: int) -> int:
    state, held, count = whole(data, 0), d.registers[leg], 0
    if state not in (o.IDLE, o.CLOSED_LOOP):
        return drives.rejects(leg, messages)
    first = held[_STATE] == 0.0
    if state == o.IDLE:
        count = drives.commands(d, leg, drives.OFF, 0.0, messages, 0)
        count = drives.configures(d, leg, d.watchdog_ns, messages, count)
    else:
        if held[_CONTROL_MODE] != o.TORQUE_CONTROL:
            return drives.rejects(leg, messages)
        if first:
            count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
        if not d.enabled[leg]:
            count = drives.enables(d, leg, 0.0, messages, count)
    if state == o.IDLE or first:
        held[_STATE] = state
    return count


@drives.obeying
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Execute a command, or answer a request for estimates; result: see `plant_fmu.drives.motors`."""
    kind, size, data = int(frame.id) & 0x1F, int(frame.length), frame.data
    if frame.flags & o.NOT_OURS:
        return 0
    if frame.flags & REMOTE:
        if kind == o.ADDRESS and size == 0:
            return FAILED
        return drives.answers(leg, messages, 0) if kind == o.ESTIMATES and size == 0 else 0
    if kind == o.ESTOP:
        return FAILED
    if not o.COMMANDS >> kind & 1:
        return 0
    fits = size <= 1 if kind == o.CLEAR else size == 8 or (size == 4 and kind != o.MODES)
    if not fits or kind not in (o.AXIS_STATE, o.MODES, o.TORQUE, o.CLEAR):
        return drives.rejects(leg, messages)
    if kind == o.AXIS_STATE:
        return _ask_state(d, leg, data, messages)
    if kind == o.CLEAR:
        return drives.commands(d, leg, drives.RESET, 0.0, messages, 0)
    if kind == o.MODES:
        d.registers[leg, _CONTROL_MODE] = whole(data, 0)
    elif d.enabled[leg]:
        torque = motors.single(data, 0)
        if not np.isfinite(torque):
            return drives.rejects(leg, messages)
        return drives.commands(d, leg, drives.RUN, torque, messages, 0)
    return 0


@drives.encoding
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in a frame of encoder estimates, turns and turns/s; NaN for a lost encoder."""
    begin_sent(frame, d.nodes[said.leg] << 5 | o.ESTIMATES, 8, 0, d.bus_of[said.leg])
    put_single(np.nan if said.lost else said.turns, frame.data, 0)
    put_single(np.nan if said.lost else said.speed, frame.data, 4)
    return 0


@drives.reporting
def beat(
    d: Any, leg: int, state: int, fault: int, _watchdog_ns: int, _reaction: int, due: int, into: int
) -> int:
    """Write a heartbeat with error and state to address `into` if it is due; none at a change of state."""
    if not due:
        return 0
    frame = frame_at(into)
    begin_sent(frame, d.nodes[leg] << 5 | o.HEARTBEAT, 8, 0, d.bus_of[leg])
    error = d.codes[fault]
    for k in range(4):
        frame.data[k] = error >> 8 * k & 0xFF
    frame.data[4] = o.CLOSED_LOOP if state == _RUN else o.IDLE
    return 1


class ODriveDrives(drives.MotorDrives):
    """The drives' end of six ODrive axes."""

    obey, encode, beat = obey, encode, beat
    codes = {
        DriveFault.WATCHDOG: o.WATCHDOG_EXPIRED,
        DriveFault.ESTOP: o.STOP_REQUESTED,
        DriveFault.OVERFORCE: 0x1000,
        DriveFault.SENSOR: 0x8,
        DriveFault.STROKE: 0x10000,
    }

    def request(self, leg: int | None, frame: Frame) -> None:
        """Process Estop, or a request for the serial number."""
        assert leg is not None
        node = self.family.nodes[leg]
        if frame.id & 0x1F == o.ADDRESS:
            said = bytes((node,)) + node.to_bytes(6, "little") + b"\0"
            self.say(leg, Frame(frame.id, said))
        else:
            self.record["enabled"][leg] = 0
            self.put(STOP, (leg,))
