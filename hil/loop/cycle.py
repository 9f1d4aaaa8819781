"""The controller: one pure step from received frames to frames to send.

No clock, no file, no random number, no log. TickInput contains everything that changes a decision; that is
why a log replays to the bit.

``frames -> decode -> estimate -> reference -> law -> safety -> encode -> frames``, each stage filling its
columns of the tick's record (`drivers.tick_columns`).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from drivers.arrays import ZERO6, Rows
from drivers.compiled.pointed import Callee
from drivers.controller_end import MOST_FRAMES
from drivers.frame_array import FRAME, sent_array
from drivers.signals import DriveMode, Fault, Mode, Stop
from drivers.tick_columns import Record, new_record, row_of
from hil.loop import compiled_pass, modes
from hil.loop.compiled_pass import ALL, COMMAND, STOPPED, act, observe
from hil.loop.control import Control
from hil.loop.effort import Effort
from hil.loop.homing import Homing, Stroke
from hil.loop.jogging import Jogging
from hil.loop.modes import ENDING, Durations, Facts, drive_mode, next_mode, overdue
from hil.loop.motion import Motion
from hil.loop.obedience import Obedience
from hil.loop.operating import Inspection, Operating, approach
from hil.loop.parts import Parts
from hil.loop.report import any_powered, confirmed, measured_at_rest, ready
from hil.loop.sight import Sight
from hil.loop.tick_input import put_input
from hil.safety.guard import Verdict
from hil.safety.motion import REST_m_s
from hil.signals import Operator, TickInput, TickOutput

REST_PATIENCE_S = 1.0
"""Legs that still move this long after the end of the motion are a fault: otherwise they would never park."""


class Cycle:
    """The controller of one platform: six leg lengths in, six leg forces out, once per tick.

    Mutable state: the dialogue with the drives, the records of the last two ticks, the observed platform
    state, motor turns lost at power-off, the mode and its entry tick, latched faults, emergency stop, brake
    proof, the motion, the operator's permissions, the force ramps, the control record, and the states of law,
    observers, steering and safety. `reset` restores the initial state.
    """

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.period_s = 1.0 / parts.rate_Hz
        self.sight = Sight(parts)
        shortest, longest = (parts.safety.limits[name].item() for name in ("length_min_m", "length_max_m"))
        stroke = Stroke(shortest, longest, parts.protocol.traits.reported_lengths)
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
        self.end = parts.protocol.controller_end(parts.setup)
        """The dialogue with the drives."""
        self.opening = Callee(self.end.opening, self.end.opener, self.end)
        """Function of the frames that start a tick: arguments (context, tick, address of FRAME)."""
        if parts.sensors is not None:
            self.opening = parts.sensors.opening(self.opening, parts.protocol, parts.rate_Hz)
        self.control = Control(self)
        """The record shared with compiled code."""
        self.reset()
        self.first = parts.trajectory.sample(0.0)
        """Sample at the start of the reference."""

    def reset(self) -> None:
        """Restore the state before the first tick."""
        parts = self.parts
        self.end.start()
        self.tick = self.last = new_record()
        """Records of the last tick and of the one before it."""
        self.sight.reset()
        self.homing.reset()
        self.motion = Motion(self.period_s, parts.home_p, parts.home_R, parts.engage.stop_s)
        self.mode = Mode.WAITING
        self.mode_tick = 0
        self.looked = True
        """True if the last tick had something for the cycle to decide."""
        self._yields = False
        """PARKING after a fault: the reference stays at the platform's pose, and the holding force is the
        whole force. A law that the platform did not follow could work against the brakes."""
        self.proven = True
        """True if a brake test has passed since the brakes were last open, or if they have not been open."""
        self.faults, self.estop = Fault.NONE, False
        """Latched faults; emergency stop, which is repeated until all drives confirm it."""
        self.stop_requested = Stop.NONE
        self.reset_tick: int | None = None
        """Tick at which the operator last requested that the drives' faults be cleared."""
        self.effort.reset()
        self.obedience.reset()
        self.operating.reset()
        for part in (parts.law, parts.wrench, parts.predictor, parts.safety, parts.steering):
            if part is not None:
                part.reset()
        self.control.reset()

    def begin(self, tick: int) -> Rows:
        """Frames that start a tick (SYNC or polls), FRAME records; drives answer them with feedback."""
        sensors, into = self.parts.sensors, np.empty(MOST_FRAMES, FRAME)
        return self.end.begin(tick) if sensors is None else sensors.begin(self.opening, tick, into)

    def step(self, inp: TickInput) -> TickOutput:
        """Run one tick; returns the frames to send and the row to record."""
        tick, into = new_record(), np.empty(MOST_FRAMES, FRAME)
        put_input(tick, inp)
        look = observe(self.control.record, tick, self.tick, inp.frames)
        self.pass_on(self.tick, tick)
        return TickOutput(self.decide(inp, into, look), row_of(tick))

    def pass_on(self, last: Record, tick: Record) -> None:
        """Set the records of the last two ticks, after compiled code has run ticks without the cycle."""
        self.last, self.tick, self.looked = last, tick, False

    def decide(self, inp: TickInput, into: Rows, look: int = 0) -> Rows:
        """Run a tick after `observe`, with all decisions in Python; returns its frames, FRAME records.

        into: room for MOST_FRAMES of them; look: the result of `compiled_pass.observe`.
        """
        looked = look or inp.orders or inp.operator or inp.setpoints
        if looked:
            self._decide(inp, self.tick, look)
            self.control.settle(attentive=bool(inp.operator))
        ended = self.control.act(self.tick, into)
        return self.end_tick(inp, into, ended, looked=bool(looked or self.control.probes))

    def end_tick(self, inp: TickInput, into: Rows, ended: int, *, looked: bool = False) -> Rows:
        """Frames of a tick that `act` ended with status `ended`; looked: the cycle has decided before."""
        self.looked = looked or bool(ended)
        return self._finish(inp, self.tick, into, ended) if ended else into[: self.control.record["sent"]]

    def _decide(self, inp: TickInput, tick: Record, look: int) -> None:
        """Handle what compiled code leaves to Python: drives' set-up, first pose, orders, mode changes."""
        parts, number = self.parts, inp.tick
        if look & compiled_pass.UNLOCATED:
            self.sight.locate(tick)
            self.control.load(tick)
        self.effort.last_tau = self.last["tau"]
        self.operating.step(inp.orders, number, self.mode, self.motion)
        self._change_mode(inp, tick)
        steering = parts.steering
        if steering is not None:
            follows = self.mode is Mode.TRACKING and self.operating.go
            steering.take(inp.setpoints, tracking=follows and not self.operating.parks)

    def _finish(self, inp: TickInput, tick: Record, into: Rows, ended: int) -> Rows:
        """Handle a tick that `act` ended early, mostly by a safety finding; returns the resulting frames."""
        control, record, parts = self.control, self.control.record, self.parts
        if ended == STOPPED:
            control.stop_on_the_way()
            if not act(record, tick, into, ALL):
                return into[: record["sent"]]
        self.effort.last_tau = self.last["tau"]
        law = self.effort.law.keeps
        if isinstance(law.raised, KeyboardInterrupt):
            law.raised = None
            raise KeyboardInterrupt
        self._latch(inp, Verdict.of(*record["verdict"].tolist()))
        latches = parts.protocol.traits.stop_latches
        stops = Operator.ESTOP in inp.operator or (self.estop and not confirmed(tick, latches))
        control.settle()
        record["command_mode"], record["stops"] = self._command_mode(tick), stops
        if act(record, tick, into, COMMAND):
            raise self.end.unfit(tick["tau"])
        frames = [into[: record["sent"]]]
        record["stops"] = 0
        self.effort.last_tau = tick["tau"]
        off = self.last["command_mode"] == DriveMode.OFF and not (
            latches or self.faults & Fault.SECOND_CONTROLLER
        )
        if stops and not off:  # else OFF is the stop
            frames.insert(0, sent_array(parts.protocol.traits.emergency_stop))
        if self.mode in {Mode.WAITING, Mode.FAULT}:
            frames += [self.end.set_up(tick), self.sight.set_up(inp.tick)]
        return np.concatenate(frames) if len(frames) > 1 else frames[0]

    # -- modes ---------------------------------------------------------------------------------------

    def _change_mode(self, inp: TickInput, tick: Record) -> None:
        number, operator = inp.tick, inp.operator
        stays = self.parts.operator.stays
        resets = self.mode in {Mode.FAULT, Mode.WAITING} or (stays and self.mode is Mode.PARKED)
        if operator and Operator.RESET in operator and resets:
            self.reset_tick = number
            self.end.start()
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
            and not self.sight.starts(number)
            and ready(tick, self.mode, self.end.legs_set_up(), located=self.sight.located),
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
        """True if the motion has ended, no other motion follows, and the legs are at rest."""
        motion = self.motion
        ended = motion.finished(int(tick["tick"])) and not motion.away
        return ended and not self.operating.stays(self.mode) and max(abs(tick["dq"]).tolist()) < REST_m_s

    def _restless(self, tick: Record) -> bool:
        """True if no motion follows and the legs still move REST_PATIENCE_S after the end of the motion."""
        ended = self.mode in ENDING and self.motion.overdue(int(tick["tick"]), REST_PATIENCE_S)
        return ended and not self.operating.stays(self.mode) and not self._finished(tick)

    def _provable(self, tick: Record) -> bool:
        """True if a brake test is possible: all legs report trusted readings and are at rest."""
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
        """Start the way back to the first pose once the platform rests; on it, stop on request or fault."""
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
        """Use only the static holding force at the present pose from now on, until the brakes are closed."""
        self._yields = True
        self.motion.rest(tick["p"], tick["R"], int(tick["tick"]))
        self.effort.holding = self.effort.statics(tick["p"], tick["R"], tick["wrench"])
        self.obedience.forget()

    def _hold(self, previous: Mode, tick: Record) -> None:
        """Start to hold the platform, by the last holding force or by the static force at its pose.

        After motion, the pose is the reference if a fault has made the measurement unusable.
        """
        effort, number = self.effort, int(tick["tick"])
        blind = bool(self.faults & modes.NOT_MEASURED)
        if previous is Mode.PARKING:
            effort.holding = effort.last_tau
        elif previous not in {Mode.LOADING, Mode.UNLOADING}:
            p, R = self.motion.sample(number)[:2] if blind else (tick["p"], tick["R"])
            effort.holding = effort.statics(p, R, self.last["wrench"] if blind else tick["wrench"])
            self.motion.rest(p, R, number)
        effort.hold(tick, effort.holding, self.motion.sample(number), on_it=True)
        self.parts.safety.resume(effort.holding)
        self.obedience.forget()

    # -- reference, effort ---------------------------------------------------------------------------

    @property
    def yields(self) -> bool:
        """True while the platform parks with only the static holding force."""
        return self.mode is Mode.PARKING and self._yields

    @property
    def watches(self) -> bool:
        """True while each leg is checked for a drive that does not obey."""
        shuts = self.mode is Mode.HELD and not self.faults & modes.NO_PROOF  # no brake is known to be open
        return self.yields or shuts

    # -- safety, command -----------------------------------------------------------------------------

    def _latch(self, inp: TickInput, verdict: Verdict) -> None:
        if verdict.faults or self.faults or inp.operator:
            self._react(inp, verdict.faults)
        if verdict.stop is not Stop.NONE and self.stop_requested is Stop.NONE:
            self.stop_requested = verdict.stop

    def _react(self, inp: TickInput, faults: Fault) -> None:
        """Latch the faults of this tick and change to the mode that they require."""
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
        """Mode that the faults of this tick require."""
        patience = modes.DRIVE_PATIENCE_S / self.period_s
        heard = bool(((tick["age"] < patience) | (tick["blind"] != 0)).any())
        return modes.after_fault(
            self.mode, faults, self._under_control, self._torque_off, located=self.sight.located, heard=heard
        )

    def _command_mode(self, tick: Record) -> DriveMode:
        if self.mode is Mode.WAITING and self.reset_tick is not None:
            since = int(tick["tick"]) - self.reset_tick
            if since < self.parts.protocol.traits.reset_ticks:  # not for ever: a fault that comes back stays
                return DriveMode.RESET
        return drive_mode(self.mode)
