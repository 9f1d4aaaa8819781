"""Modes of the controller between rest and motion: a table of transitions.

`next_mode` decides from its arguments; the cycle keeps the present mode and its entry tick.

::

    WAITING <-> IDLE -> LOADING -> RELEASING -> APPROACH -> TRACKING -> PARKING -> UNLOADING -> PARKED
                                                  +---> STOPPING <---+   ^
                                                            +------------+
    a fault in motion, by its reaction: ss1 -> STOPPING, sbc -> PARKING, or HELD where a leg is not measured,
                                        sto -> FAULT (latched) -> WAITING on RESET
    PARKED -> WAITING on RESET, where operator.stays
    brakes engaged, not proven shut -> HELD (latched, force on) -> FAULT on RELEASE

Brakes count as open or closed by the drives' report alone. If a drive does not report the commanded state,
LOADING, RELEASING and PARKING continue with the force on, until they are `overdue`. The report of closed
brakes is not trusted: LOADING begins, and UNLOADING ends, with a brake test. All six brakes carry the
platform while the legs must stand still. A leg that moves, or is not measured before its brake is proven,
leads to HELD; as soon as it is measured again the test is repeated.

A drive in FAULT shuts its brake by itself, so the controller no longer waits for it. If all six are in FAULT,
no force can hold the platform.

Without a force ramp LOADING goes straight to TRACKING: the law acts as soon as the brakes open. There is no
brake test then.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from drivers.signals import DriveMode, DriveState, Fault, Mode
from hil.signals import Operator

MOVING = frozenset({Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes in which the brakes are open."""
CONTROLLED = MOVING | {Mode.PARKING, Mode.HELD}
"""Modes in which the law acts: it holds the platform until the brakes are shut."""
BEFORE = frozenset({Mode.WAITING, Mode.IDLE})
"""Modes that wait, first for the drives, then for the operator."""
BRAKED = frozenset({Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED})
"""Modes in which the brakes carry the platform, or start to: the legs must stand still."""
UNPROVEN = frozenset({Mode.PARKING, Mode.UNLOADING, Mode.HELD})
"""Modes with the force on and the brakes engaged, but not proven shut."""
NOBODY_OBEYS = Fault.ESTOP | Fault.BUS | Fault.SECOND_CONTROLLER
"""Faults after which no force can stay on."""
NOT_MEASURED = (
    Fault.STALE | Fault.KINEMATICS | Fault.ASSEMBLY | Fault.CONDITION | Fault.NOT_FINITE | Fault.LAW
    | Fault.ENCODER | Fault.UNCERTAIN | Fault.DUPLICATE_NODE
)  # fmt: skip
"""Faults after which the law cannot hold the platform, and a standstill cannot be measured. The holding force
then stays constant."""
NO_PROOF = (NOT_MEASURED & ~Fault.STALE) | Fault.BRAKE
"""Faults after which no brake test is trusted."""
OF_THE_POSE = (
    Fault.KINEMATICS | Fault.ASSEMBLY | Fault.CONDITION | Fault.STROKE | Fault.SPEED | Fault.FOLLOWING
    | Fault.NOT_FINITE | Fault.UNCERTAIN | Fault.ENCODER
)  # fmt: skip
"""Faults that a leg without measurement causes by itself."""
ENDING = frozenset({Mode.APPROACH, Mode.TRACKING, Mode.STOPPING})
"""Modes that end when the motion has ended and the legs are at rest."""
STEERED = frozenset({Mode.TRACKING, Mode.STOPPING})
"""Modes in which a live reference moves."""
PROOF_S = 0.1
"""Time for which the legs must stand still without any force before the brakes are proven shut."""
DRIVE_PATIENCE_S = 1.0
"""A drive is faulty if it needs this much longer than it should to reach the commanded state."""


class Facts(NamedTuple):
    """Facts of a tick that decide a mode change."""

    operator: tuple[Operator, ...]
    drive_state: Sequence[int]
    """DriveState of each drive, (6,)."""
    ready: bool
    """All six drives are set up and their turns known. To leave WAITING, also: all legs have reported lately
    and the pose is found. Used in WAITING and IDLE."""
    elapsed: float
    """Time since the present mode was entered, s."""
    finished: bool
    """The present motion (approach, reference, stop) has ended, is not on hold, and the legs are at rest."""
    stop: bool
    """Safety requests a controlled stop."""
    provable: bool
    """All six legs report trusted readings and are at rest, and no brake has failed: a test could prove the
    brakes."""
    stays: bool
    """A parked platform may start again: operator.stays."""

    def all_in(self, *states: DriveState) -> bool:
        """True if each of the six drives reports one of these states."""
        return all(s in states for s in self.drive_state)


class Durations(NamedTuple):
    """Durations of force ramp and brakes at the start and end of a motion, s."""

    load: float
    """Ramp of the holding force, up or down, s; 0: no ramp and no brake test."""
    release: float
    """Time for the brakes to open, s."""
    close: float
    """Time for the brakes to close, s."""

    def least(self, mode: Mode) -> float:
        """Shortest duration of a mode, s; 0 for a mode without a fixed duration."""
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
"""By mode: the next mode without a stop, and its condition on the facts and the shortest duration, s."""
_STOPPED = {
    Mode.WAITING: Mode.PARKED,
    Mode.IDLE: Mode.PARKED,
    Mode.LOADING: Mode.UNLOADING,
    Mode.RELEASING: Mode.PARKING,
    Mode.APPROACH: Mode.STOPPING,
    Mode.TRACKING: Mode.STOPPING,
}
"""Next mode after a stop; the other modes already lead to rest."""
STOPPABLE = frozenset(_STOPPED)
"""Modes that a stop changes."""
_WAITING = frozenset({Mode.LOADING, Mode.RELEASING, Mode.PARKING})
"""Modes that wait for the drives."""
_DRIVES = {
    **dict.fromkeys(MOVING, DriveMode.RUN),
    **dict.fromkeys((Mode.LOADING, Mode.PARKING, Mode.UNLOADING, Mode.HELD), DriveMode.READY),
}
"""Drive mode to command; OFF in the other modes."""


def next_mode(mode: Mode, facts: Facts, durations: Durations) -> Mode:
    """Mode of this tick if no fault is new: `after_fault` handles new ones; only RESET leaves FAULT."""
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
    """True if a mode has waited too long for the drives; elapsed: s since the mode was entered."""
    return mode in _WAITING and elapsed > durations.least(mode) + DRIVE_PATIENCE_S


def after_fault(
    mode: Mode, faults: Fault, under_control: Fault, torque_off: Fault, *, located: bool, heard: bool
) -> Mode:
    """Mode after new faults in a mode, chosen by what is still known of state and measurement.

    under_control: faults after which a stop along the path is safe (ss1); torque_off: faults after which no
    force stays on (sto); located: the pose has been found; heard: False if all drives have been silent for
    DRIVE_PATIENCE_S. The force stays on, or returns, where a brake may not hold, as long as a force is
    possible.
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
    """State that the drives are commanded to enter in a mode of the controller."""
    return _DRIVES.get(mode, DriveMode.OFF)
