"""Rules on what a tick says: numbers, drives, bus, frames, the loop's own time, the recorder.

A full queue and a dead bus look the same; only time tells them apart.
"""

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import helper
from drivers.signals import DriveState, Foreign

HISTORY = 32
"""Ticks that a rule remembers, as bits of one integer."""


@helper
def ones(history: int) -> int:
    """Return how many of the lowest HISTORY bits are 1."""
    count = 0
    for k in range(HISTORY):
        count += (history >> k) & 1
    return count


@helper
def all_finite(x: Array) -> bool:
    """Tell whether no element of x, of any shape, is infinite or not a number."""
    for value in x.flat:  # noqa: SIM110 - compiled
        if not abs(value) < np.inf:
            return False
    return True


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


IN_A_ROW = 5
"""Ticks in a row with a refused frame that make a dead bus."""
DEAD_BUS = 8
"""Ticks with a refused frame among those remembered that make a bus that cannot be relied on."""


@helper
def refusals(history: int, sends_failed: int) -> int:
    """Return the last HISTORY ticks as bits, 1 with a refused frame, newest lowest."""
    return (2 * history + (sends_failed > 0)) % (1 << HISTORY)


@helper
def bus_down(bus_off: bool, history: int) -> bool:
    """Tell whether the bus is off, or has refused frames IN_A_ROW times in a row or DEAD_BUS in all."""
    row = (1 << IN_A_ROW) - 1
    return bus_off or history & row == row or ones(history) >= DEAD_BUS


@helper
def bus_noisy(bus_errors: int, bus_overflow: int, sends_failed: int) -> bool:
    """Tell whether this tick saw error frames, lost receptions or refused frames."""
    return bus_errors > 0 or bus_overflow > 0 or sends_failed > 0


UNRELIABLE = 8
"""Ticks with a refused frame of the drives, among those remembered, that make a bus nobody can rely on."""
_CONTROLLER = int(Foreign.SYNC | Foreign.COMMAND | Foreign.CONFIG)
_ESTOP = int(Foreign.ESTOP)


@helper
def second_controller(foreign: int) -> bool:
    """Tell whether somebody else controls the drives: nobody hears his own frames."""
    return bool(foreign & _CONTROLLER)


@helper
def estop_heard(foreign: int) -> bool:
    """Tell whether another node has sent an emergency stop."""
    return bool(foreign & _ESTOP)


@helper
def unreliable(history: int) -> bool:
    """Tell whether frames of the drives were refused in UNRELIABLE of the ticks remembered."""
    return ones(history) >= UNRELIABLE


HARMFUL_STRETCH_NS = 4_000_000
"""Real drives would have ended a run whose controller or bus was gone for so long."""
STRETCH_FREE_NS = 500_000_000
"""So much may always be harmful stretches, beside the share of the run that is allowed."""
DEGRADED_AT = 8
"""Late ones among them that make a degraded loop."""


@helper
def is_late(lateness_ns: int, period_ns: int) -> bool:
    """Tell whether a tick woke up more than a fifth of a period late."""
    return 5 * lateness_ns > period_ns


@helper
def is_apart(sync_skew_ns: int, limit_ns: int) -> bool:
    """Tell whether the buses had their SYNC so far apart that the tick counts as late."""
    return sync_skew_ns > limit_ns


@helper
def late_history(history: int, late: bool, skipped: int) -> int:
    """Return the last HISTORY ticks as bits, 1 late, newest lowest; a skipped period counts as late."""
    for _ in range(min(skipped, HISTORY)):
        history = 2 * history + 1
    return (2 * history + late) % (1 << HISTORY)


@helper
def is_degraded(history: int) -> bool:
    """Tell whether DEGRADED_AT or more of the remembered ticks were late."""
    return ones(history) >= DEGRADED_AT


@helper
def missed_run(run: int, skipped: int) -> int:
    """Return the periods missed in a row, from their number so far and those skipped before this tick.

    Only a tick with nothing skipped before it ends a run: a loop that runs one tick in three is no better.
    """
    return run + skipped if skipped > 0 else 0


@helper
def too_many_missed(run: int, limit: int) -> bool:
    """Tell whether `limit` periods or more were missed in a row: a controlled stop is asked for."""
    return run >= limit


@helper
def too_stretched(stretched_ns: int, elapsed_ns: int, percent: float) -> bool:
    """Tell whether harmful stretches take more than their share of a virtual bench's run."""
    return stretched_ns > STRETCH_FREE_NS + 0.01 * percent * elapsed_ns


@helper
def recorder_losing(alive: bool, dropped: int, dropped_before: int) -> bool:
    """Tell whether the recorder is dead or has lost ticks since the last look."""
    return not alive or dropped > dropped_before
