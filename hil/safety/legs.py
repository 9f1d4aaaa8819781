"""Rules on what the drives say: how long ago, and in which state."""

from drivers.arrays import Ints
from drivers.compiled.compiler import helper
from drivers.signals import DriveState

_BOOT, _RUN, _FAULT = int(DriveState.BOOT), int(DriveState.RUN), int(DriveState.FAULT)


@helper
def stale(age: Ints, limit: int) -> bool:
    """Tell whether some leg's last fresh feedback is `limit` ticks old or older. age (6,) ticks."""
    for ticks in age:  # noqa: SIM110 - compiled
        if ticks >= limit:
            return True
    return False


@helper
def drive_lost(state: Ints) -> bool:
    """Tell whether some drive reports FAULT, or BOOT: it restarted under load. state (6,) DriveState."""
    for said in state:  # noqa: SIM110 - compiled
        if said in (_FAULT, _BOOT):
            return True
    return False


@helper
def all_running(state: Ints) -> bool:
    """Tell whether all drives report RUN. state (6,) DriveState."""
    for said in state:  # noqa: SIM110 - compiled
        if said != _RUN:
            return False
    return True
