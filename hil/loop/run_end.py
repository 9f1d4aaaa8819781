"""Course of a run: its own commands to the cycle, when the run ends, and why.

The daemon and the simulation use the same rules. No clock: time is the tick.
"""

from dataclasses import dataclass, field, replace
from math import inf
from typing import Self

from drivers.signals import NEVER, DriveState, Fault, Mode, Stop
from hil.loop.cycle import Cycle
from hil.loop.report import moving_text, waiting_text
from hil.loop.story.narrator import EventSink, Narrator, no_event
from hil.loop.story.story import Story
from hil.signals import Operator

NO_DRIVES_S = 2.0
"""A run ends if no drive has reported for this long."""
NOT_READY_S = 10.0
"""A run ends if not all drives are ready within this time; real drives may take a while to boot."""
TAIL_S = 0.25
"""Time for which the drives are commanded off before the run ends, parked or at rest after a fault."""
HELD_S = 1.0
"""A simulation that holds the platform by force ends when the platform has stood still for this long."""
MOVING_S = 10.0
"""A simulation ends after this time if its platform does not come to rest after a fault, or is held without
rest. Time with closed brakes in between counts."""
_HELD = (
    "not all brakes are proven shut. {}, and the run continues until the platform is released: support it, "
    "then repeat the command with --release. Ctrl-C does not release it"
)
_HOLDS = {
    True: "The drives hold the platform with force",
    False: "Only the brakes hold the platform, as these drives give no force on closed brakes",
}
"""By whether the drives give force on closed brakes."""
_MOVING = "the platform still moves, and the run continues until it rests; Ctrl-C twice ends it"
NO_DRIVES = "no drives"
LEFT_ALONE = "the last operator command was given and the run would wait for another, so it stops and parks"
_STOPS = {
    Stop.MISSED: "the loop missed as many periods in a row as limits.missed_stop_ticks allows",
    Stop.STRETCHED: "this machine was too busy for the virtual bench: its time was stopped, for 4 ms or more "
    "at once, during more than limits.stretch_percent of the run; reduce the load of this machine, lower "
    "loop.rate_Hz, or use `hil sim`",
    Stop.RECORDER: "the recorder was lost or lost ticks (recording.on_recorder_loss is `stop`)",
}


@dataclass(frozen=True)
class Ending:
    """Reason for the end of a run, with the mode and the faults at that time."""

    mode: Mode
    faults: Fault
    reason: str
    """The failure, as text; empty for a run that ended as planned or on request."""
    ticks: int
    fault_tick: int = -1
    requested: bool = False
    """True if the operator, or the duration, requested the stop."""
    raised: bool = False
    """True if the loop itself failed."""
    released: bool = False
    """True if the operator released a platform whose brakes were not proven shut."""
    unexpected: str = ""
    """Traceback of a defect of this program, for the log."""
    done: str = ""
    """Reaction to a failure of the loop itself."""
    story: Story | None = field(default=None, compare=False)
    """Report of the latched faults."""

    @property
    def success(self) -> bool:
        """True if the run parked as planned or on request, without a fault."""
        return self.mode is Mode.PARKED and not self.faults and not self.reason

    @property
    def trouble(self) -> str:
        """Text: failure of the run, its tick, and the reaction to it; empty for a success."""
        text = self.reason
        if self.fault_tick >= 0:
            text = f"{text} at tick {self.fault_tick}"
        reaction = "" if self.story is None else self.story.done_text
        done = "; ".join(filter(None, (reaction, self.done)))
        return f"{text}: {done}" if done else text

    def blamed(self, plant: str) -> Self:
        """The same ending, with the failure of a simulated plant put before the controller's reason."""
        if not plant:
            return self
        reason = f"{plant}; the controller: {self.reason}" if self.reason else plant
        story = None if self.story is None else replace(self.story, plant=plant)
        return replace(self, reason=reason, story=story)


_QUIET = frozenset(Mode) - {Mode.WAITING, Mode.IDLE, Mode.PARKED, Mode.FAULT, Mode.HELD}
"""Modes in which no time limit ends the run."""


