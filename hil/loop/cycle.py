"""The controller: one pure step from received frames to frames to send.

No clock, no file, no random number, no log. All that changes a decision is in TickInput; that is why a log
replays to the bit.

``frames -> decode -> Measurement -> estimate -> State -> reference -> law -> Effort -> safety ->
Verdict -> Command -> encode -> frames``
"""

from __future__ import annotations

from math import nan

import numpy as np

from drivers.arrays import Array
from drivers.protocol import Frame, run_of
from drivers.sensors import Readings, SensorProtocol
from drivers.signals import LEGS, Command, DriveMode, DriveState, Measurement, no_measurement
from hil.estimation.pose import Estimator
from hil.loop.modes import CONTROLLED, Durations, Facts, drive_mode, next_mode, overdue
from hil.loop.motion import Motion
from hil.loop.parts import Parts
from hil.loop.reference import complete
from hil.loop.row import make_row
from hil.loop.steering import NO_SETPOINTS
from hil.robot.dynamics import Model
from hil.signals import (
    NO_WRENCH,
    Effort,
    Estimate,
    Fault,
    Mode,
    Operator,
    Reference,
    State,
    Stop,
    TickInput,
    TickOutput,
    Verdict,
    Warn,
)
from hil.trajectory import PoseSample, quintic_move

_ZERO6 = np.zeros(6)
_ZERO6.flags.writeable = False
_ZERO66 = np.zeros((6, 6))
_ZERO66.flags.writeable = False

