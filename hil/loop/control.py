"""The record that the cycle (Python) and the compiled part of a tick share, and its owner."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.compiled.pointed import data_at
from drivers.signals import DriveState, Fault, Mode, Stop, Warn
from drivers.tick_columns import Record, new_record
from hil.estimation.external_wrench import hear_sensors
from hil.loop.compiled_pass import ALL, COMMAND, CONTROL, EFFORT, JUDGE, NEVER, WHOLE, act
from hil.loop.modes import DRIVE_PATIENCE_S, ENDING, NOT_MEASURED, STEERED, STOPPABLE, drive_mode
from hil.trajectory.path import SAMPLE

_ANY = (1 << len(DriveState)) - 1
_ENDS_WITH = {
    Mode.LOADING: 1 << DriveState.READY,
    Mode.RELEASING: 1 << DriveState.RUN,
    Mode.PARKING: 1 << DriveState.READY | 1 << DriveState.FAULT,
    Mode.UNLOADING: _ANY,
}
"""Modes that end after a time, and the states in which all six drives must be for that, as bits."""
_WATCHED = frozenset({Mode.WAITING, Mode.FAULT, Mode.HELD})
"""Modes in which the cycle decides in each tick."""


def ticks_from(seconds: float, period_s: float, *, beyond: bool = False) -> int:
    """Fewest ticks that last at least `seconds`, or, with `beyond`, longer than `seconds`."""
    n = max(ceil(seconds / period_s) - 1, 0)
    while n * period_s < seconds or (beyond and n * period_s == seconds):
        n += 1
    return n


class Control:
    """The control record, shared with compiled code, and the arrays to which it points.

    `settle` copies the cycle's decisions into the record. Mutable state: the record.
    """

    def __init__(self, cycle: Any) -> None:
        """Build the record for a `hil.loop.cycle.Cycle` with all its parts, before their first reset."""
        self._cycle = cycle
        parts, effort = cycle.parts, cycle.effort
        self.record: Record = np.zeros((), CONTROL)
        self.probes = False
        self._sample, self._ahead = np.zeros((), SAMPLE), new_record()
        c, end = self.record, cycle.end
        c["decode"], c["command"], c["codec"] = end.decode, end.command, end.codec
        c["decoder"] = end.codec
        c["estimator"] = data_at(cycle.sight.estimator.record)
        for name, value in parts.safety.places().items():
            c[name] = value
        c["sample"], c["ahead"] = data_at(self._sample), data_at(self._ahead)
        c["base_joints"], c["platform_joints"] = parts.platform.base_joints, parts.platform.platform_joints
        c["period_s"], c["load_s"] = cycle.period_s, cycle.durations.load
        c["blend_s"], c["reach_N"] = parts.engage.blend_s, effort.reach_N
        c["law"], c["gains"], c["constants"], c["code"] = effort.law[:4]
        c["robot"] = data_at(effort.model.constants)
        if parts.last_pose is not None:
            from hil.loop import homing_kernels  # noqa: PLC0415 - compiled code that few robots need

            homing = cycle.homing.record
            homing["decode"], homing["codec"] = end.decode, end.codec
            c["decode"], c["decoder"] = homing_kernels.decode.address, data_at(homing)
        c["sensors"] = data_at(cycle.sight.sensors.record)
        if parts.steering is not None:
            c["steer"], c["live"] = parts.steering.trajectory.steer[:2]
            c["judge"], c["admission"] = parts.steering.judge[:2]
        if parts.sensors is not None:
            from hil.estimation.sensor_check import compare  # noqa: PLC0415 - compiled code that few robots need

            c["hear"], c["compare"] = hear_sensors.address, compare.address
        if parts.fusion is not None:
            c["fuse"], c["filter"] = parts.fusion.fuse[:2]
        load, c["loads"] = parts.wrench.look[:2]
        c["last_load"] = data_at(parts.wrench.last)
        if parts.wrench.has_source or parts.sensors is not None:
            c["load"] = load
        c["has_load"] = parts.wrench.has_source
        c["senses_wrench"] = parts.wrench.has_source and parts.wrench.observer is None
        if effort.learned is not None:
            c["learn"], c["learner"] = effort.learned.look[:2]
        if parts.predictor is not None:
            c["predict"], c["predictor"] = parts.predictor.look[:2]
            c["horizon_s"] = parts.predictor.horizon_s
        for k, follower in enumerate((parts.predictor, parts.wrench.observer)):
            if follower is not None:
                c["paths"][k] = data_at(follower.path.record)

    def settle(self, *, attentive: bool = False) -> None:
        """Copy the cycle's decisions into the record; attentive: let it see safety's result as well."""
        cycle, c = self._cycle, self.record
        mode, operating, motion, effort = cycle.mode, cycle.operating, cycle.motion, cycle.effort
        period_s = cycle.period_s
        self.probes = cycle.watches or cycle.obedience.refused is not None
        cycle.homing.record["braked"] = cycle.proven
        c["mode"], c["mode_tick"], c["faults"] = mode, cycle.mode_tick, cycle.faults
        c["command_mode"], c["located"] = drive_mode(mode), cycle.sight.located
        least = cycle.durations.least(mode)
        states = _ENDS_WITH.get(mode, 0)
        c["due"], c["due_states"] = ticks_from(least, period_s) if states else NEVER, states
        waits = mode in {Mode.LOADING, Mode.RELEASING, Mode.PARKING}
        c["overdue"] = ticks_from(least + DRIVE_PATIENCE_S, period_s, beyond=True) - 1 if waits else NEVER
        stays = operating.stays(mode)
        c["ends"] = mode in ENDING and not motion.away and not (stays and motion.resting)
        patience = operating.patience
        key_tick = operating.key_tick if operating.go else None
        c["key_until"] = NEVER if patience is None or key_tick is None else key_tick + patience
        steering = cycle.parts.steering
        under_way = steering is not None and mode in STEERED and motion.trajectory is cycle.parts.trajectory
        c["live_since"] = motion.tick if under_way else NEVER
        stops = cycle.stop_requested is not Stop.NONE
        c["watchful"] = (
            mode in _WATCHED
            or cycle.yields
            or (steering is not None and steering.answered)
            or motion.away
            or operating.busy(mode)
            or (stops and mode in STOPPABLE)
            or (mode is Mode.STOPPING and operating.parks and (stops or bool(cycle.faults)))
        )
        c["attentive"] = (
            attentive or mode in _WATCHED or cycle.estop or bool(cycle.faults & Fault.SECOND_CONTROLLER)
        )
        c["on_path"], c["fusing"] = not motion.away, cycle.sight.fusing
        c["rotation"] = data_at(cycle.sight.rotation)
        c["along"] = effort.learned is not None and effort.learned.along(mode, motion)
        c["fixed"] = (mode is Mode.HELD and bool(cycle.faults & NOT_MEASURED)) or cycle.yields
        c["holding"], c["offset"] = effort.holding, effort.offset
        c["entry_tick"] = WHOLE if effort.entry_tick is None else effort.entry_tick
        if steering is not None:
            c["setpoints"] = steering.counts

    def act(self, tick: Record, into: Rows) -> int:
        """Run a tick from its reference to its command in `into`; returns the `compiled_pass.act` status."""
        if not self.probes:
            return act(self.record, tick, into, ALL)
        while act(self.record, tick, into, EFFORT):
            self.stop_on_the_way()
        self.probe(tick)
        return act(self.record, tick, into, JUDGE | COMMAND)

    def stop_on_the_way(self) -> None:
        """Count a refused step of the live trajectory, which has stopped it on its way to a set-point."""
        steering = self._cycle.parts.steering
        assert steering is not None
        steering.stopped(int(self.record["verdict"][0]))
        self.settle(attentive=bool(self.record["attentive"]))

    def probe(self, tick: Record) -> None:
        """Check that the legs obey the holding force; set the force of a leg that does not to 0."""
        cycle, watch = self._cycle, self._cycle.obedience
        last_tau = cycle.effort.last_tau
        if cycle.watches and watch.watch(tick, last_tau):
            cycle.faults |= Fault.DRIVE
            self.record["faults"] = cycle.faults
            held = last_tau.copy()
            held[watch.refused] = 0.0
            cycle.parts.safety.resume(held)
        if watch.refused is not None:
            tick["tau_asked"][watch.refused] = 0.0
            tick["legs_refused"] = 1 << watch.refused

    def reset(self) -> None:
        """Restore the state before the first tick."""
        motion = self._cycle.motion
        self.record["shortfall"] = 0.0
        self.record["motion"], self.record["override"] = (
            data_at(motion.record),
            data_at(motion.override.record),
        )
        self.settle()

    def load(self, tick: Record) -> None:
        """Fill in the external wrench of a tick."""
        cycle = self._cycle
        late = cycle.parts.wrench.fill(tick, fusing=cycle.sight.fusing)
        self.record["sensor_late"] = Warn.SENSOR if late else 0
