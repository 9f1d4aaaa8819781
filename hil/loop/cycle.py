"""The controller: one pure step from received frames to frames to send.

No clock, no file, no random number, no log. All that changes a decision is in TickInput; that is why a log
replays to the bit.

``frames -> decode -> estimate -> reference -> law -> safety -> encode -> frames``, each stage filling its
columns of the tick's record (`drivers.tick_columns`).
"""

from __future__ import annotations

import struct
import zlib
from functools import partial
from typing import Any

from drivers.arrays import ZERO6, Array
from drivers.protocol import Dialogue, Frame, run_of
from drivers.signals import Command, DriveMode, Fault, Mode, Stop, Warn
from drivers.tick_columns import INPUT_ELEMENTS, TICK, Record, new_record, row_of
from hil.loop import modes
from hil.loop.drives_say import all_free, any_powered, confirmed, measured_at_rest, ready
from hil.loop.effort import Effort
from hil.loop.homing import Homing, Stroke
from hil.loop.jogging import Jogging
from hil.loop.modes import CONTROLLED, ENDING, STEERED, Durations, Facts, drive_mode, next_mode, overdue
from hil.loop.motion import Motion
from hil.loop.obedience import Obedience
from hil.loop.operating import Operating
from hil.loop.parts import Parts
from hil.loop.reference import fill_reference
from hil.loop.setup_moves import approach
from hil.loop.sight import Sight
from hil.loop.steering import NO_SETPOINTS
from hil.loop.way_back import Inspection
from hil.safety.guard import Verdict
from hil.safety.standstill import REST_m_s
from hil.signals import Operator, TickInput, TickOutput
from hil.trajectory.path import PoseSample

_put_input = struct.Struct(f"<{INPUT_ELEMENTS + 2}q").pack_into
_put_three = struct.Struct("<3q").pack_into
_fields: Any = TICK.fields
_MODE_AT, _SETPOINTS_AT = _fields["mode"][1], _fields["setpoints_taken"][1]
"""Where three columns begin that are put at once."""
_POWERED_MODES = (DriveMode.READY, DriveMode.RUN)
REST_PATIENCE_S = 1.0
"""Legs that are not at rest so long after the motion has ended are a fault: they would never park."""


