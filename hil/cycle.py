"""The controller: one pure step from received frames to frames to send.

Rule of the room: no clock, no file, no random number, no log. All that changes a decision is in
TickInput; that is why a log replays to the bit.

``frames -> decode -> Measurement -> estimate -> State -> reference -> law -> Effort -> safety ->
Verdict -> Command -> encode -> frames``
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.protocol import DriveProtocol, Frame, Received
from drivers.signals import LEGS, Command, DriveMode, DriveState, Measurement, Reaction, no_measurement
from hil.config import EngageSettings, LegSpin
from hil.control.law import Law
from hil.dynamics import Model
from hil.estimate import Estimator
from hil.geometry import Platform
from hil.modes import CONTROLLED, Durations, Facts, drive_mode, next_mode, overdue
from hil.motion import Motion
from hil.reference import complete
from hil.safety import Safety
from hil.signals import (
    ROW,
    ROW_FLOATS,
    ROW_INTEGERS,
    Array,
    Effort,
    Estimate,
    Fault,
    Mode,
    Operator,
    Reference,
    State,
    TickInput,
    TickOutput,
    Verdict,
)
from hil.trajectory import PoseSample, Trajectory, quintic_move

_ZERO6 = np.zeros(6)
_ZERO6.flags.writeable = False
_ZERO66 = np.zeros((6, 6))
_ZERO66.flags.writeable = False

_POWERED_STATES = (DriveState.READY, DriveState.RUN)
RESET_TICKS = 5
"""How often RESET is sent on the operator's command."""
ENDING = frozenset({Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes that end when the motion has ended and the legs are at rest."""
REST_PATIENCE_S = 1.0
"""Legs that are not at rest so long after the motion has ended are a fault: they would never park."""
SETUPS = 3
"""How often a drive is sent its set-up: nothing acknowledges it."""
REST_m_s = 0.02
"""A motion has ended only when no measured leg is faster: brakes do not close on a moving platform."""


@dataclass(frozen=True)
class Parts:
    """What a cycle is made of."""

    platform: Platform
    leg_spin: LegSpin
    protocol: DriveProtocol
    law: Law
    trajectory: Trajectory
    safety: Safety
    engage: EngageSettings
    home_p: Array
    home_R: Array
    rate_Hz: float
    watchdog_s: float
    reaction: Reaction


class Cycle:
    """Six encoders in, six forces out, once per tick.

    Mutable state, all of it: the last Measurement, the estimator's pose, mode and the tick of its entry,
    latched faults, the motion, the law's and the safety's own state, and the forces that the bumpless
    entry and the exit fade. `reset` restores the initial one.
    """

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.period_s = 1.0 / parts.rate_Hz
        self.estimator = Estimator(parts.platform, parts.home_p, parts.home_R)
        self.statics = Model(parts.platform, leg_spin=parts.leg_spin)
        engage = parts.engage
        self.durations = Durations(
            load=engage.force_ramp_s,
            release=engage.brake_release_s,
        )
        self._setup_interval = max(LEGS, round(0.02 * parts.rate_Hz))
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        parts = self.parts
        self.measurement: Measurement = no_measurement()
        self.estimator.reset(parts.home_p, parts.home_R)
        self.located = False
        self.motion = Motion(self.period_s, parts.home_p, parts.home_R)
        self.mode = Mode.WAITING
        self.mode_tick = 0
        self.faults = Fault.NONE
        self.stop_requested = False
        self.reset_tick: int | None = None
        """When the operator last asked to clear the drives' faults."""
        self.set_up = [0] * LEGS
        """How often each drive has been sent watchdog and reaction."""
        self.holding = _ZERO6
        """(6,) N: static force at the pose where the brakes open, or the force at which they close."""
        self.offset = _ZERO6
        """(6,) N: holding force less the law's own at the moment of entry; fades out."""
        self.entry_tick: int | None = None
        """When the entry offset began to fade; None while it is whole."""
        self.last_tau = _ZERO6
        parts.law.reset()
        parts.safety.reset()

    def begin(self, tick: int) -> tuple[Frame, ...]:
        """Return the frames that start a tick: all drives latch their encoders."""
        return self.parts.protocol.sync(tick)

    def step(self, inp: TickInput) -> TickOutput:
        """Return what to send and what to record for one tick."""
        parts = self.parts
        tick = inp.tick
        measurement = parts.protocol.decode(inp.frames, tick, self.measurement, inp.t_ns)
        self.measurement = measurement
        estimate = self._estimate(tick, measurement)
        state = estimate.state

        self._change_mode(inp, state)
        sample = self._sample(tick, state)
        reference = complete(parts.platform, sample)
        effort, own = self._effort(tick, state, reference)
        verdict = parts.safety.judge(inp, measurement, estimate, reference, effort, self.mode)
        self._latch(inp, verdict)

        command = self._command(tick, verdict)
        frames = parts.protocol.command(command, tick)
        if Operator.ESTOP in inp.operator:
            frames = parts.protocol.emergency_stop() + frames
        frames += self._setup(tick)
        return TickOutput(frames, self._row(inp, estimate, sample, reference, own, command, verdict))

    # -- estimate ------------------------------------------------------------------------------------

    def _estimate(self, tick: int, measurement: Measurement) -> Estimate:
        """Pose from lengths; a leg without fresh data is carried on at its last rate.

        Until all legs have been heard and the first pose has been found from home, the pose is home's.
        """
        q, dq, age = measurement.length, measurement.rate, measurement.age
        ages = age.tolist()
        estimator = self.estimator
        if not self.located:
            self.located = not any(ages) and tick % self._setup_interval == 0 and estimator.acquire(q)
            if not self.located:
                return Estimate(
                    State(q, dq, estimator.p, estimator.R, _ZERO6, _ZERO66, 0, np.inf), np.inf, 0.0
                )
        if any(ages):
            q = q + dq * (age * self.period_s)
        found = estimator.update(q, dq)
        state = State(q, dq, found.p, found.R, found.twist, found.J, found.iterations, found.residual)
        return Estimate(state, found.condition, found.hop)

    # -- modes ---------------------------------------------------------------------------------------

    def _change_mode(self, inp: TickInput, state: State) -> None:
        measurement, tick = self.measurement, inp.tick
        if Operator.RESET in inp.operator and self.mode in {Mode.FAULT, Mode.WAITING}:
            self.reset_tick = tick
            self.set_up = [0] * LEGS
            self.faults = Fault.NONE
            self.stop_requested = False
            self.located = False
            self.parts.safety.reset()
        elapsed = (tick - self.mode_tick) * self.period_s
        if overdue(self.mode, elapsed, self.durations):
            self.faults |= Fault.DRIVE
            self._enter(Mode.FAULT, tick, state)
            return
        if self.mode in ENDING and self.motion.overdue(tick, REST_PATIENCE_S):
            self.faults |= Fault.FOLLOWING
            self._enter(Mode.FAULT, tick, state)
            return
        facts = Facts(
            operator=inp.operator,
            drive_state=measurement.state.tolist(),
            ready=self.located and max(measurement.age.tolist()) <= 1 and min(self.set_up) >= SETUPS,
            elapsed=elapsed,
            finished=self.motion.finished(tick) and max(abs(state.dq).tolist()) < REST_m_s,
            stop=self.stop_requested,
        )
        mode = next_mode(self.mode, facts, self.durations)
        if mode is not self.mode:
            self._enter(mode, tick, state)

    def _enter(self, mode: Mode, tick: int, state: State) -> None:
        parts = self.parts
        previous = self.mode
        match mode:
            case Mode.LOADING:
                self.holding = self.statics.inverse_dynamics(state.p, state.R, _ZERO6, _ZERO6)
                self.motion.rest(state.p, state.R, tick)
            case Mode.RELEASING:
                self.motion.rest(state.p, state.R, tick)
                parts.law.reset()
                self.entry_tick = None
                at_rest = complete(parts.platform, self.motion.sample(tick))
                self.offset = self.holding - parts.law.effort(state, at_rest).tau
            case Mode.APPROACH:
                here, start = self.motion.sample(tick), parts.trajectory.sample(0.0)
                duration = self._approach_s(here, start)
                self.motion.start(quintic_move(here.p, here.R, start.p, start.R, duration), tick)
                self.entry_tick = tick
            case Mode.TRACKING:
                if previous is Mode.LOADING:
                    parts.law.reset()
                    self.offset = _ZERO6
                self.motion.start(parts.trajectory, tick)
            case Mode.STOPPING:
                self.motion.stop(tick, parts.engage.stop_s)
            case Mode.PARKING:
                rest = self.motion.sample(tick)
                self.motion.rest(rest.p, rest.R, tick)
            case Mode.UNLOADING:
                self.holding = self.last_tau
            case _:
                pass
        self.mode, self.mode_tick = mode, tick

    def _approach_s(self, here: PoseSample, start: PoseSample) -> float:
        platform, engage = self.parts.platform, self.parts.engage
        distance = np.abs(complete(platform, start).q - complete(platform, here).q).max()
        return max(float(distance) / engage.approach_speed_m_s, engage.blend_s, self.period_s)

    # -- reference, law ------------------------------------------------------------------------------

    def _sample(self, tick: int, state: State) -> PoseSample:
        if self.mode in CONTROLLED or self.mode is Mode.UNLOADING:
            return self.motion.sample(tick)
        return PoseSample(state.p, state.R, _ZERO6, _ZERO6)

    def _effort(self, tick: int, state: State, reference: Reference) -> tuple[Effort, Array]:
        """Return the effort with the entry and exit ramps, and the law's own tau (6,) N."""
        elapsed = (tick - self.mode_tick) * self.period_s
        if self.mode in CONTROLLED:
            own = self.parts.law.effort(state, reference).tau
            left = self._entry_share(tick)
            return Effort(own + self.offset * left if left > 0.0 else own), own
        load = self.durations.load
        if self.mode is Mode.LOADING and load > 0:
            return Effort(self.holding * smoothstep(elapsed / load)), _ZERO6
        if self.mode is Mode.UNLOADING and load > 0:
            return Effort(self.holding * (1.0 - smoothstep(elapsed / load))), _ZERO6
        return Effort(_ZERO6), _ZERO6

    def _entry_share(self, tick: int) -> float:
        """Return how much of the entry offset is left, 1 .. 0."""
        if self.entry_tick is None:
            return 1.0
        blend = self.parts.engage.blend_s
        if blend == 0.0:
            return 0.0
        return 1.0 - smoothstep((tick - self.entry_tick) * self.period_s / blend)

    # -- safety, command -----------------------------------------------------------------------------

    def _latch(self, inp: TickInput, verdict: Verdict) -> None:
        faults = verdict.faults
        if Operator.ESTOP in inp.operator:
            faults |= Fault.ESTOP
        if faults:
            self.faults |= faults
            if self.mode is not Mode.FAULT:
                self.mode, self.mode_tick = Mode.FAULT, inp.tick
        self.stop_requested = self.stop_requested or verdict.stop

    def _command(self, tick: int, verdict: Verdict) -> Command:
        if self.mode is Mode.WAITING and self._clears_drives(tick):
            return Command(DriveMode.RESET, _ZERO6)
        mode = drive_mode(self.mode)
        tau = _ZERO6 if mode is DriveMode.OFF else verdict.tau
        self.last_tau = tau
        return Command(mode, tau)

    def _clears_drives(self, tick: int) -> bool:
        """Say whether RESET is sent: a few times only, so that a fault that comes back stays."""
        return self.reset_tick is not None and tick - self.reset_tick < RESET_TICKS

    def _setup(self, tick: int) -> tuple[Frame, ...]:
        """Return the set-up of a drive that has none from us: one frame a tick, to keep the bus budget."""
        leg = tick % self._setup_interval
        if leg >= LEGS or self.mode not in {Mode.WAITING, Mode.FAULT} or self.measurement.age[leg] > 1:
            return ()
        state = self.measurement.state[leg]
        if state != DriveState.BOOT and (self.set_up[leg] >= SETUPS or state in _POWERED_STATES):
            return ()
        self.set_up[leg] += 1
        parts = self.parts
        return (parts.protocol.configure(parts.watchdog_s, parts.reaction)[leg],)

    # -- record --------------------------------------------------------------------------------------

    def _row(
        self,
        inp: TickInput,
        estimate: Estimate,
        sample: PoseSample,
        reference: Reference,
        own: Array,
        command: Command,
        verdict: Verdict,
    ) -> NDArray[np.void]:
        measurement, state = self.measurement, estimate.state
        cells = np.empty(ROW_INTEGERS + ROW_FLOATS)
        _INTEGERS.pack_into(
            cells.data,
            0,
            inp.tick,
            inp.t_ns,
            inp.lateness_ns,
            inp.skipped,
            inp.sends_failed,
            inp.bus_errors,
            inp.bus_off,
            inp.bus_overflow,
            inp.recorder_alive,
            inp.recorder_dropped,
            inp.compute_ns,
            len(inp.frames),
            frames_crc32(inp.frames),
            self.mode,
            self.faults,
            verdict.warnings,
            measurement.rejected,
            command.mode,
            state.iterations,
            *measurement.state.tolist(),
            *measurement.fault.tolist(),
            *measurement.age.tolist(),
        )
        np.concatenate(
            (
                state.q,
                state.dq,
                measurement.force,
                state.p,
                state.R.reshape(9),
                state.twist,
                sample.p,
                sample.R.reshape(9),
                sample.twist,
                sample.dtwist,
                reference.q,
                reference.dq,
                reference.ddq,
                own,
                command.force,
                (state.residual, estimate.condition, self.motion.time(inp.tick)),
            ),
            out=cells[ROW_INTEGERS:],
        )
        return np.ndarray((), ROW, cells)


def smoothstep(x: float) -> float:
    """Return 10 x^3 - 15 x^4 + 6 x^5 of x clamped to 0 .. 1; both ends are at rest."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def frames_crc32(frames: Sequence[Received]) -> int:
    """Return the CRC-32 of the received frames in order, their times, identifiers, flags and data."""
    crc = 0
    for t_ns, (identifier, data, flags) in frames:
        crc = zlib.crc32(data, zlib.crc32(_HEAD.pack(t_ns, identifier, flags), crc))
    return crc


_HEAD = struct.Struct("<qII")
_INTEGERS = struct.Struct(f"<{ROW_INTEGERS}q")
