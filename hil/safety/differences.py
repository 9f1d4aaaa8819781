"""Rates that are slopes of lengths: how wrong they are where the acceleration varies, or a latch is late.

The slope at the end of the parabola through three lengths, T0 and then T1 s apart, is exact at a constant
acceleration. One that varies within a range a makes it wrong by the integral of Peano's kernel,

    |slope - dq| <= a T1 / (2 (1 + r)),     r = T1 / (T1 + T0):

a third of a period where both steps are one. A latch that is d s later than the clock says makes a slope
wrong by a share of the rate, 3 d / (2 T) for equal steps, the same in all legs, and so the next two.
"""

from math import isnan

from drivers.arrays import Array
from drivers.compiled.compiler import helper
from hil.safety.latch import explained

REACHES_BACK = 2
"""Periods from a slope to the first length that it is made of."""


@helper
def lag_of(T: float, T_was: float) -> float:
    """Return by how much, s, times the range of the acceleration a slope may be wrong.

    T s: its last step; T_was s: the one before, 0: unknown, then the longest that any leaves.
    """
    return 0.5 * T * (T + T_was) / (2.0 * T + T_was) if T_was > 0.0 else 0.5 * T


@helper
def lag_of_leap(lag: float, lag_was: float, T: float, T_was: float) -> float:
    """Return the same for how far a slope leaps: it is made of three, the first one taken like the second."""
    return lag + lag_was * (1.0 + 2.0 * T / T_was)


@helper
def is_time(leg: int, leaps: Array, rates: Array, bounds: Array) -> bool:
    """Tell whether a latch that is late explains that the rate of a leg leaps, beside those of the others.

    leaps (6,) m/s, nan: unknown; rates (6,) m/s; bounds (6,) m/s of the leaps.
    """
    if isnan(leaps[leg]):
        return False
    return explained(leg, leaps, rates, bounds, leaps)
