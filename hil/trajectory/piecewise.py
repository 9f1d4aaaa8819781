"""Piecewise polynomial paths: way-points and splines are both one of these.

Rule of the room: see `hil.trajectory`.
"""

from __future__ import annotations

import numpy as np

from hil.compile_cache import INTEGER, MATRIX, REAL, VECTOR, kernel
from hil.trajectory.path import Array, Kernel, PoseSample, lift

DEGREE = 5
TENSOR = MATRIX.copy(ndim=3)


@kernel(REAL, VECTOR, TENSOR, INTEGER)
def evaluate(t: float, knots: Array, coefficients: Array, periods: int) -> Kernel:
    """Return p, R, twist, dtwist at t (s) of chi(u) = sum_k c[segment, k] u^k, u in [0, 1] on each segment.

    knots (n + 1,) s from 0; coefficients (n, 6, 6) by segment, power, word; `periods` passes, 0 is for ever.
    At a knot the segment that begins there counts, except at the very end.
    """
    period = knots[-1]
    moving = t >= 0.0 and (periods == 0 or t <= periods * period)
    local = max(t, 0.0)
    pass_number = np.floor(local / period)
    if periods > 0 and pass_number >= periods:
        local = period
    else:
        local -= pass_number * period
    low, high = 0, knots.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] <= local:
            low = middle
        else:
            high = middle
    h = knots[low + 1] - knots[low]
    u = (local - knots[low]) / h
    chi, dchi, ddchi = np.zeros(6), np.zeros(6), np.zeros(6)
    for word in range(6):
        value = rate = curvature = 0.0
        for k in range(DEGREE, -1, -1):
            curvature = curvature * u + 2.0 * rate
            rate = rate * u + value
            value = value * u + coefficients[low, k, word]
        chi[word] = value
        if moving:
            dchi[word] = rate / h
            ddchi[word] = curvature / (h * h)
    return lift(chi, dchi, ddchi)


class PiecewisePolynomial:
    """chi(t) polynomial between knots, run through `periods` times (None: for ever).

    knots (n + 1,) s, increasing from 0; coefficients (n, 6, 6) [segment, power, word] in the segment's
    normalised time u = (t - knot)/(next knot - knot). Both are copied.
    """

    def __init__(self, knots: Array, coefficients: Array, periods: int | None = 1) -> None:
        self._knots = np.array(knots, float)
        self._coefficients = np.array(coefficients, float)
        self._periods = 0 if periods is None else periods
        self.duration_s = None if periods is None else periods * float(self._knots[-1])
        self.sample(0.0)

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s); see `Trajectory`."""
        return PoseSample(*evaluate(t, self._knots, self._coefficients, self._periods))
