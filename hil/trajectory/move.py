"""A rest-to-rest move between two poses."""

from math import hypot
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import REAL, record
from drivers.compiled.pointed import Callee, context_of, data_at, pointed
from hil.mathematics.rotations import relative_rotation, rotation_motion
from hil.mathematics.vectors import at, scale
from hil.trajectory.path import SAMPLE, CompiledTrajectory, quintic

MOVE = np.dtype(
    [("p0", "<f8", 3), ("R0", "<f8", (3, 3)), ("dp", "<f8", 3), ("phi", "<f8", 3), ("duration", "<f8")]
)


@pointed(record(MOVE), REAL, record(SAMPLE))
def evaluate(move: Any, t: float, into: Any) -> int:
    """Fill the sample of p = p0 + s dp, R = exp([s phi]) R0, with s the quintic of t/duration.

    Twist and dtwist are exactly zero at both ends, before and after.
    """
    duration, R0 = move.duration, move.R0
    s, ds, dds = quintic(min(max(t / duration, 0.0), 1.0))
    ds /= duration
    dds /= duration * duration
    along = at(move.phi, 0)
    turn = np.empty((3, 3))
    omega, domega = rotation_motion(scale(s, along), scale(ds, along), scale(dds, along), turn)
    for i in range(3):
        dp = move.dp[i]
        into.p[i] = move.p0[i] + s * dp
        for j in range(3):
            into.R[i, j] = turn[i, 0] * R0[0, j] + turn[i, 1] * R0[1, j] + turn[i, 2] * R0[2, j]
        into.twist[i], into.twist[3 + i] = ds * dp, omega[i]
        into.dtwist[i], into.dtwist[3 + i] = dds * dp, domega[i]
    return 0


class GeodesicMove(CompiledTrajectory):
    """Quintic rest-to-rest move along the straight line and the shortest turn, in `duration_s` > 0.

    p0, p1 (3,) m; R0, R1 (3, 3); base frame.
    """

    def __init__(self, p0: Array, R0: Array, p1: Array, R1: Array, duration_s: float) -> None:
        self.duration_s = float(duration_s)
        start = np.array(R0, float, order="C")
        self._dp = np.array(p1, float) - np.array(p0, float)
        self._phi = relative_rotation(start, np.array(R1, float, order="C"))
        move = context_of(MOVE, p0=p0, R0=start, dp=self._dp, phi=self._phi, duration=self.duration_s)
        self.callee = Callee(evaluate.address, data_at(move), move)

    def travel_m(self, reach_m: float) -> float:
        """Largest travel, m, of a point at most `reach_m` from the platform's origin."""
        return hypot(*self._dp.tolist()) + reach_m * hypot(*self._phi.tolist())
