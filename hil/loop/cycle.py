"""The controller: one pure step from received frames to frames to send.

No clock, no file, no random number, no log. All that changes a decision is in TickInput; that is why a log
replays to the bit.

``frames -> decode -> estimate -> reference -> law -> safety -> encode -> frames``, each stage filling its
columns of the tick's record (`drivers.tick_columns`).
"""

from __future__ import annotations

import struct
import zlib
from math import inf
from typing import Any

from drivers.arrays import ZERO6
from drivers.protocol import Dialogue, Frame, run_of
from drivers.sensors import Readings, SensorProtocol
from drivers.signals import LEGS, Command, DriveMode, Fault, Mode, Stop, Warn
from drivers.tick_columns import INPUT_COLUMNS, TICK, Record, new_record, row_of
from hil.estimation.pose import Estimator
from hil.loop import modes
from hil.loop.drives_say import all_free, any_powered, confirmed
from hil.loop.effort import Effort
from hil.loop.modes import CONTROLLED, ENDING, STEERED, Durations, Facts, drive_mode, next_mode, overdue
from hil.loop.motion import Motion
from hil.loop.obedience import Obedience
from hil.loop.parts import Parts
from hil.loop.reference import farthest_leg_m, fill_reference
from hil.loop.steering import NO_SETPOINTS
from hil.safety.guard import Verdict
from hil.safety.standstill import REST_m_s
from hil.signals import Operator, TickInput, TickOutput
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import PoseSample

_put_input = struct.Struct(f"<{len(INPUT_COLUMNS) + 2}q").pack_into
_put_three = struct.Struct("<3q").pack_into
_fields: Any = TICK.fields
_MODE_AT, _SETPOINTS_AT = _fields["mode"][1], _fields["setpoints_taken"][1]
"""Where three columns begin that are put at once."""
_POWERED_MODES = (DriveMode.READY, DriveMode.RUN)
_ALL_LEGS = (1 << LEGS) - 1
AGREED_m = 1e-4
"""A fused pose that fits all six lengths so well is one from which the legs alone can go on."""
REST_PATIENCE_S = 1.0
"""Legs that are not at rest so long after the motion has ended are a fault: they would never park."""
SEARCH_S = 0.02
"""From one look for the first pose to the next."""