_POWERED_STATES = (DriveState.READY, DriveState.RUN)
RESET_TICKS = 5
"""How often RESET is sent on the operator's command."""
_ALL_LEGS = (1 << LEGS) - 1
AGREED_m = 1e-4
"""A fused pose that fits all six lengths so well is one from which the legs alone can go on."""
ENDING = frozenset({Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes that end when the motion has ended and the legs are at rest."""
STEERED = frozenset({Mode.TRACKING, Mode.STOPPING})
"""Modes in which a live reference moves."""
REST_PATIENCE_S = 1.0
"""Legs that are not at rest so long after the motion has ended are a fault: they would never park."""
SETUPS = 3
"""How often a drive is sent its set-up: nothing acknowledges it."""
REST_m_s = 0.02
"""A motion has ended only when no measured leg is faster: brakes do not close on a moving platform."""


class Cycle:
    """Six encoders in, six forces out, once per tick.

    Mutable state, all of it: the last Measurement, what the sensors last said, the estimator's pose, the
    filter, mode and the tick of its entry, latched faults, the motion, the law's, the predictor's, the
    observer's and the safety's own state, and the forces that the bumpless entry and the exit fade, what
    limits last took from the effort, the external wrench's and the steering's own. `reset` restores the
    initial one.
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
        followers = (parts.predictor, parts.wrench.observer)
        self._followers = [each for each in followers if each is not None]
        """Who follows the forces that were sent."""
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        parts = self.parts
        self.measurement: Measurement = no_measurement()
        self.estimator.reset(parts.home_p, parts.home_R)
        self.located = False
        self.readings = Readings()
        self.fusing = False
        """Whether the filter has begun."""
        self.motion = Motion(self.period_s, parts.home_p, parts.home_R)
        self.mode = Mode.WAITING
        self.mode_tick = 0
        self.faults = Fault.NONE
        self.stop_requested = Stop.NONE
        self.reset_tick: int | None = None
        """When the operator last asked to clear the drives' faults."""
        self.set_up = [0] * LEGS
        """How often each drive has been sent watchdog and reaction."""
        self.holding = _ZERO6
        """(6,) N: what holds weight and external wrench where the brakes open, or the force as they close."""
        self.offset = _ZERO6
        """(6,) N: holding force less the law's own at the moment of entry; fades out."""
        self.entry_tick: int | None = None
        """When the entry offset began to fade; None while it is whole."""
        self.last_tau = _ZERO6
        self.shortfall = _ZERO6
        """(6,) N: what the drives were told less what had been asked for; limits make the difference."""
        parts.law.reset()
        parts.wrench.reset()
        if parts.predictor is not None:
            parts.predictor.reset()
        parts.safety.reset()
        if parts.steering is not None:
            parts.steering.reset()

    def begin(self, tick: int) -> tuple[Frame, ...]:
        """Return the frames that start a tick: all drives latch their encoders."""
        return self.parts.protocol.sync(tick)

    def step(self, inp: TickInput) -> TickOutput:
        """Return what to send and what to record for one tick."""
        parts = self.parts
        tick = inp.tick
        run = run_of(inp.frames)
        measurement = parts.protocol.decode_run(run, tick, self.measurement, inp.t_ns)
        if parts.sensors is not None:
            measurement = self._hear_sensors(parts.sensors, inp, measurement)
        self.measurement = measurement
        estimate = self._estimate(tick, inp.t_ns + inp.lateness_ns, measurement)
        estimate = parts.wrench.told(tick, estimate, measurement, fusing=self.fusing)
        state = estimate.state

        self._change_mode(inp, state)
        if parts.steering is not None:
            under_way = self.mode in STEERED and self.motion.trajectory is parts.trajectory
            along = tick - self.motion.tick if under_way else None
            parts.steering.step(inp.setpoints, along, tracking=self.mode is Mode.TRACKING)
        sample = self._sample(tick, state)
        t = self.motion.time(tick)
        reference = complete(parts.platform, sample, t if self.mode is Mode.TRACKING else nan)
        effort, own = self._effort(tick, *self._ahead(tick, state, reference))
        verdict = parts.safety.judge(inp, measurement, estimate, reference, effort, self.mode)
        if parts.wrench.late:
            verdict = verdict._replace(warnings=verdict.warnings | Warn.SENSOR)
        self._latch(inp, verdict)

        command = self._command(tick, verdict)
        limited = verdict.warnings and self.mode in CONTROLLED  # no limit acts without a warning
        self.shortfall = command.force - effort.tau if limited else _ZERO6
        for follower in self._followers:
            follower.sent(command.force)
        frames = parts.protocol.command(command, tick)
        if Operator.ESTOP in inp.operator:
            frames = parts.protocol.emergency_stop() + frames
        frames += self._setup(tick)
        setpoints = NO_SETPOINTS if parts.steering is None else parts.steering.counts
        row = make_row(
            inp, run, self.mode, self.faults, measurement, estimate, t, reference,
            own, command, verdict, setpoints, parts.wrench.said,
        )  # fmt: skip
        return TickOutput(frames, row)

    # -- estimate ------------------------------------------------------------------------------------

    def _hear_sensors(self, sensors: SensorProtocol, inp: TickInput, measurement: Measurement) -> Measurement:
        """Take in the sensors' samples; return the measurement with their refused frames counted."""
        self.readings = readings = sensors.decode(inp.frames, inp.tick, self.readings)
        if readings.wrench:
            R = self.parts.fusion.R if self.fusing and self.parts.fusion else self.estimator.R
            self.parts.wrench.hear(inp.tick, readings.wrench[-1].values, R)
        if readings.rejected:
            measurement = measurement._replace(rejected=measurement.rejected + readings.rejected)
        return measurement

    def _estimate(self, tick: int, latched_ns: int, measurement: Measurement) -> Estimate:
        """Pose from lengths; a leg without fresh data is carried on at its last rate.

        Until all legs have been heard and the first pose has been found from home, the pose is home's. After
        a RESET it is looked for from the last one that all six lengths agreed on.
        """
        q, dq, age = measurement.length, measurement.rate, measurement.age
        old = any(age.tolist())
        estimator = self.estimator
        if not self.located:
            self.located = not old and tick % self._setup_interval == 0 and estimator.acquire(q)
            if not self.located:
                return Estimate(
                    State(q, dq, estimator.p, estimator.R, _ZERO6, _ZERO66, 0, np.inf), np.inf, 0.0
                )
        fusion = self.parts.fusion
        if fusion is not None and self.fusing:
            last_wrench = self.parts.wrench.last
            found = fusion.estimate(tick, latched_ns, measurement, self.readings, self.last_tau, last_wrench)
            if found.fusion.used == _ALL_LEGS and found.state.residual < AGREED_m:
                estimator.p, estimator.R = found.state.p, found.state.R
            return found
        if old:
            q = q + dq * (age * self.period_s)
        p, R, twist, J, iterations, residual, condition, hop = estimator.update(q, dq)
        if fusion is not None:
            fusion.start(tick, latched_ns, p, R)
            self.fusing = True
        return Estimate(State(q, dq, p, R, twist, J, iterations, residual), condition, hop)

    def _free(self) -> bool:
        """Tell whether all brakes are open, on the drives' own word."""
        return all(s == DriveState.RUN for s in self.measurement.state.tolist())

    # -- modes ---------------------------------------------------------------------------------------

    def _change_mode(self, inp: TickInput, state: State) -> None:
        tick, operator = inp.tick, inp.operator
        if operator and Operator.RESET in operator and self.mode in {Mode.FAULT, Mode.WAITING}:
            self.reset_tick = tick
            self.set_up = [0] * LEGS
            self.faults = Fault.NONE
            self.stop_requested = Stop.NONE
            self.located = self.fusing = False
            self.parts.wrench.forget()
            self.parts.safety.reset()
        measurement, motion = self.measurement, self.motion
        elapsed = (tick - self.mode_tick) * self.period_s
        if overdue(self.mode, elapsed, self.durations):
            self.faults |= Fault.DRIVE
            self._enter(Mode.FAULT, tick, state)
            return
        if self.mode in ENDING and motion.overdue(tick, REST_PATIENCE_S):
            self.faults |= Fault.FOLLOWING
            self._enter(Mode.FAULT, tick, state)
            return
        facts = Facts(
            operator,
            measurement.state.tolist(),
            self.mode is Mode.WAITING and self._ready(),
            elapsed,
            motion.finished(tick) and max(abs(state.dq).tolist()) < REST_m_s,
            self.stop_requested is not Stop.NONE,
        )
        mode = next_mode(self.mode, facts, self.durations)
        if mode is not self.mode:
            self._enter(mode, tick, state)

    def _ready(self) -> bool:
        """Tell whether all six legs are heard, the pose is found and all six drives are set up."""
        return self.located and max(self.measurement.age.tolist()) <= 1 and min(self.set_up) >= SETUPS

    def _enter(self, mode: Mode, tick: int, state: State) -> None:
        parts = self.parts
        previous = self.mode
        match mode:
            case Mode.LOADING:
                self.holding = self.statics.inverse_dynamics(state.p, state.R, _ZERO6, _ZERO6, state.wrench)
                self.motion.rest(state.p, state.R, tick)
            case Mode.RELEASING:
                self.motion.rest(state.p, state.R, tick)
                parts.law.reset()
                self.entry_tick = None
                at_rest = complete(parts.platform, self.motion.sample(tick))
                unloaded = state._replace(wrench=NO_WRENCH)  # as `_ahead` tells the law at entry
                self.offset = self.holding - parts.law.effort(unloaded, at_rest, _ZERO6).tau
                parts.law.reset()  # it begins with this very tick, and the offset fits
            case Mode.APPROACH:
                if parts.steering is not None:
                    parts.steering.restart()
                here, start = self.motion.sample(tick), parts.trajectory.sample(0.0)
                duration = self._approach_s(here, start)
                move = quintic_move(here.p, here.R, start.p, start.R, duration)
                self.motion.start(move, tick, then=parts.trajectory)
                self.entry_tick = tick
            case Mode.TRACKING:
                if previous is Mode.LOADING:
                    parts.law.reset()
                    self.offset = _ZERO6
                    if parts.steering is not None:
                        parts.steering.restart()
                    self.entry_tick = tick
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

    def _ahead(self, tick: int, state: State, reference: Reference) -> tuple[State, Reference]:
        """Return what the law is told: state and reference of now, or of when its force will act.

        Safety judges the present ones. The external wrench comes in as the entry offset goes out: each alone
        makes up for what the law's own model does not hold.
        """
        predictor = self.parts.predictor
        if predictor is not None:
            state = predictor.ahead(tick, state, free=self._free())
        if state.wrench is not NO_WRENCH:
            state = state._replace(wrench=state.wrench * (1.0 - self._entry_share(tick)))
        if predictor is not None and self.mode in CONTROLLED:
            sample, t = self.motion.ahead(tick, predictor.horizon_s)
            if t is None:
                t = self.motion.time(tick) + predictor.horizon_s if self.mode is Mode.TRACKING else nan
            reference = complete(self.parts.platform, sample, t)
        return state, reference

    def _effort(self, tick: int, state: State, reference: Reference) -> tuple[Effort, Array]:
        """Return the effort with the entry and exit ramps, and the law's own tau (6,) N."""
        elapsed = (tick - self.mode_tick) * self.period_s
        if self.mode in CONTROLLED:
            own = self.parts.law.effort(state, reference, self.shortfall).tau
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
        if verdict.stop is not Stop.NONE and self.stop_requested is Stop.NONE:
            self.stop_requested = verdict.stop

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


def smoothstep(x: float) -> float:
    """Return 10 x^3 - 15 x^4 + 6 x^5 of x clamped to 0 .. 1; both ends are at rest."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))
