"""Checks of the motion: ends of the stroke, speed, tracking error, estimate, and standstill.

A leg without a reading in a tick is not checked in that tick; the check of stale legs covers it.
"""

import math
from math import isnan

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import helper

CREEP = 1e-3
"""Speed towards an end, m/s, that is always allowed: encoder noise beyond a soft end is not motion."""


@helper
def speed_cap(distance: float, deceleration: float) -> float:
    """Fastest approach, m/s, from which `deceleration` (m/s^2) stops within `distance` (m): sqrt(2 a d)."""
    return max(math.sqrt(2.0 * deceleration * max(distance, 0.0)), CREEP)


@helper
def too_fast_for_end(q: Array, dq: Array, soft_min: float, soft_max: float, deceleration: float) -> bool:
    """True if a leg moves towards a soft end faster than `speed_cap` allows. q (6,) m, dq (6,) m/s."""
    for i in range(6):
        if dq[i] > speed_cap(soft_max - q[i], deceleration):
            return True
        if -dq[i] > speed_cap(q[i] - soft_min, deceleration):
            return True
    return False


@helper
def overspeed(dq: Array, limit: float) -> bool:
    """True if a leg rate |dq|, dq (6,) m/s, exceeds the limit, m/s."""
    for rate in dq:  # noqa: SIM110 - compiled
        if abs(rate) > limit:
            return True
    return False


@helper
def lagging(q: Array, q_d: Array, dq_d: Array, at_rest: float, per_speed: float) -> bool:
    """True if |q_d - q| > at_rest + per_speed |dq_d| on a leg.

    q, q_d (6,) m measured and reference lengths, dq_d (6,) m/s reference rates; at_rest m, per_speed s.
    """
    for i in range(6):  # noqa: SIM110 - compiled
        if abs(q_d[i] - q[i]) > at_rest + per_speed * abs(dq_d[i]):
            return True
    return False


HOP = 1.0
"""Measure of a hop above which a pose may belong to another assembly; see `hil.estimation.pose`."""
REST_m_s = 0.02
"""A leg below this measured rate is at rest: brakes do not close on a moving platform."""


@helper
def at_rest(rate: Array, age: Ints, limit: float) -> bool:
    """True if no leg with a reading in this tick reaches `limit`, m/s. rate (6,) m/s, age (6,) ticks."""
    for i in range(6):  # noqa: SIM110 - compiled
        if age[i] == 0 and abs(rate[i]) >= limit:
            return False
    return True


@helper
def moved_legs(length: Array, age: Ints, still: Array, tolerance: float) -> int:
    """Legs farther than `tolerance`, m, from where they stood, bit i: leg i.

    length (6,) m of the readings, age (6,) ticks; still (6,) m is filled at a leg's first reading.
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
