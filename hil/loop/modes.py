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

from collections.abc import Sequence
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


class Durations(NamedTuple):
    """Times of the entry and the exit, s."""

    load: float
    release: float


def next_mode(mode: Mode, facts: Facts, durations: Durations) -> Mode:
    """Return the mode of this tick. Faults are latched elsewhere: here FAULT only leaves by RESET."""
    if (facts.stop or Operator.STOP in facts.operator) and mode in _STOPPED:
        return _STOPPED[mode]
    return _NEXT[mode](facts, durations)


def _waiting(facts: Facts, durations: Durations) -> Mode:
    del durations
    return Mode.IDLE if facts.ready and _all(facts, DriveState.OFF) else Mode.WAITING


def _idle(facts: Facts, durations: Durations) -> Mode:
    del durations
    return Mode.LOADING if Operator.ENGAGE in facts.operator else Mode.IDLE


def _loading(facts: Facts, durations: Durations) -> Mode:
    if facts.elapsed < durations.load or not _all(facts, DriveState.READY):
        return Mode.LOADING
    return Mode.RELEASING if durations.load > 0 else Mode.TRACKING


def _releasing(facts: Facts, durations: Durations) -> Mode:
    open_ = facts.elapsed >= durations.release and _all(facts, DriveState.RUN)
    return Mode.APPROACH if open_ else Mode.RELEASING


def _approach(facts: Facts, durations: Durations) -> Mode:
    del durations
    return Mode.TRACKING if facts.finished else Mode.APPROACH


def _tracking(facts: Facts, durations: Durations) -> Mode:
    del durations
    return Mode.PARKING if facts.finished else Mode.TRACKING


def _stopping(facts: Facts, durations: Durations) -> Mode:
    del durations
    return Mode.PARKING if facts.finished else Mode.STOPPING


def _parking(facts: Facts, durations: Durations) -> Mode:
    shut = facts.elapsed >= durations.release and _all(facts, DriveState.READY)
    return Mode.UNLOADING if shut else Mode.PARKING


def _unloading(facts: Facts, durations: Durations) -> Mode:
    return Mode.PARKED if facts.elapsed >= durations.load else Mode.UNLOADING


def _parked(facts: Facts, durations: Durations) -> Mode:
    del facts, durations
    return Mode.PARKED


def _fault(facts: Facts, durations: Durations) -> Mode:
    del durations
    return Mode.WAITING if Operator.RESET in facts.operator else Mode.FAULT


def _all(facts: Facts, state: DriveState) -> bool:
    return all(s == state for s in facts.drive_state)


_NEXT = (
    _waiting, _idle, _loading, _releasing, _approach, _tracking, _stopping, _parking, _unloading, _parked,
    _fault,
)  # fmt: skip
"""By mode: where it leads without a stop."""
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


def overdue(mode: Mode, elapsed: float, durations: Durations) -> bool:
    """Tell whether a mode that waits for the drives has waited too long; elapsed in s since its entry."""
    return mode in _WAITS_FOR and elapsed > durations[_WAITS_FOR[mode]] + DRIVE_PATIENCE_S


def drive_mode(mode: Mode) -> DriveMode:
    """Return what the drives are asked for in a mode."""
    return _DRIVES.get(mode, DriveMode.OFF)