class Cycle:
    """Six encoders in, six forces out, once per tick.

    Mutable state, all of it: the drive protocol's dialogue, the last tick's record, the sensors' last
    readings, the estimator's pose, the filter, mode and the tick of its entry, latched faults, E-stop,
    whether the brakes are proven shut, the motion, the effort's ramps, and what law, predictor, observer,
    external wrench, steering and safety keep. `reset` restores the initial one.
    """

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.period_s = 1.0 / parts.rate_Hz
        self.estimator = Estimator(parts.platform, parts.home_p, parts.home_R)
        engage = parts.engage
        self.durations = Durations(engage.force_ramp_s, engage.brake_release_s, engage.closing_s)
        self.effort = Effort(parts, self.durations)
        self.obedience = Obedience(self.effort.model, parts.rate_Hz)
        self._under_control = parts.reactions.led_to("ss1")
        self._torque_off = parts.reactions.led_to("sto")
        self._search_interval = max(LEGS, round(SEARCH_S * parts.rate_Hz))
        followers = (parts.predictor, parts.wrench.observer)
        self._followers = [each for each in followers if each is not None]
        """Who follows the forces that were sent."""
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        parts = self.parts
        self.dialogue: Dialogue = parts.protocol.start(parts.setup)
        self.tick = new_record()
        """The last tick's record."""
        self._last_wrench = ZERO6
        self.estimator.reset(parts.home_p, parts.home_R)
        self.located = False
        self.readings = Readings()
        self.fusing = False
        """Whether the filter has begun."""
        self.motion = Motion(self.period_s, parts.home_p, parts.home_R)
        self.mode = Mode.WAITING
        self.mode_tick = 0
        self._yields = False
        """PARKING after a fault: the reference stays with the platform, and what holds it is all the force. A
        law that was not followed could work against the brakes."""
        self.proven = True
        """A brake test has passed since the brakes were last open, or they have not been open."""
        self.faults, self.estop = Fault.NONE, False
        """An emergency stop is repeated until all drives confirm it."""
        self.stop_requested = Stop.NONE
        self.reset_tick: int | None = None
        """When the operator last asked to clear the drives' faults."""
        self.effort.reset()
        self.obedience.reset()
        for part in (parts.law, parts.wrench, parts.predictor, parts.safety, parts.steering):
            if part is not None:
                part.reset()

    def begin(self, tick: int) -> tuple[Frame, ...]:
        """Return the frames that start a tick: the drives answer with their encoders."""
        return self.parts.protocol.begin(self.dialogue, tick)

    def step(self, inp: TickInput) -> TickOutput:
        """Return what to send and what to record for one tick."""
        parts, number = self.parts, inp.tick
        run = run_of(inp.frames)
        last, tick = self.tick, new_record()
        self._last_wrench = last["wrench"]
        buffer: Any = tick.base
        _put_input(
            buffer.data, 0,
            number, inp.t_ns, inp.lateness_ns, inp.skipped, inp.stretched_ns, inp.sends_failed,
            inp.bus_errors, inp.bus_off, inp.bus_overflow, inp.recorder_alive, inp.recorder_dropped,
            inp.compute_ns, len(inp.frames), zlib.crc32(run),
        )  # fmt: skip
        began_ns = inp.t_ns + inp.lateness_ns
        self.dialogue = parts.protocol.decode(self.dialogue, run, last, tick, began_ns)
        self.tick = tick
        if parts.sensors is not None:
            self._hear_sensors(parts.sensors, inp, tick)
        self._estimate(tick, last, inp.t_ns + inp.lateness_ns)
        parts.wrench.fill(tick, fusing=self.fusing)

        self._change_mode(inp, tick)
        steering = parts.steering
        if steering is not None:
            under_way = self.mode in STEERED and self.motion.trajectory is parts.trajectory
            along = number - self.motion.tick if under_way else None
            steering.step(inp.setpoints, along, tracking=self.mode is Mode.TRACKING)
        t = self.motion.time(number)
        fill_reference(parts.platform, self._sample(tick), tick)
        tick["reference_time_s"] = t
        if self.mode is Mode.TRACKING:
            tick["t_d"] = t
        self._effort(tick)
        tick["mode"] = self.mode
        verdict = parts.safety.judge(tick)
        warnings = verdict.warnings | Warn.SENSOR if parts.wrench.late else verdict.warnings
        self._latch(inp, verdict)

        command = self._command(tick)
        limited = warnings and self.mode in CONTROLLED  # no limit acts without a warning
        self.effort.shortfall = tick["tau"] - tick["tau_asked"] if limited else ZERO6
        for follower in self._followers:
            follower.sent(command.force)
        self.dialogue, frames = parts.protocol.command(self.dialogue, command, number)
        if Operator.ESTOP in inp.operator or (self.estop and not confirmed(tick)):
            frames = parts.protocol.emergency_stop() + frames
        frames += self._set_up(tick)
        setpoints = NO_SETPOINTS if steering is None else steering.counts
        if setpoints.refusal:
            warnings |= Warn.SETPOINT
        _put_three(buffer.data, _MODE_AT, self.mode, self.faults, warnings)
        _put_three(buffer.data, _SETPOINTS_AT, *setpoints)
        return TickOutput(frames, row_of(tick))

    # -- estimate ------------------------------------------------------------------------------------

    def _hear_sensors(self, sensors: SensorProtocol, inp: TickInput, tick: Record) -> None:
        """Take in the sensors' samples, and count their refused frames."""
        self.readings = readings = sensors.decode(inp.frames, inp.tick, self.readings)
        if readings.wrench:
            R = self.parts.fusion.R if self.fusing and self.parts.fusion else self.estimator.R
            self.parts.wrench.hear(inp.tick, readings.wrench[-1].values, R)
        tick["sensors_rejected"] = readings.rejected
        tick["rejected"] += readings.rejected

    def _estimate(self, tick: Record, last: Record, latched_ns: int) -> None:
        """Fill the estimate: pose from lengths; a leg without fresh data is carried on at its last rate.

        Until all legs have been heard and the first pose has been found from home, the pose is home's. After
        a RESET it is looked for from the last one that all six lengths agreed on.
        """
        number, age = int(tick["tick"]), tick["age"]
        old = any(age.tolist())
        estimator = self.estimator
        tick["q"], tick["dq"] = tick["length"], tick["rate"]
        if not self.located:
            q = tick["q"]
            self.located = not old and number % self._search_interval == 0 and estimator.acquire(q)
            if not self.located:
                tick["p"], tick["R"] = estimator.p, estimator.R
                tick["fk_residual"] = tick["condition"] = inf
                return
        fusion = self.parts.fusion
        if fusion is not None and self.fusing:
            fusion.estimate(tick, latched_ns, self.readings, last["tau"], self.parts.wrench.last)
            if tick["legs_used"] == _ALL_LEGS and tick["fk_residual"] < AGREED_m:
                estimator.p, estimator.R = tick["p"], tick["R"]
            return
        if old:
            tick["q"] += tick["dq"] * (age * self.period_s)
        estimator.update(tick)
        if fusion is not None:
            fusion.start(number, latched_ns, tick["p"], tick["R"])
            self.fusing = True

    # -- modes ---------------------------------------------------------------------------------------

    def _change_mode(self, inp: TickInput, tick: Record) -> None:
        number, operator = inp.tick, inp.operator
        if operator and Operator.RESET in operator and self.mode in {Mode.FAULT, Mode.WAITING}:
            self.reset_tick = number
            self.dialogue = self.parts.protocol.start(self.parts.setup)
            self.faults, self.estop = Fault.NONE, False
            self.stop_requested = Stop.NONE
            self.located = self.fusing = False
            self.obedience.reset()
            self.parts.wrench.forget()
            self.parts.safety.reset()
        motion = self.motion
        elapsed = (number - self.mode_tick) * self.period_s
        if overdue(self.mode, elapsed, self.durations):
            self.faults |= Fault.DRIVE
            waits = self.mode is Mode.PARKING  # for brakes that may not have shut
            self._enter(Mode.HELD if waits else self._after(Fault.DRIVE, tick), tick)
            return
        if self.mode in ENDING and motion.overdue(number, REST_PATIENCE_S):
            self.faults |= Fault.FOLLOWING
            mode = self._after(Fault.FOLLOWING, tick)
            self._enter(Mode.PARKING if mode is Mode.STOPPING else mode, tick)  # a stop did not help
            return
        facts = Facts(
            operator,
            tick["drive_state"].tolist(),
            self.mode is Mode.WAITING and self._ready(),
            elapsed,
            motion.finished(number) and max(abs(tick["dq"]).tolist()) < REST_m_s,
            self.stop_requested is not Stop.NONE,
            self.mode is Mode.HELD and self._provable(tick),
        )
        mode = next_mode(self.mode, facts, self.durations)
        if mode is not self.mode:
            self._enter(mode, tick)
        if self._yields and self.mode is Mode.PARKING:
            self.motion.rest(tick["p"], tick["R"], number)

    def _ready(self) -> bool:
        """Tell whether all six legs are heard, the pose is found and all six drives are set up."""
        heard = self.located and max(self.tick["age"].tolist()) <= 1
        return heard and all(self.parts.protocol.legs_set_up(self.dialogue))

    def _provable(self, tick: Record) -> bool:
        """Tell whether a test could prove the brakes: all legs are heard, believed and at rest."""
        measured = max(tick["age"].tolist()) == 0 and not tick["legs_slipped"]
        still = measured and max(abs(tick["rate"]).tolist()) < REST_m_s
        return bool(still) and self.durations.load > 0.0 and not self.faults & modes.NO_PROOF

    def _enter(self, mode: Mode, tick: Record) -> None:
        parts, effort, number = self.parts, self.effort, int(tick["tick"])
        previous = self.mode
        match mode:
            case Mode.LOADING:
                effort.holding = effort.statics(tick["p"], tick["R"], tick["wrench"])
                self.motion.rest(tick["p"], tick["R"], number)
            case Mode.RELEASING:
                self.motion.rest(tick["p"], tick["R"], number)
                self.proven = False
                effort.hold(tick, effort.holding, self.motion.sample(number))
            case Mode.APPROACH:
                if parts.steering is not None:
                    parts.steering.trajectory.reset()
                here, start = self.motion.sample(number), parts.trajectory.sample(0.0)
                engage, farthest = parts.engage, farthest_leg_m(parts.platform, here, start)
                duration = max(farthest / engage.approach_speed_m_s, engage.blend_s, self.period_s)
                move = GeodesicMove(here.p, here.R, start.p, start.R, duration)
                self.motion.start(move, number, then=parts.trajectory)
                effort.entry_tick = number
            case Mode.TRACKING:
                if previous is Mode.LOADING:
                    self.proven = False
                    parts.law.reset()
                    effort.offset = ZERO6
                    if parts.steering is not None:
                        parts.steering.trajectory.reset()
                    effort.entry_tick = number
                self.motion.start(parts.trajectory, number)
            case Mode.STOPPING:
                self.motion.stop(number, parts.engage.stop_s)
            case Mode.PARKING:
                rest = self.motion.sample(number)
                self.motion.rest(rest.p, rest.R, number)
                self._yields = False
                if self.faults & ~self._under_control:
                    self._yield(tick)
            case Mode.UNLOADING:
                effort.holding = effort.last_tau
            case Mode.PARKED if previous is Mode.UNLOADING:
                self.proven = self.proven or self.durations.load > 0.0
            case Mode.HELD:
                self._hold(previous, tick)
        self.mode, self.mode_tick = mode, number

    def _yield(self, tick: Record) -> None:
        """Let what holds the platform where it is be all the force, until the brakes are shut."""
        self._yields = True
        self.motion.rest(tick["p"], tick["R"], int(tick["tick"]))
        self.effort.holding = self.effort.statics(tick["p"], tick["R"], tick["wrench"])
        self.obedience.forget()

    def _hold(self, previous: Mode, tick: Record) -> None:
        """Begin to hold the platform: by the last force that did, or by what does so where it is.

        In motion that is where it should be if the measurement is no longer believed.
        """
        effort, number = self.effort, int(tick["tick"])
        blind = bool(self.faults & modes.NOT_MEASURED)
        if previous is Mode.PARKING:
            effort.holding = effort.last_tau
        elif previous not in {Mode.LOADING, Mode.UNLOADING}:
            p, R = self.motion.sample(number)[:2] if blind else (tick["p"], tick["R"])
            effort.holding = effort.statics(p, R, self._last_wrench if blind else tick["wrench"])
            self.motion.rest(p, R, number)
        effort.hold(tick, effort.holding, self.motion.sample(number), on_it=True)
        self.parts.safety.resume(effort.holding)
        self.obedience.forget()

    # -- reference, effort ---------------------------------------------------------------------------

    def _sample(self, tick: Record) -> PoseSample:
        if self.mode in CONTROLLED or self.mode is Mode.UNLOADING:
            return self.motion.sample(int(tick["tick"]))
        return PoseSample(tick["p"], tick["R"], ZERO6, ZERO6)

    def _effort(self, tick: Record) -> None:
        blind = self.mode is Mode.HELD and bool(self.faults & modes.NOT_MEASURED)
        yields = self.mode is Mode.PARKING and self._yields
        effort, watch = self.effort, self.obedience
        effort.fill(tick, self.mode, self.mode_tick, self.motion, free=all_free(tick), fixed=blind or yields)
        shuts = self.mode is Mode.HELD and not self.faults & modes.NO_PROOF  # no brake is known to be open
        if (yields or shuts) and watch.watch(tick, effort.last_tau):
            self.faults |= Fault.DRIVE
            held = effort.last_tau.copy()
            held[watch.refused] = 0.0
            self.parts.safety.resume(held)
        if watch.refused is not None:
            tick["tau_asked"][watch.refused] = 0.0
            tick["legs_refused"] = 1 << watch.refused

    # -- safety, command -----------------------------------------------------------------------------

    def _latch(self, inp: TickInput, verdict: Verdict) -> None:
        faults = verdict.faults
        if self.mode is Mode.HELD and self.faults & modes.NOT_MEASURED:
            faults &= ~modes.OF_THE_POSE  # no news, and no cause
        if Operator.ESTOP in inp.operator:
            faults |= Fault.ESTOP
        rivals = (faults | self.faults) & Fault.SECOND_CONTROLLER
        if faults & Fault.ESTOP or (rivals and (drive_mode(self.mode) or any_powered(self.tick))):
            self.estop = True  # OFF could lose against the commands of another controller
        if self.mode is Mode.HELD and faults & ~self.faults & modes.NOT_MEASURED:
            self.effort.holding = self.effort.last_tau
        if faults:
            self.faults |= faults
            mode = self._after(faults, self.tick)
            if mode is not self.mode:
                self._enter(mode, self.tick)
            elif mode is Mode.PARKING and not self._yields and faults & ~self._under_control:
                self._yield(self.tick)
        if verdict.stop is not Stop.NONE and self.stop_requested is Stop.NONE:
            self.stop_requested = verdict.stop

    def _after(self, faults: Fault, tick: Record) -> Mode:
        """Return where faults lead that strike now."""
        patience = modes.DRIVE_PATIENCE_S / self.period_s
        heard = bool(((tick["age"] < patience) | (tick["blind"] != 0)).any())
        return modes.after_fault(
            self.mode, faults, self._under_control, self._torque_off, located=self.located, heard=heard
        )

    def _command(self, tick: Record) -> Command:
        mode = drive_mode(self.mode)
        if self.mode is Mode.WAITING and self.reset_tick is not None:
            since = int(tick["tick"]) - self.reset_tick
            if since < self.parts.protocol.reset_ticks:  # not for ever: a fault that comes back stays
                mode = DriveMode.RESET
        if mode not in _POWERED_MODES:
            tick["tau"] = 0.0
        tick["command_mode"] = mode
        self.effort.last_tau = tick["tau"]
        return Command(mode, tick["tau"])

    def _set_up(self, tick: Record) -> tuple[Frame, ...]:
        """Return the start-up dialogue's frames of this tick."""
        if self.mode not in {Mode.WAITING, Mode.FAULT}:
            return ()
        self.dialogue, frames = self.parts.protocol.set_up(self.dialogue, tick)
        return frames
