"""The course of a run: which operator commands are given by themselves, when the run ends, and why.

One rule for the daemon and the lockstep. It reads no clock: its time is the tick.
"""

from dataclasses import dataclass
from math import inf

from drivers.signals import NEVER, DriveState, Fault, Mode, Stop
from hil.loop.cycle import Cycle
from hil.loop.report import fault_text, waiting_text
from hil.signals import Operator

NO_DRIVES_S = 2.0
"""A run in which no drive has been heard for this long ends."""
NOT_READY_S = 10.0
"""A run whose drives do not all become ready within this ends: real drives may take a while to boot."""
TAIL_S = 0.25
"""After a fault, or parked, the drives are commanded off for this long at most before the run ends."""
NO_DRIVES = "no drives"
_STOPS = {
    Stop.MISSED: "the loop missed limits.missed_stop_ticks periods in a row",
    Stop.STRETCHED: "this machine was too busy for the virtual bench, whose time stood still, for 4 ms and "
    "more at once, for more than limits.stretch_percent of the run: take load off it, lower loop.rate_Hz, or "
    "use `hil sim`",
    Stop.RECORDER: "the recorder was lost or lost ticks (recording.on_recorder_loss is `stop`)",
}


@dataclass(frozen=True)
class Ending:
    """Why and in which mode a run ended."""

    mode: Mode
    faults: Fault
    reason: str
    """What went wrong; empty for a run that ended as planned or on request."""
    ticks: int
    fault_tick: int = -1
    requested: bool = False
    """The operator, or the duration, asked for the stop."""
    raised: bool = False
    """The loop itself failed."""
    unexpected: str = ""
    """Traceback of a defect of this program, for the log."""

    @property
    def success(self) -> bool:
        """Parked as planned or on request, without a fault."""
        return self.mode is Mode.PARKED and not self.faults and not self.reason


class Course:
    """Engages once the drives are ready, stops after `duration_s`, and ends the run.

    `reset` first clears faults that the drives have latched; without it they end the run.
    Mutable state: which commands have been given, whether a stop was asked for, and whether `duration_s` was
    over before the drives were ready; the last fault's text.
    """

    def __init__(self, cycle: Cycle, duration_s: float | None = None, *, reset: bool = False) -> None:
        self.cycle = cycle
        rate = cycle.parts.rate_Hz
        self._no_drives, self._not_ready = round(NO_DRIVES_S * rate), round(NOT_READY_S * rate)
        self._tail = max(5, round(TAIL_S * rate))
        self._stop_tick = inf if duration_s is None else round(duration_s * rate)
        self._reset = reset
        self._engaged = self._requested = self._late = False
        self._fault_tick, self._fault_text = -1, ""

    def commands(self, tick: int, operator: tuple[Operator, ...] = ()) -> tuple[Operator, ...]:
        """Return the commands of a tick that is about to begin: the run's own, then the operator's."""
        if tick >= self._stop_tick:
            self._stop_tick = inf
            self._late = self.cycle.mode is Mode.WAITING
            operator = (Operator.STOP, *operator)
        if not self._engaged and self.cycle.mode is Mode.IDLE:
            self._engaged = True
            operator = (Operator.ENGAGE, *operator)
        if self._reset:
            self._reset = False
            operator = (Operator.RESET, *operator)
        if operator and (Operator.STOP in operator or Operator.ESTOP in operator):
            self._requested = True
        return operator

    def ending(self, tick: int) -> Ending | None:
        """Return how the run ends with the tick that has just been stepped; None if it goes on.

        It ends parked, once all drives report OFF or TAIL_S later; TAIL_S after a fault; where no drive was
        heard for NO_DRIVES_S; and from then on where a drive has latched a fault, or at NOT_READY_S.
        """
        cycle = self.cycle
        mode, since = cycle.mode, cycle.mode_tick
        match mode:
            case Mode.PARKED if tick - since >= self._tail or _all_off(cycle):
                why = cycle.stop_requested
                reason = f"safety asked for a controlled stop: {_STOPS[why]}" if why in _STOPS else ""
                if self._late:
                    reason = waiting_text(cycle)
                return Ending(mode, cycle.faults, reason, tick, requested=self._requested)
            case Mode.FAULT:
                if self._fault_tick != since:
                    self._fault_tick, self._fault_text = since, fault_text(cycle)
                if tick - since >= self._tail:
                    return Ending(mode, cycle.faults, self._fault_text, tick, since)
            case Mode.WAITING if tick - since >= self._no_drives:
                last = cycle.tick
                if last["age"].min() >= NEVER:
                    return Ending(mode, cycle.faults, NO_DRIVES, tick)
                if tick - since >= self._not_ready or (last["drive_state"] == DriveState.FAULT).any():
                    return Ending(mode, cycle.faults, waiting_text(cycle), tick)
            case _:
                pass
        return None


def _all_off(cycle: Cycle) -> bool:
    return all(state == DriveState.OFF for state in cycle.tick["drive_state"].tolist())
