"""Rules on leg length and speed: hard ends, braking distance before the soft ends, top speed."""

import math

from drivers.arrays import Array
from drivers.compiled.compiler import helper

CREEP = 1e-3
"""m/s towards an end that is always allowed: encoder noise at rest beyond a soft end is no motion."""


@helper
def speed_cap(distance: float, deceleration: float) -> float:
    """Fastest approach, m/s, from which `deceleration` (m/s^2) stops within `distance` (m): sqrt(2 a d)."""
    return max(math.sqrt(2.0 * deceleration * max(distance, 0.0)), CREEP)


@helper
def beyond_hard_end(q: Array, length_min: float, length_max: float) -> bool:
    """Tell whether some leg length q (6,) m is outside the hard ends."""
    for length in q:  # noqa: SIM110 - compiled
        if length < length_min or length > length_max:
            return True
    return False


@helper
def too_fast_for_end(q: Array, dq: Array, soft_min: float, soft_max: float, deceleration: float) -> bool:
    """Tell whether some leg moves towards a soft end faster than its speed cap. q (6,) m, dq (6,) m/s."""
    for i in range(6):
        if dq[i] > speed_cap(soft_max - q[i], deceleration):
            return True
        if -dq[i] > speed_cap(q[i] - soft_min, deceleration):
            return True
    return False


@helper
def overspeed(dq: Array, limit: float) -> bool:
    """Tell whether some leg rate dq (6,) m/s is above the limit in size."""
    for rate in dq:  # noqa: SIM110 - compiled
        if abs(rate) > limit:
            return True
    return False
