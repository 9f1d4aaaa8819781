"""What a jog follows: one axis, or one leg, at a constant rate from where the platform rests.

Path time is in seconds at set-up speed; `hil.trajectory.override` starts, slows and stops it. Negative time
does not come.
"""

from math import hypot, inf
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import MATRIX, REAL, VECTOR, kernel, record
from drivers.compiled.pointed import Callee, data_at, pointed
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.rotations import rotation_motion
from hil.mathematics.vectors import at, row, scale
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import (
    continuation_kernel,
    jacobian_rate_twist,
    leg_lengths_kernel,
    lengths_and_jacobian,
)
from hil.trajectory.path import SAMPLE, CompiledTrajectory, PoseSample, context_of

AXIS = np.dtype([("p0", "<f8", 3), ("R0", "<f8", (3, 3)), ("rate", "<f8", 6)])
TOLERANCE_M = 1e-12
"""By how much the lengths of a leg's jog may be off."""
SUBSTEPS = 40
"""Most steps from one pose to the next: a tick takes one, the way to rest a few."""


@pointed(record(AXIS), REAL, record(SAMPLE))
def evaluate(jog: Any, t: float, into: Any) -> int:
    """Fill the sample of p = p0 + t v, R = exp([t w]) R0 with the constant twist [v; w] = rate."""
    still = (0.0, 0.0, 0.0)
    w, R0 = at(jog.rate, 3), jog.R0
    turn = np.empty((3, 3))
    rotation_motion(scale(t, w), w, still, turn)
    for i in range(3):
        into.p[i] = jog.p0[i] + t * jog.rate[i]
        for j in range(3):
            into.R[i, j] = turn[i, 0] * R0[0, j] + turn[i, 1] * R0[1, j] + turn[i, 2] * R0[2, j]
    for i in range(6):
        into.twist[i], into.dtwist[i] = jog.rate[i], 0.0
    return 0


@kernel(MATRIX, MATRIX, VECTOR, MATRIX, VECTOR)
def pose_rates(a: Array, b: Array, p: Array, R: Array, dq: Array) -> tuple[Array, Array]:
    """Return twist = J^-1 dq and dtwist = -J^-1 (dJ/dt) twist for constant rates dq (6,) of the legs, m/s.

    Both nan where J is singular.
    """
    J, LU = np.empty((6, 6)), np.empty((6, 6))
    l, twist, dtwist, right = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    order = np.empty(6, np.int64)
    lengths_and_jacobian(a, b, p, R, l, J)
    if not lu_factor(J, LU, order):
        twist[:] = np.nan
        dtwist[:] = np.nan
        return twist, dtwist
    lu_solve(LU, order, dq, twist)
    v, w = at(twist, 0), at(twist, 3)
    for i in range(6):
        right[i] = -jacobian_rate_twist(row(a, i), row(b, i), at(p, 0), R, v, w)
    lu_solve(LU, order, right, dtwist)
    return twist, dtwist


class AxisJog(CompiledTrajectory):
    """Along x, y or z of the base frame, or about one of these through the platform's origin.

    here: a pose at rest. rate (6,) m/s, rad/s: the constant twist.
    """

    duration_s = None

    def __init__(self, here: PoseSample, rate: Array) -> None:
        jog = context_of(AXIS, p0=here.p, R0=here.R, rate=rate)
        self.callee = Callee(evaluate.address, data_at(jog), jog)

    ahead = CompiledTrajectory.sample


class LegJog:
    """One leg longer or shorter, the other five as long as they are.

    The pose is that of the lengths at each time, so that none of them drifts. here: a pose at rest. rate (6,)
    m/s: of the lengths, one not zero. Mutable state: the last sample with its time, from which the next pose
    is looked for.
    """

    duration_s = None

    def __init__(self, platform: Platform, here: PoseSample, rate: Array) -> None:
        self._joints = (platform.base_joints, platform.platform_joints)
        self._rate = rate
        p, R = here.p.copy(), np.array(here.R, order="C")
        self._q = leg_lengths_kernel(*self._joints, p, R)
        self._t, self._last = 0.0, PoseSample(p, R, *pose_rates(*self._joints, p, R, rate))

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s) >= 0, and go on from there; where there is none, the last one."""
        found = self.ahead(t)
        if found is not None:
            self._t, self._last = t, found
        return self._last

    def ahead(self, t: float) -> PoseSample | None:
        """Return the sample at t (s) >= 0; None where no pose of these lengths leads on from here."""
        if t == self._t:
            return self._last
        p, R, _, residual = continuation_kernel(
            *self._joints, self._q + t * self._rate, self._last.p, self._last.R, TOLERANCE_M, SUBSTEPS
        )
        if not residual < np.inf:
            return None
        twist, dtwist = pose_rates(*self._joints, p, R, self._rate)
        return PoseSample(p, R, twist, dtwist) if np.isfinite(twist).all() else None


JogPath = AxisJog | LegJog


def jog_path(
    platform: Platform, here: PoseSample, axis: int, speeds: tuple[float, float], way: float
) -> JogPath:
    """Return what a jog follows from a pose at rest.

    axis: index in JOG_NAMES; speeds: of set-up, m/s and rad/s; way: its sign is the direction.
    """
    rate = np.zeros(6)
    if axis < 6:
        rate[axis] = np.copysign(speeds[axis >= 3], way)
        return AxisJog(here, rate)
    rate[axis - 6] = np.copysign(speeds[0], way)
    return LegJog(platform, here, rate)


def setup_share(sample: PoseSample, speeds: tuple[float, float]) -> float:
    """Return at which share of a sample's speed the platform is no faster than at set-up, m/s and rad/s."""
    vx, vy, vz, wx, wy, wz = sample.twist.tolist()
    v, w = hypot(vx, vy, vz), hypot(wx, wy, wz)
    return min(1.0, speeds[0] / v if v else inf, speeds[1] / w if w else inf)