class Cycle:
    """Six encoders in, six forces out, once per tick.

    Mutable state, all of it: the drive protocol's dialogue, the last tick's record, what is seen of the
    platform, the turns that the drives have forgotten, mode and the tick of its entry, latched faults,
    E-stop, whether the brakes are proven shut, the motion, what the operator allows, the effort's ramps, what
    law, predictor, observer, external wrench, steering and safety keep. `reset` restores the initial one.
    """

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.period_s = 1.0 / parts.rate_Hz
        self.sight = Sight(parts)
        shortest, longest = (parts.safety.limits[name].item() for name in ("length_min_m", "length_max_m"))
        stroke = Stroke(shortest, longest, parts.protocol.reported_lengths())
        self.homing = Homing(parts.last_pose, stroke, self.period_s)
        engage = parts.engage
        self.durations = Durations(engage.force_ramp_s, engage.brake_release_s, engage.closing_s)
        self.effort = Effort(parts, self.durations)
        self.obedience = Obedience(self.effort.model, parts.rate_Hz)
        judged = parts.admission if parts.steering is None else None
        jogging = Jogging(parts.operator, parts.rate_Hz, parts.platform, judged, parts.admission.too_sudden)
        judge = partial(Inspection, parts.platform, parts.admission.on_the_way)
        self.operating = Operating(parts.operator, parts.rate_Hz, engage.stop_s, jogging, judge)
        self._under_control = parts.reactions.led_to("ss1")
        self._torque_off = parts.reactions.led_to("sto")
        followers = (parts.predictor, parts.wrench.observer)
        self._followers = [each for each in followers if each is not None]
        """Who follows the forces that were sent."""
        self._last_wrench: Array  # external, of the last tick: each step begins with it
        self.reset()
        self.first = parts.trajectory.sample(0.0)
        """Where the reference begins."""

    def reset(self) -> None:
        """Back to the state before the first tick."""
        parts = self.parts
        self.dialogue: Dialogue = parts.protocol.start(parts.setup)
        self.tick = new_record()
        """The last tick's record."""
        self.sight.reset()
        self.homing.reset()
        self.motion = Motion(self.period_s, parts.home_p, parts.home_R, parts.engage.stop_s)
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
        self.operating.reset()
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
            buffer.data, 0, number,
            inp.t_ns, inp.lateness_ns, inp.skipped, inp.stretched_ns, inp.sync_skew_ns, inp.sends_failed,
            inp.bus_errors, inp.bus_off, inp.bus_overflow, inp.bus_state, inp.recorder_alive,
            inp.recorder_dropped, inp.compute_ns, *inp.latch_ns, len(inp.frames), zlib.crc32(run),
        )  # fmt: skip
        began_ns, reported = inp.t_ns + inp.lateness_ns, self.homing.before(last)
        self.dialogue = parts.protocol.decode(self.dialogue, run, reported, tick, began_ns)
        self.homing.correct(tick, last, braked=self.proven)
        self.tick = tick
        if parts.sensors is not None:
            self.sight.hear(parts.sensors, inp, tick)
        self.sight.estimate(tick, last, began_ns + min(filter(None, inp.latch_ns), default=0))
        parts.wrench.fill(tick, fusing=self.sight.fusing)

        self.operating.step(inp.orders, number, self.mode, self.motion)
        self._change_mode(inp, tick)
        steering = parts.steering
        if steering is not None:
            under_way = self.mode in STEERED and self.motion.trajectory is parts.trajectory
            along = number - self.motion.tick if under_way else None
            follows = self.mode is Mode.TRACKING and self.operating.go
            steering.step(inp.setpoints, along, tracking=follows and not self.operating.parks)
        t = self.motion.time(number)
        fill_reference(parts.platform, self._sample(tick), tick)
        tick["reference_time_s"] = t
        if self.mode is Mode.TRACKING and self.motion.on_clock:
            tick["t_d"] = t
        self._effort(tick)
        tick["mode"] = self.mode
        verdict = parts.safety.judge(tick)
        warnings = verdict.warnings | Warn.SENSOR if parts.wrench.late else verdict.warnings
        self._latch(inp, verdict)

        latches = parts.protocol.stop_latches
        stops = Operator.ESTOP in inp.operator or (self.estop and not confirmed(tick, latches))
        command = self._command(tick, stops=stops)
        limited = warnings and self.mode in CONTROLLED  # no limit acts without a warning
        self.effort.shortfall = tick["tau"] - tick["tau_asked"] if limited else ZERO6
        for follower in self._followers:
            follower.sent(command.force)
        self.dialogue, frames = parts.protocol.command(self.dialogue, command, number)
        if stops:
            rivalled = self.faults & Fault.SECOND_CONTROLLER
            if latches or rivalled or last["command_mode"] != DriveMode.OFF:  # else OFF is the stop
                frames = parts.protocol.emergency_stop() + frames
        frames += self._set_up(tick)
        setpoints = NO_SETPOINTS if steering is None else steering.counts
        if setpoints.refusal:
            warnings |= Warn.SETPOINT
        _put_three(buffer.data, _MODE_AT, self.mode, self.faults, warnings)
        _put_three(buffer.data, _SETPOINTS_AT, *setpoints)
        return TickOutput(frames, row_of(tick))

    # -- modes ---------------------------------------------------------------------------------------

    def _change_mode(self, inp: TickInput, tick: Record) -> None:
        number, operator = inp.tick, inp.operator
        stays = self.parts.operator.stays
        resets = self.mode in {Mode.FAULT, Mode.WAITING} or (stays and self.mode is Mode.PARKED)
        if operator and Operator.RESET in operator and resets:
            self.reset_tick = number
            self.dialogue = self.parts.protocol.start(self.parts.setup)
            self.faults, self.estop = Fault.NONE, False
            self.stop_requested = Stop.NONE
            self.sight.forget()
            self.obedience.reset()
            self.parts.wrench.forget()
            self.parts.safety.reset()
        elapsed = (number - self.mode_tick) * self.period_s
        if overdue(self.mode, elapsed, self.durations):
            self.faults |= Fault.DRIVE
            waits = self.mode is Mode.PARKING  # for brakes that may not have shut
            self._enter(Mode.HELD if waits else self._after(Fault.DRIVE, tick), tick)
            return
        if self._restless(tick):
            self.faults |= Fault.FOLLOWING
            mode = self._after(Fault.FOLLOWING, tick)
            self._enter(Mode.PARKING if mode is Mode.STOPPING else mode, tick)  # a stop did not help
            return
        facts = Facts(
            operator,
            tick["drive_state"].tolist(),
            self.mode in modes.BEFORE
            and self.homing.known
            and ready(
                tick, self.mode, self.parts.protocol.legs_set_up(self.dialogue), located=self.sight.located
            ),
            elapsed,
            self._finished(tick),
            self.stop_requested is not Stop.NONE,
            self.mode is Mode.HELD and self._provable(tick),
            stays,
        )
        mode = next_mode(self.mode, facts, self.durations)
        if mode is not self.mode:
            self._enter(mode, tick)
        elif self.operating.parks and self.operating.moves(mode):
            self._park(facts, tick)
        if self._yields and self.mode is Mode.PARKING:
            self.motion.rest(tick["p"], tick["R"], number)

    def _finished(self, tick: Record) -> bool:
        """Tell whether the motion has ended, with nothing to follow, and the legs are at rest."""
        motion = self.motion
        ended = motion.finished(int(tick["tick"])) and not motion.away
        return ended and not self.operating.stays(self.mode) and max(abs(tick["dq"]).tolist()) < REST_m_s

    def _restless(self, tick: Record) -> bool:
        """Tell whether the legs are not at rest long after the motion has ended, with nothing to follow."""
        ended = self.mode in ENDING and self.motion.overdue(int(tick["tick"]), REST_PATIENCE_S)
        return ended and not self.operating.stays(self.mode) and not self._finished(tick)

    def _provable(self, tick: Record) -> bool:
        """Tell whether a test could prove the brakes: all legs are heard, believed and at rest."""
        possible = self.durations.load > 0.0 and not self.faults & modes.NO_PROOF
        return possible and measured_at_rest(tick)

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
                move = approach(parts, self.motion.sample(number), self.period_s)
                self.motion.start(move, number, then=parts.trajectory)
                self.operating.engage(number, self.motion)
                effort.entry_tick = number
            case Mode.TRACKING:
                if previous is Mode.LOADING:
                    self.proven = False
                    parts.law.reset()
                    effort.offset = ZERO6
                    if parts.steering is not None:
                        parts.steering.trajectory.reset()
                    effort.entry_tick = number
                    self.operating.engage(number, self.motion)
                self.motion.start(parts.trajectory, number)
                self.operating.enter(mode, number, self.motion)
            case Mode.STOPPING:
                self.operating.parks = False
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

    def _park(self, facts: Facts, tick: Record) -> None:
        """Begin the way back to the first pose once the platform rests, or stop on it."""
        number, motion = int(tick["tick"]), self.motion
        if self.mode is Mode.STOPPING:
            if facts.stop or self.faults or Operator.STOP in facts.operator:
                self._enter(Mode.STOPPING, tick)
        elif self.operating.go and motion.resting:
            move = self.operating.way("park", number, motion, self.first)
            if move is not None:
                motion.start(move, number)
                self.mode, self.mode_tick = Mode.STOPPING, number
                self.operating.enter(self.mode, number, motion)

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
        mode, free, faulty = self.mode, all_free(tick), bool(self.faults)
        effort.fill(tick, mode, self.mode_tick, self.motion, free=free, fixed=blind or yields, faulty=faulty)
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
        if verdict.faults or self.faults or inp.operator:
            self._react(inp, verdict.faults)
        if verdict.stop is not Stop.NONE and self.stop_requested is Stop.NONE:
            self.stop_requested = verdict.stop

    def _react(self, inp: TickInput, faults: Fault) -> None:
        """Go where faults lead that strike now."""
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

    def _after(self, faults: Fault, tick: Record) -> Mode:
        """Return where faults lead that strike now."""
        patience = modes.DRIVE_PATIENCE_S / self.period_s
        heard = bool(((tick["age"] < patience) | (tick["blind"] != 0)).any())
        return modes.after_fault(
            self.mode, faults, self._under_control, self._torque_off, located=self.sight.located, heard=heard
        )

    def _command(self, tick: Record, *, stops: bool) -> Command:
        mode = drive_mode(self.mode)
        if self.mode is Mode.WAITING and self.reset_tick is not None:
            since = int(tick["tick"]) - self.reset_tick
            if since < self.parts.protocol.reset_ticks:  # not for ever: a fault that comes back stays
                mode = DriveMode.RESET
        if mode not in _POWERED_MODES:
            tick["tau"] = 0.0
        tick["command_mode"] = mode
        self.effort.last_tau = tick["tau"]
        return Command(mode, tick["tau"], stops)

    def _set_up(self, tick: Record) -> tuple[Frame, ...]:
        """Return the start-up dialogue's frames of this tick."""
        if self.mode not in {Mode.WAITING, Mode.FAULT}:
            return ()
        self.dialogue, frames = self.parts.protocol.set_up(self.dialogue, tick)
        return frames
