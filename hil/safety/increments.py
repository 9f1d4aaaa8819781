"""Rule on a leg's length against its rate: an encoder that jumps, and one that slips or whose rate is dead.

A length may change by what the rates say, and the rest is bounded. With T between two latches and an
acceleration that varies within a range a over it,

    |q1 - q0 - T (dq0 + dq1) / 2| <= a T^2 / 8 + 2 noise of a length + T noise of a rate.

A brake that closes on a leg that still creeps takes no more than REST T / 2 beside that. What stops a moving
leg within a tick makes its rate leap, and a gap of up to half of that times T.
"""

import math

from drivers.compiled.compiler import helper
from hil.safety.motion import REST_m_s

WINDOW_S = 0.05
"""Time constant of the sum in which a slow slip shows."""
LONG = 1.5
"""So many periods make a tick a long one."""
SLOW = 4.0
"""So many of a tick's bounds of the acceleration may add up in that sum: their parts of one sign cancel."""


@helper
def gap_of(length: float, rate: float, length_was: float, rate_was: float, T: float) -> float:
    """Return the change of a length, m, less what its rates make of T s: trapezoidal rule."""
    return length - length_was - 0.5 * T * (rate + rate_was)


@helper
def beside(gap: float, leap: float, T: float) -> float:
    """Return what is left of a gap, m, beside what a rate that leaps (m/s) makes of T s, whenever it does."""
    return math.copysign(max(abs(gap) - 0.5 * T * abs(leap), 0.0), gap)


@helper
def gap_bound(noise: float, rate_noise: float, acceleration: float, T: float) -> float:
    """Return the largest gap, m, of an encoder that works.

    noise m and rate_noise m/s of one reading; acceleration m/s^2: the range over which it may vary in T s.
    """
    return 2.0 * noise + T * rate_noise + 0.125 * acceleration * T * T + 0.5 * REST_m_s * T


@helper
def remembered(T: float) -> float:
    """Return the share of a sum that is left after T s."""
    return max(1.0 - T / WINDOW_S, 0.0)


@helper
def slip_bound(
    noise: float, rate_noise: float, acceleration: float, T: float, share: float, travel: float
) -> float:
    """Return the largest sum of gaps, m, of an encoder that works.

    As `gap_bound`; share: of a rate that is wrong; travel: sum of |rate| T, remembered as the gaps are, m.
    """
    window = max(WINDOW_S, T)
    bound = gap_bound(noise, rate_noise, SLOW * acceleration, T)
    return bound + (window - T) * rate_noise + share * travel


@helper
def excused(left: float, total: float, calm: float, T: float, period: float) -> float:
    """Return what of a sum of gaps, m, is not held against the encoder from the next tick on.

    A stall makes a tick of T s long, and what its length explains stays in the sum: `total`, m, as far as
    that is beyond `calm`, the bound of a tick of no length, for the next one may be short. left: of what was
    excused before, m. Calm stalls excuse nothing.
    """
    return max(left, abs(total) - calm) if LONG * period < T else left
