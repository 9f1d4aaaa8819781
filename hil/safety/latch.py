"""When the encoders were latched: what all legs agree on is time, what one leg says alone is not.

All drives latch at one SYNC. Where that comes later than the clock says, every length is off by its rate
times the same delay. Where too few legs are heard or move to bear witness, what none contradicts may be one.
"""

from math import inf, isnan

from drivers.arrays import Array
from drivers.compiled.compiler import helper

WITNESSES = 3
"""Legs that must show a delay, and agree on it, before it counts as one."""


@helper
def shared_delay(gap: Array, rate: Array, tolerance: Array) -> tuple[float, bool]:
    """Return the delay, s, that explains the gaps best, and whether enough legs bear witness of it.

    It minimises sum |gap_i - rate_i delay|: the minimum is where one leg is explained whole. gap (6,) m,
    rate (6,) m/s, tolerance (6,) m; nan in gap: the leg has no say. Without witnesses it is 0.
    """
    best, least = 0.0, inf
    for i in range(6):
        if rate[i] != 0.0 and not isnan(gap[i]):
            delay = gap[i] / rate[i]
            left = _left(gap, rate, delay)
            if left < least:
                best, least = delay, left
    witnesses = 0
    for i in range(6):
        shown = abs(rate[i] * best) > tolerance[i]
        witnesses += shown and abs(gap[i] - rate[i] * best) <= tolerance[i]
    if witnesses >= WITNESSES:
        return best, True
    return 0.0, False


@helper
def explained(i: int, gap: Array, rate: Array, tolerance: Array, say: Array) -> bool:
    """Tell whether some delay explains the gap of leg i, and that of each leg that has a say, nan: none.

    gap (6,) m, rate (6,) m/s, tolerance (6,) m, say (6,) m: the gaps of those that have one.
    """
    for j in range(6):
        apart = abs(gap[i] * rate[j] - say[j] * rate[i])
        if apart > tolerance[i] * abs(rate[j]) + tolerance[j] * abs(rate[i]):
            return False
    return True


@helper
def _left(gap: Array, rate: Array, delay: float) -> float:
    """Return sum |gap_i - rate_i delay| over the legs that have a say."""
    total = 0.0
    for i in range(6):
        if not isnan(gap[i]):
            total += abs(gap[i] - rate[i] * delay)
    return total
