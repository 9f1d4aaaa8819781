"""A rest-to-rest move between two poses."""

from math import hypot

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import MATRIX, REAL, VECTOR, direct
from hil.mathematics.rotations import relative_rotation, rotation_motion
from hil.mathematics.vectors import at, scale
from hil.trajectory.path import SAMPLE, PoseSample, blank, quintic


@direct(REAL, VECTOR, MATRIX, VECTOR, VECTOR, REAL, *SAMPLE)
def evaluate(
    t: float, p0: Array, R0: Array, dp: Array, phi: Array, duration: float,
    p: Array, R: Array, twist: Array, dtwist: Array,
) -> None:  # fmt: skip
    """Fill p, R, twist, dtwist of p = p0 + s dp, R = exp([s phi]) R0, with s the quintic of t/duration.

    At both its ends, and so before and after them, the quintic rests to the bit.
    """
    s, ds, dds = quintic(min(max(t / duration, 0.0), 1.0))
    ds /= duration
    dds /= duration * duration
    along = at(phi, 0)
    turn = np.empty((3, 3))
    omega, domega = rotation_motion(scale(s, along), scale(ds, along), scale(dds, along), turn)
    for i in range(3):
        p[i] = p0[i] + s * dp[i]
        for j in range(3):
            R[i, j] = turn[i, 0] * R0[0, j] + turn[i, 1] * R0[1, j] + turn[i, 2] * R0[2, j]
        twist[i], twist[3 + i] = ds * dp[i], omega[i]
        dtwist[i], dtwist[3 + i] = dds * dp[i], domega[i]


class GeodesicMove:
    """Quintic rest-to-rest move along the straight line and the shortest turn, in `duration_s` > 0.

    p0, p1 (3,) m; R0, R1 (3, 3); base frame.
    """

    def __init__(self, p0: Array, R0: Array, p1: Array, R1: Array, duration_s: float) -> None:
        self.duration_s = float(duration_s)
        self._p0, self._R0 = np.array(p0, float), np.array(R0, float, order="C")
        self._dp = np.array(p1, float) - self._p0
        self._phi = relative_rotation(self._R0, np.array(R1, float, order="C"))

    def travel_m(self, reach_m: float) -> float:
        """Return how far a point at most `reach_m` from the platform's origin moves at most, m."""
        return hypot(*self._dp.tolist()) + reach_m * hypot(*self._phi.tolist())

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s); see `Trajectory`."""
        sample = blank()
        evaluate(t, self._p0, self._R0, self._dp, self._phi, self.duration_s, *sample)
        return sample