class Course:
    """Arms the platform when the drives are ready, stops it after `duration_s`, and ends the run.

    `armed`: starts by itself; otherwise on the operator's ENGAGE, from which `duration_s` then counts.
    `reset` first clears faults that the drives have latched; without it they end the run. `stays`: a held
    platform stays held until the operator releases it. A platform that still moves after a fault keeps the
    run going until it rests, or until the operator requests an emergency stop in FAULT. Without `stays`, as
    in a simulation, both end in time. `event` receives each finding of a fault in its tick. `goes_on`: parked
    or after a fault, a run continues until END, or until `duration_s` is over. A fault takes `armed` back.

    Mutable state: the commands given, and consent in the last tick; the stop tick, now and before the last
    consent; whether a stop was requested, and whether `duration_s` ended before the drives were ready; the
    first fault's tick and the last one's text; since when the platform has been held, including closed brakes
    in between; the last tick with a moving leg; the reported refusal of a move, and whether the operator's
    absence was reported.
    """

    def __init__(
        self,
        cycle: Cycle,
        duration_s: float | None = None,
        *,
        armed: bool = True,
        reset: bool = False,
        stays: bool = False,
        goes_on: bool = False,
        event: EventSink = no_event,
    ) -> None:
        self.cycle = cycle
        self._narrator, self._event = Narrator(cycle, event), event
        self._trouble = ""
        self._operator: tuple[Operator, ...] = ()
        self.stays = stays
        rate = cycle.parts.rate_Hz
        self._held, self._moving = round(HELD_S * rate), round(MOVING_S * rate)
        self._moved_tick = 0
        self._leaves = self._released = False
        self._no_drives, self._not_ready = round(NO_DRIVES_S * rate), round(NOT_READY_S * rate)
        self._tail = max(5, round(TAIL_S * rate))
        self._duration = inf if duration_s is None else round(duration_s * rate)
        self._stop_tick = self._stop_before = self._duration if armed else inf
        self._armed = armed
        self._reset = reset
        self._engaged = self._just_consented = self._requested = self._late = False
        self.goes_on = goes_on
        self._left_alone = False
        self._fault_tick, self._faults, self._fault_text = -1, Fault.NONE, ""
        self._after_fault_since: int | None = None
        self._held_since: int | None = None
        self._quiet = False
        """True while nothing ends the run or has to be reported, until the cycle has something to decide."""

    def commands(self, tick: int, operator: tuple[Operator, ...] = ()) -> tuple[Operator, ...]:
        """Commands to the cycle for a tick that is about to begin: the run's own, then the operator's."""
        if self._quiet and not operator and tick < self._stop_tick:
            self._operator = operator
            return operator
        over = tick >= self._stop_tick
        if over or Operator.END in operator:
            self._stop_tick = inf
            self.goes_on = False
            self._late = self._late or (over and self.cycle.mode is Mode.WAITING)
            operator = (Operator.STOP, *operator)
        if self.cycle.mode is Mode.FAULT:
            self._armed = False  # what follows a RESET is the operator's to begin
        if self._just_consented and self.cycle.mode is Mode.WAITING:  # a drive was switched off just then
            self._engaged, self._stop_tick = False, self._stop_before
        self._just_consented = False
        if not self._engaged and self.cycle.mode is Mode.IDLE:
            self._just_consented = self._armed or Operator.ENGAGE in operator
            self._stop_before = self._stop_tick
            if self._armed:
                self._engaged = True
                operator = (Operator.ENGAGE, *operator)
            elif Operator.ENGAGE in operator:
                self._engaged = True
                self._stop_tick = tick + self._duration
        if self._reset:
            self._reset = False
            operator = (Operator.RESET, *operator)
        if operator and (Operator.STOP in operator or Operator.ESTOP in operator):
            self._requested = True
            self._leaves = self._leaves or (self.cycle.mode is Mode.FAULT and Operator.ESTOP in operator)
        if Operator.RELEASE in operator and self.cycle.mode is Mode.HELD:
            self._released = True
        self._operator = operator
        return operator

    def quiet(self, tick: int) -> float:
        """Ticks, at least 1, for which the run cannot end unless the cycle decides in Python."""
        return max(1, self._stop_tick - tick) if self._quiet else 1

    def left_alone(self) -> tuple[Operator, ...]:
        """Commands to give if the operator gives no more: STOP if the run would wait without end.

        Clears `goes_on`. If `duration_s` ends the run, no command is needed.
        """
        if self._stop_tick < inf:
            return ()
        self.goes_on = False
        cycle = self.cycle
        operating, mode = cycle.operating, cycle.mode
        if operating.moves(mode):
            waits = not (operating.go and operating.speed)
        else:
            waits = mode is Mode.IDLE and (self._engaged or not self._armed)
        if waits and not self._left_alone:
            self._left_alone = True
            self._event(int(cycle.tick["t_ns"]), "warning", LEFT_ALONE)
        return (Operator.STOP,) if waits else ()

    def ending(self, tick: int) -> Ending | None:
        """Ending of the run after the tick that was just stepped; None if the run continues."""
        cycle = self.cycle
        if self._quiet and not cycle.looked:
            return None
        self._narrator.look(self._operator)
        self._tell()
        ending = self._ending(tick)
        if ending is None:
            self._quiet = cycle.mode in _QUIET and not (cycle.faults or self._just_consented)
            return None
        return replace(ending, story=self.story(), reason=ending.reason or self._narrator.short)

    def _tell(self) -> None:
        """Log the reason when a move that the operator requested is refused."""
        cycle = self.cycle
        trouble = cycle.operating.trouble
        if trouble != self._trouble:
            self._trouble = trouble
            if trouble:
                self._event(int(cycle.tick["t_ns"]), "warning", trouble)

    def failed(self, plant: str, tick: int) -> Ending:
        """Ending of a simulation whose plant failed in a tick; plant: the reason."""
        cycle, before = self.cycle, self._narrator.short
        reason = f"{plant}; before that: {before}" if before else plant
        story = self._narrator.story(plant)
        return Ending(cycle.mode, cycle.faults, reason, tick, self._fault_tick, story=story)

    def story(self) -> Story | None:
        """Report of the latched faults so far (cause, reaction, advice); None without any."""
        return self._narrator.story()

    def _ending(self, tick: int) -> Ending | None:
        """Ending of the run after a tick, without its fault report; None if the run continues.

        A run ends when parked, as soon as the brakes are proven and all drives report OFF, or after TAIL_S;
        after a fault, when the legs have been at rest for TAIL_S; when no drive has reported for NO_DRIVES_S;
        after that time also when a drive has latched a fault, or at NOT_READY_S. For exceptions see `stays`.
        """
        cycle = self.cycle
        mode, since = cycle.mode, cycle.mode_tick
        self._note_faults(tick)
        match mode:
            case Mode.PARKED | Mode.FAULT if self.goes_on:
                return None
            case Mode.WAITING if self.goes_on and self._engaged:
                return None
            case Mode.PARKED if tick - since >= self._tail or (cycle.proven and _all_off(cycle)):
                why = cycle.stop_requested
                reason = f"safety requested a controlled stop: {_STOPS[why]}" if why in _STOPS else ""
                if self._late:
                    reason = waiting_text(cycle)
                return Ending(mode, cycle.faults, reason, tick, self._fault_tick, requested=self._requested)
            case Mode.FAULT | Mode.HELD:
                return self._after_fault(tick)
            case Mode.WAITING if tick - since >= self._no_drives:
                last = cycle.tick
                if cycle.homing.refusal:
                    return Ending(mode, cycle.faults, waiting_text(cycle), tick)
                if last["age"].min() >= NEVER:
                    return Ending(mode, cycle.faults, NO_DRIVES, tick)
                if tick - since >= self._not_ready or (last["drive_state"] == DriveState.FAULT).any():
                    return Ending(mode, cycle.faults, waiting_text(cycle), tick)
            case _:
                pass
        return None

    def _after_fault(self, tick: int) -> Ending | None:
        """Ending of a run with a latched fault after this tick; None while it continues."""
        cycle = self.cycle
        mode, since = cycle.mode, cycle.mode_tick
        if self._after_fault_since != since:
            self._after_fault_since = self._moved_tick = since
        moving = moving_text(cycle)
        if moving:
            self._moved_tick = tick
        rested, text = tick - self._moved_tick, self._fault_text
        if mode is Mode.HELD:
            if self._held_since is None:
                self._held_since = tick
            ends = not self.stays and (rested >= self._held or tick - self._held_since >= self._moving)
        else:
            left = self._leaves if self.stays else tick - since >= self._moving
            if moving and left:
                text += f"; still moving: {moving}"
            ends = rested >= self._tail or left
        if not ends:
            return None
        return Ending(mode, cycle.faults, text, tick, self._fault_tick, released=self._released)

    def _note_faults(self, tick: int) -> None:
        faults = self.cycle.faults
        if faults == self._faults:
            return
        if not self._faults or self._faults & ~faults:  # the first ones, or those after a RESET
            self._fault_tick, self._held_since = tick if faults else -1, None
        self._faults, self._fault_text = faults, self._narrator.short

    @property
    def waits_for_consent(self) -> bool:
        """True if all drives are ready and only the operator's consent is missing."""
        return self.cycle.mode is Mode.IDLE and not self._engaged and not self._armed

    @property
    def stays_for(self) -> str:
        """Text: why the run continues after a fault; empty if it ends soon."""
        cycle = self.cycle
        if not self.stays:
            return ""
        if cycle.mode is Mode.HELD:
            return f"{self._fault_text}: {_HELD.format(_HOLDS[cycle.parts.protocol.traits.force_on_brakes])}"
        if cycle.mode is Mode.FAULT and int(cycle.tick["tick"]) - cycle.mode_tick >= self._tail:
            return f"{self._fault_text}: {_MOVING}"
        return ""


def _all_off(cycle: Cycle) -> bool:
    return all(state == DriveState.OFF for state in cycle.tick["drive_state"].tolist())
