"""Where the controller is between rest and motion: a table of transitions.

Rule of the room: pure. `next_mode` decides from what it is told; the cycle keeps the present mode and
the tick at which it was entered.

::

    WAITING -> IDLE -> LOADING -> RELEASING -> APPROACH -> TRACKING -> PARKING -> PARKED
                                                  +---> STOPPING <---+   ^
                                                            +------------+
    any -> FAULT (latched) -> WAITING on RESET

Without a force ramp LOADING goes straight to TRACKING: the law acts at the instant the brakes open.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from drivers.signals import DriveMode, DriveState
from hil.signals import Mode, Operator

MOVING = frozenset({Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes in which the brakes are open."""
POWERED = MOVING | {Mode.LOADING, Mode.PARKING}
"""Modes in which the drives produce force."""


class Facts(NamedTuple):
    """What a transition may depend on."""

    operator: tuple[Operator, ...]
    drive_state: Sequence[int]
    """Six DriveState."""
    heard: bool
    """All six legs have been heard lately."""
    elapsed: float
    """s since the present mode was entered."""
    finished: bool
    """The present motion (approach, reference, stop) has ended."""
    stop: bool
    """Safety asks for a controlled stop."""


class Durations(NamedTuple):
    """Times of the entry and the exit, s."""

    load: float
    release: float
    park: float


def next_mode(mode: Mode, facts: Facts, durations: Durations) -> Mode:
    """Return the mode of this tick. Faults are latched elsewhere: here FAULT only leaves by RESET."""
    stop = facts.stop or Operator.STOP in facts.operator
    state = facts.drive_state
    match mode:
        case Mode.WAITING:
            if stop:
                return Mode.PARKED
            if facts.heard and all(s == DriveState.OFF for s in state):
                return Mode.IDLE
        case Mode.IDLE:
            if stop:
                return Mode.PARKED
            if Operator.ENGAGE in facts.operator:
                return Mode.LOADING
        case Mode.LOADING:
            if stop:
                return Mode.PARKING
            if facts.elapsed >= durations.load and all(s == DriveState.READY for s in state):
                return Mode.RELEASING if durations.load > 0 else Mode.TRACKING
        case Mode.RELEASING:
            if stop:
                return Mode.PARKING
            if facts.elapsed >= durations.release and all(s == DriveState.RUN for s in state):
                return Mode.APPROACH
        case Mode.APPROACH:
            if stop:
                return Mode.STOPPING
            if facts.finished:
                return Mode.TRACKING
        case Mode.TRACKING:
            if stop:
                return Mode.STOPPING
            if facts.finished:
                return Mode.PARKING
        case Mode.STOPPING:
            if facts.finished:
                return Mode.PARKING
        case Mode.PARKING:
            if facts.elapsed >= durations.park:
                return Mode.PARKED
        case Mode.PARKED:
            pass
        case Mode.FAULT:
            if Operator.RESET in facts.operator:
                return Mode.WAITING
    return mode


def drive_mode(mode: Mode) -> DriveMode:
    """Return what the drives are asked for in a mode."""
    if mode in MOVING:
        return DriveMode.RUN
    if mode in {Mode.LOADING, Mode.PARKING}:
        return DriveMode.READY
    return DriveMode.OFF
