"""Paths that are polynomials of time between knots, for way-points and splines."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import REAL, record
from drivers.compiled.pointed import Callee, context_of, data_at, pointed, reals_at
from hil.trajectory.path import SAMPLE, CompiledTrajectory, lift

DEGREE = 5
PIECES = np.dtype([("knots", "<i8"), ("coefficients", "<i8"), ("segments", "<i8"), ("periods", "<i8")])
"""Layout of the path: addresses of knots (n + 1,) s and coefficients (n, 6, 6); n; passes, 0: endless."""


@pointed(record(PIECES), REAL, record(SAMPLE))
def evaluate(path: Any, t: float, into: Any) -> int:
    """Fill the sample at t (s) of chi(u) = sum_k c[segment, k] u^k, u in [0, 1] on each segment.

    knots in s from 0; coefficients [segment, power, axis]. A knot belongs to the segment that begins there,
    the last knot to the last segment.
    """
    segments, periods = path.segments, path.periods
    knots = reals_at(path.knots, segments + 1)
    coefficients = reals_at(path.coefficients, segments * 36).reshape((segments, 6, 6))
    period = knots[segments]
    moving = t >= 0.0 and (periods == 0 or t <= periods * period)
    local = max(t, 0.0)
    pass_number = np.floor(local / period)
    if periods > 0 and pass_number >= periods:
        local = period
    else:
        local -= pass_number * period
    low, high = 0, segments
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
    for axis in range(6):
        value = rate = curvature = 0.0
        for k in range(DEGREE, -1, -1):
            curvature = curvature * u + 2.0 * rate
            rate = rate * u + value
            value = value * u + coefficients[low, k, axis]
        chi[axis] = value
        if moving:
            dchi[axis] = rate / h
            ddchi[axis] = curvature / (h * h)
    lift(chi, dchi, ddchi, into)
    return 0


class PiecewisePolynomial(CompiledTrajectory):
    """chi(t) polynomial between knots, repeated `periods` times (None: endless).

    knots (n + 1,) s, increasing from 0; coefficients (n, 6, 6) [segment, power, axis] in the segment's
    normalised time u = (t - knot)/(next knot - knot). Both are copied.
    """

    def __init__(self, knots: Array, coefficients: Array, periods: int | None = 1) -> None:
        self._knots = np.array(knots, float, order="C")
        pieces = np.array(coefficients, float, order="C")
        self.period_s = float(self._knots[-1])
        self.duration_s = None if periods is None else periods * self.period_s
        path = context_of(
            PIECES, knots=self._knots, coefficients=pieces, segments=len(pieces), periods=periods or 0
        )
        self.callee = Callee(evaluate.address, data_at(path), (path, self._knots, pieces))

    @property
    def knots(self) -> Array:
        """Times (n + 1,) s of the knots between the polynomials, at which the acceleration may jump."""
        return self._knots.copy()
