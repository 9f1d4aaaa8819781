"""What the six drives say of themselves in a tick."""

from collections.abc import Iterable

from drivers.signals import DriveFault, DriveState, Mode
from drivers.tick_columns import Record
from hil.safety.motion import REST_m_s

_POWERED = (DriveState.READY, DriveState.RUN)


def any_powered(tick: Record) -> bool:
    """Tell whether a drive is powered."""
    return any(state in _POWERED for state in tick["drive_state"].tolist())


def unconfirmed(tick: Record, latches: bool) -> tuple[int, ...]:
    """Return the legs whose drive is not in FAULT or does not report the emergency stop as its reason.

    A fault code of the drives' own is taken for it: what it means only their maker knows. Of drives that do
    not latch a stop, those that are still powered.
    """
    if not latches:
        return tuple(leg for leg, state in enumerate(tick["drive_state"].tolist()) if state == DriveState.RUN)
    faults, states = tick["drive_fault"].tolist(), tick["drive_state"].tolist()
    return tuple(
        leg
        for leg, (fault, state) in enumerate(zip(faults, states, strict=True))
        if state != DriveState.FAULT or not (fault == DriveFault.ESTOP or fault >= len(DriveFault))
    )


def confirmed(tick: Record, latches: bool) -> bool:
    """Tell whether all drives are in FAULT and report the emergency stop as their reason; or are off."""
    return not unconfirmed(tick, latches)


def ready(tick: Record, mode: Mode, set_up: Iterable[bool], *, located: bool) -> bool:
    """Tell whether the drives are as an arming needs them: heard and the pose found, and all six set up.

    Once they were, in IDLE, they stay so until one is to be set up again; one that was altered is a fault.
    """
    if mode is Mode.IDLE:
        return all(set_up) or bool(tick["altered"])
    return located and max(tick["age"].tolist()) <= 1 and all(set_up)


def measured_at_rest(tick: Record) -> bool:
    """Tell whether all six legs are heard in this tick, believed and at rest."""
    measured = max(tick["age"].tolist()) == 0 and not tick["legs_slipped"]
    return bool(measured and max(abs(tick["rate"]).tolist()) < REST_m_s)
