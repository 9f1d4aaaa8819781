"""Rates that are slopes of lengths: how wrong they are where the acceleration varies, or a latch is late.

The slope at the end of the parabola through three lengths, T0 and then T1 s apart, is exact at a constant
acceleration. One that varies within a range a makes it wrong by the integral of Peano's kernel,

    |slope - dq| <= a T1 / (2 (1 + r)),     r = T1 / (T1 + T0):

a third of a period where both steps are one. A latch that is d s later than the clock says makes a slope
wrong by a share of the rate, 3 d / (2 T) for equal steps, the same in all legs, and so the next two.

A length that jumps by J makes its own slope leap by 3 J / (2 T), and the gap between length and slope is
J / 4 alone. So a jump shows as a leap. Later ticks show more of it, but by then the law has answered it with
a force that explains as much. A latch that is late is a jump by its way, and one back: its leaps follow each
other as 1.5, -5, 6, -3 and 0.5 times rate d / T.
"""

from math import isnan

from drivers.arrays import Array
from drivers.compiled.compiler import helper
from hil.safety.latch import explained

REACHES_BACK = 2
"""Periods from a slope to the first length that it is made of."""

TIME_LEAPS = 6.0
"""Of a rate, times the periods by which one latch is late, in the largest of the leaps that this makes."""
SHOWS_AS_LEAP = 1.5
"""Of a length that jumps, over a period, in the leap of its slope."""
SHOWS_AS_GAP = 0.25
"""The same in the gap between length and slope."""


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
def is_time(leg: int, leaps: Array, rates: Array, bounds: Array, latest: float) -> bool:
    """Tell whether a latch that is late explains that the rate of a leg leaps, beside those of the others.

    leaps (6,) m/s, nan: unknown; rates (6,) m/s, before; bounds (6,) m/s of the leaps; latest: periods.
    """
    if isnan(leaps[leg]) or abs(leaps[leg]) > bounds[leg] + TIME_LEAPS * latest * abs(rates[leg]):
        return False
    return explained(leg, leaps, rates, bounds, leaps)
