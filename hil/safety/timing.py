"""Rules on the loop's own time: late ticks, many late ticks, missed ticks.

Integer arithmetic on what the tick says about itself.
"""

from drivers.compiled.compiler import helper
from hil.safety.history import HISTORY, ones

DEGRADED_AT = 8
"""Late ones among them that make a degraded loop."""


@helper
def is_late(lateness_ns: int, period_ns: int) -> bool:
    """Tell whether a tick woke up more than a fifth of a period late."""
    return 5 * lateness_ns > period_ns


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
