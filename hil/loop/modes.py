"""Where the controller is between rest and motion: a table of transitions.

`next_mode` decides from its arguments; the cycle keeps the present mode and the tick at which it was
entered.

::

    WAITING -> IDLE -> LOADING -> RELEASING -> APPROACH -> TRACKING -> PARKING -> UNLOADING -> PARKED
                                                  +---> STOPPING <---+   ^
                                                            +------------+
    any -> FAULT (latched) -> WAITING on RESET

Brakes open and close only on the drives' own word: a drive that does not report the state it was asked
for keeps LOADING, RELEASING and PARKING, with the force on, until they are `overdue`.
Without a force ramp LOADING goes straight to TRACKING: the law acts at the instant the brakes open.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from drivers.signals import DriveMode, DriveState, Mode
from hil.signals import Operator

MOVING = frozenset({Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes in which the brakes are open."""
CONTROLLED = MOVING | {Mode.PARKING}
"""Modes in which the law acts: it does not let go before the brakes are shut."""
ENDING = frozenset({Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes that end when the motion has ended and the legs are at rest."""
STEERED = frozenset({Mode.TRACKING, Mode.STOPPING})
"""Modes in which a live reference moves."""
DRIVE_PATIENCE_S = 1.0
"""A drive that has not reached the state it was asked for so long after it could have, is faulty."""


class Facts(NamedTuple):
    """What a transition may depend on."""

    operator: tuple[Operator, ...]
    drive_state: Sequence[int]
    """Six DriveState."""
    ready: bool
    """All six legs heard lately, the pose found, all six drives set up; only WAITING asks for it."""
    elapsed: float
    """s since the present mode was entered."""
    finished: bool
    """The present motion (approach, reference, stop) has ended and the legs are at rest."""
    stop: bool
    """Safety asks for a controlled stop."""

    def all_in(self, state: DriveState) -> bool:
        """Tell whether all six drives report this state."""
        return all(s == state for s in self.drive_state)


class Durations(NamedTuple):
    """Times of the entry and the exit, s."""

    load: float
    release: float


def _finished(facts: Facts, _durations: Durations) -> bool:
    return facts.finished


_NEXT: tuple[tuple[Mode, Callable[[Facts, Durations], bool]], ...] = (
    (Mode.IDLE, lambda facts, _: facts.ready and facts.all_in(DriveState.OFF)),
    (Mode.LOADING, lambda facts, _: Operator.ENGAGE in facts.operator),
    (Mode.RELEASING, lambda facts, least: facts.elapsed >= least.load and facts.all_in(DriveState.READY)),
    (Mode.APPROACH, lambda facts, least: facts.elapsed >= least.release and facts.all_in(DriveState.RUN)),
    (Mode.TRACKING, _finished),
    (Mode.PARKING, _finished),
    (Mode.PARKING, _finished),
    (Mode.UNLOADING, lambda facts, least: facts.elapsed >= least.release and facts.all_in(DriveState.READY)),
    (Mode.PARKED, lambda facts, least: facts.elapsed >= least.load),
    (Mode.PARKED, lambda _facts, _: False),
    (Mode.WAITING, lambda facts, _: Operator.RESET in facts.operator),
)
"""By mode: where it leads without a stop, and when."""
_STOPPED = {
    Mode.WAITING: Mode.PARKED,
    Mode.IDLE: Mode.PARKED,
    Mode.LOADING: Mode.UNLOADING,
    Mode.RELEASING: Mode.PARKING,
    Mode.APPROACH: Mode.STOPPING,
    Mode.TRACKING: Mode.STOPPING,
}
"""Where a stop leads; the other modes are already on their way to rest."""

_LOAD, _RELEASE = range(2)
_WAITS_FOR = {Mode.LOADING: _LOAD, Mode.RELEASING: _RELEASE, Mode.PARKING: _RELEASE}
"""Modes that wait for the drives: which of the Durations they take at least."""
_DRIVES = {
    **dict.fromkeys(MOVING, DriveMode.RUN),
    **dict.fromkeys((Mode.LOADING, Mode.PARKING, Mode.UNLOADING), DriveMode.READY),
}
"""What the drives are asked for; OFF in the other modes."""


def next_mode(mode: Mode, facts: Facts, durations: Durations) -> Mode:
    """Return the mode of this tick. Faults are latched elsewhere: here FAULT only leaves by RESET."""
    if (facts.stop or Operator.STOP in facts.operator) and mode in _STOPPED:
        return _STOPPED[mode]
    following, due = _NEXT[mode]
    if not due(facts, durations):
        return mode
    return Mode.TRACKING if mode is Mode.LOADING and durations.load <= 0 else following


def overdue(mode: Mode, elapsed: float, durations: Durations) -> bool:
    """Tell whether a mode that waits for the drives has waited too long; elapsed in s since its entry."""
    return mode in _WAITS_FOR and elapsed > durations[_WAITS_FOR[mode]] + DRIVE_PATIENCE_S


def drive_mode(mode: Mode) -> DriveMode:
    """Return what the drives are asked for in a mode."""
    return _DRIVES.get(mode, DriveMode.OFF)
