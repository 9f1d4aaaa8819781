"""Rules on the loop's own time: late ticks, many late ticks, missed ticks.

Integer arithmetic on what the tick says about itself.
"""

from drivers.compiled.compiler import helper
from hil.safety.history import HISTORY, ones

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
