"""Piecewise polynomial paths: way-points and splines are both one of these."""

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, REAL, VECTOR, direct
from hil.trajectory.path import SAMPLE, PoseSample, blank, lift

DEGREE = 5
TENSOR = MATRIX.copy(ndim=3)


@direct(REAL, VECTOR, TENSOR, INTEGER, *SAMPLE)
def evaluate(
    t: float, knots: Array, coefficients: Array, periods: int, p: Array, R: Array, twist: Array, dtwist: Array
) -> None:
    """Fill p, R, twist, dtwist at t (s) of chi(u) = sum_k c[segment, k] u^k, u in [0, 1] on each segment.

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
    motion = np.zeros((3, 6))
    chi, dchi, ddchi = motion[0], motion[1], motion[2]
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
    lift(chi, dchi, ddchi, p, R, twist, dtwist)


class PiecewisePolynomial:
    """chi(t) polynomial between knots, run through `periods` times (None: for ever).

    knots (n + 1,) s, increasing from 0; coefficients (n, 6, 6) [segment, power, word] in the segment's
    normalised time u = (t - knot)/(next knot - knot). Both are copied.
    """

    def __init__(self, knots: Array, coefficients: Array, periods: int | None = 1) -> None:
        self._knots = np.array(knots, float, order="C")
        self._coefficients = np.array(coefficients, float, order="C")
        self._periods = 0 if periods is None else periods
        self.period_s = float(self._knots[-1])
        self.duration_s = None if periods is None else periods * self.period_s

    @property
    def knots(self) -> Array:
        """(n + 1,) s, between which the path is a polynomial: its acceleration may jump there."""
        return self._knots.copy()

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s); see `Trajectory`."""
        sample = blank()
        evaluate(t, self._knots, self._coefficients, self._periods, *sample)
        return sample
