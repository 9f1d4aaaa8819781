"""Rule on legs that have to stand still: on closed brakes, and after a fault once they have come to rest.

A leg that is not heard in a tick is not judged in it; that it is heard is for the rule on stale legs.
"""

from math import isnan, nan

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import helper

REST_m_s = 0.02
"""A measured leg that is not faster is at rest: brakes do not close on a moving platform."""


@helper
def at_rest(rate: Array, age: Ints, limit: float) -> bool:
    """Tell whether no leg heard in this tick is as fast as `limit` (m/s). rate (6,) m/s, age (6,) ticks."""
    for i in range(6):  # noqa: SIM110 - compiled
        if age[i] == 0 and abs(rate[i]) >= limit:
            return False
    return True


@helper
def forget_place(still: Array) -> None:
    """Let every leg stand where it is heard next."""
    still[:] = nan


@helper
def moved_legs(length: Array, age: Ints, still: Array, tolerance: float) -> int:
    """Return the legs farther than `tolerance` (m) from where they stood, bit i: leg i.

    length (6,) m as heard, age (6,) ticks; still (6,) m is filled for legs that are heard for the first time.
    """
    legs = 0
    for i in range(6):
        if age[i] != 0:
            continue
        if isnan(still[i]):
            still[i] = length[i]
        elif abs(length[i] - still[i]) > tolerance:
            legs |= 1 << i
    return legs
