"""Where the controller is between rest and motion: a table of transitions.

`next_mode` decides from its arguments; the cycle keeps the present mode and the tick at which it was
entered.

::

    WAITING <-> IDLE -> LOADING -> RELEASING -> APPROACH -> TRACKING -> PARKING -> UNLOADING -> PARKED
                                                  +---> STOPPING <---+   ^
                                                            +------------+
    a fault in motion, by its reaction: ss1 -> STOPPING, sbc -> PARKING, or HELD where a leg is not measured,
                                        sto -> FAULT (latched) -> WAITING on RESET
    PARKED -> WAITING on RESET, where operator.stays
    brakes engaged, not proven shut -> HELD (latched, force on) -> FAULT on RELEASE

Brakes open and close only on the drives' own word: a drive that does not report the state it was asked
for keeps LOADING, RELEASING and PARKING, with the force on, until they are `overdue`. That word is not
believed: LOADING begins, and UNLOADING ends, with all six brakes carrying the platform while the legs must
stand still. A leg that moves leads to HELD, and so does one that is not measured before its brake is proven;
once it is measured again there is another test.
A drive in FAULT shuts its brake by itself: it is waited for no longer, and where all six are there is no
force that could hold.
Without a force ramp LOADING goes straight to TRACKING: the law acts at the instant the brakes open. There is
no brake test then.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from drivers.signals import DriveMode, DriveState, Fault, Mode
from hil.signals import Operator

MOVING = frozenset({Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes in which the brakes are open."""
CONTROLLED = MOVING | {Mode.PARKING, Mode.HELD}
"""Modes in which the law acts: it does not let go before the brakes are shut."""
BEFORE = frozenset({Mode.WAITING, Mode.IDLE})
"""Modes that wait: for the drives, then for the operator."""
BRAKED = frozenset({Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED})
"""Modes in which the brakes carry the platform, or begin to: the legs must stand still."""
UNPROVEN = frozenset({Mode.PARKING, Mode.UNLOADING, Mode.HELD})
"""Modes with the force on and the brakes engaged, but not proven shut."""
NOBODY_OBEYS = Fault.ESTOP | Fault.BUS | Fault.SECOND_CONTROLLER
"""Faults after which there is no force that could stay on."""
NOT_MEASURED = (
    Fault.STALE | Fault.KINEMATICS | Fault.ASSEMBLY | Fault.CONDITION | Fault.NOT_FINITE | Fault.LAW
    | Fault.ENCODER | Fault.UNCERTAIN | Fault.DUPLICATE_NODE
)  # fmt: skip
"""Faults after which the law holds nothing, and no leg is seen to stand still: the holding force stays as it
is."""
NO_PROOF = (NOT_MEASURED & ~Fault.STALE) | Fault.BRAKE
"""Faults after which no test of the brakes is believed."""
OF_THE_POSE = (
    Fault.KINEMATICS | Fault.ASSEMBLY | Fault.CONDITION | Fault.STROKE | Fault.SPEED | Fault.FOLLOWING
    | Fault.NOT_FINITE | Fault.UNCERTAIN | Fault.ENCODER
)  # fmt: skip
"""Faults that follow by themselves where a leg is not measured."""
ENDING = frozenset({Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes that end when the motion has ended and the legs are at rest."""
STEERED = frozenset({Mode.TRACKING, Mode.STOPPING})
"""Modes in which a live reference moves."""
PROOF_S = 0.1
"""So long the legs must stand still without any force before the brakes are proven shut."""
DRIVE_PATIENCE_S = 1.0
"""A drive that has not reached the state it was asked for so long after it could have, is faulty."""


class Facts(NamedTuple):
    """What a transition may depend on."""

    operator: tuple[Operator, ...]
    drive_state: Sequence[int]
    """Six DriveState."""
    ready: bool
    """All six drives set up and their turns known; in WAITING, which it ends, also all legs heard lately and
    the pose found. Asked for in WAITING and IDLE."""
    elapsed: float
    """s since the present mode was entered."""
    finished: bool
    """The present motion (approach, reference, stop) has ended, not on hold, and the legs are at rest."""
    stop: bool
    """Safety asks for a controlled stop."""
    provable: bool
    """All six legs are heard, believed and at rest, and no brake has failed: a test could prove them."""
    stays: bool
    """A parked platform may be made ready again: operator.stays."""

    def all_in(self, *states: DriveState) -> bool:
        """Tell whether all six drives report one of these states."""
        return all(s in states for s in self.drive_state)


class Durations(NamedTuple):
    """Times of the entry and the exit, s."""

    load: float
    """In which the holding force builds up, or fades out; 0: without ramp and brake test."""
    release: float
    """Given to the brakes to open."""
    close: float
    """Given to the brakes to close."""

    def least(self, mode: Mode) -> float:
        """Return how long a mode takes at least."""
        match mode:
            case Mode.LOADING:
                return 2.0 * self.load  # the brake test, then the ramp
            case Mode.RELEASING:
                return self.release
            case Mode.PARKING | Mode.HELD:
                return self.close
            case Mode.UNLOADING:
                return self.load + PROOF_S if self.load > 0.0 else 0.0
            case _:
                return 0.0


_BRAKED_DRIVE = (DriveState.READY, DriveState.FAULT)


def _finished(facts: Facts, _least: float) -> bool:
    return facts.finished


_NEXT: tuple[tuple[Mode, Callable[[Facts, float], bool]], ...] = (
    (Mode.IDLE, lambda facts, _: facts.ready and facts.all_in(DriveState.OFF)),
    (Mode.LOADING, lambda facts, _: Operator.ENGAGE in facts.operator),
    (Mode.RELEASING, lambda facts, least: facts.elapsed >= least and facts.all_in(DriveState.READY)),
    (Mode.APPROACH, lambda facts, least: facts.elapsed >= least and facts.all_in(DriveState.RUN)),
    (Mode.TRACKING, _finished),
    (Mode.PARKING, _finished),
    (Mode.PARKING, _finished),
    (Mode.UNLOADING, lambda facts, least: facts.elapsed >= least and facts.all_in(*_BRAKED_DRIVE)),
    (Mode.PARKED, lambda facts, least: facts.elapsed >= least),
    (Mode.WAITING, lambda facts, _: facts.stays and Operator.RESET in facts.operator),
    (Mode.WAITING, lambda facts, _: Operator.RESET in facts.operator),
    (Mode.FAULT, lambda facts, _: Operator.RELEASE in facts.operator or facts.all_in(DriveState.FAULT)),
)
"""By mode: where it leads without a stop, and when: from the facts, and how long it takes at least, s."""
_STOPPED = {
    Mode.WAITING: Mode.PARKED,
    Mode.IDLE: Mode.PARKED,
    Mode.LOADING: Mode.UNLOADING,
    Mode.RELEASING: Mode.PARKING,
    Mode.APPROACH: Mode.STOPPING,
    Mode.TRACKING: Mode.STOPPING,
}
"""Where a stop leads; the other modes are already on their way to rest."""
STOPPABLE = frozenset(_STOPPED)
"""Modes in which a stop leads elsewhere."""
_WAITING = frozenset({Mode.LOADING, Mode.RELEASING, Mode.PARKING})
"""Modes that wait for the drives."""
_DRIVES = {
    **dict.fromkeys(MOVING, DriveMode.RUN),
    **dict.fromkeys((Mode.LOADING, Mode.PARKING, Mode.UNLOADING, Mode.HELD), DriveMode.READY),
}
"""What the drives are asked for; OFF in the other modes."""


def next_mode(mode: Mode, facts: Facts, durations: Durations) -> Mode:
    """Return the mode of this tick. Faults are for `after_fault`: here FAULT only leaves by RESET."""
    if (facts.stop or Operator.STOP in facts.operator) and mode in _STOPPED:
        return _STOPPED[mode]
    if mode is Mode.HELD and facts.provable and _NEXT[Mode.PARKING][1](facts, durations.close):
        return Mode.UNLOADING
    if mode is Mode.IDLE and not facts.ready:  # a drive was switched off and on
        return Mode.WAITING
    following, due = _NEXT[mode]
    if not due(facts, durations.least(mode)):
        return mode
    return Mode.TRACKING if mode is Mode.LOADING and durations.load <= 0 else following


def overdue(mode: Mode, elapsed: float, durations: Durations) -> bool:
    """Tell whether a mode that waits for the drives has waited too long; elapsed in s since its entry."""
    return mode in _WAITING and elapsed > durations.least(mode) + DRIVE_PATIENCE_S


def after_fault(
    mode: Mode, faults: Fault, under_control: Fault, torque_off: Fault, *, located: bool, heard: bool
) -> Mode:
    """Return where faults that strike in a mode lead, by what is still known.

    under_control: after which a stop along the path may be relied on (ss1); torque_off: after which none of
    the force stays on (sto); located: the pose has been found; heard: not all drives have
    been silent for DRIVE_PATIENCE_S.
    The force stays on, or comes back, where a brake may not hold: as long as there is one.
    """
    if mode is Mode.FAULT or not heard or faults & (NOBODY_OBEYS | torque_off):
        return Mode.FAULT
    blind = bool(faults & NOT_MEASURED)
    if mode in UNPROVEN:
        return Mode.HELD if blind or faults & Fault.BRAKE else mode
    if mode in BRAKED:
        return Mode.HELD if located and faults & Fault.BRAKE else Mode.FAULT
    if mode not in MOVING:
        return Mode.FAULT
    if blind:
        return Mode.HELD
    return Mode.PARKING if mode is Mode.RELEASING or faults & ~under_control else Mode.STOPPING


def drive_mode(mode: Mode) -> DriveMode:
    """Return what the drives are asked for in a mode."""
    return _DRIVES.get(mode, DriveMode.OFF)
