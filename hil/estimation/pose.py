"""Pose from leg lengths: forward kinematics from the last pose, with a check of the assembly mode.

Six lengths belong to up to 40 poses, and Newton's method finds one of them from any start. It is the pose
that the machine can have reached if the iteration started well inside the region of Kantorovich's theorem:
with K a Lipschitz constant of J^-1 dJ and eta the first step, h = K eta <= 1/2 means that there is exactly
one solution within 2 eta and that J is regular on the way to it. In that region each Newton step is at most
h/2 times the one before (Deuflhard, Newton Methods for Nonlinear Problems, 2004, 2.1), so a ratio Theta > 1/4
of two steps proves that h > 1/2. The converse does not hold, as Theta is observed along the iteration only,
hence a factor of two: ``hop`` = 8 max Theta, with steps measured as the largest displacement of a platform
joint. hop >= 1 means that the change of the lengths does not explain the change of the pose. Tracking at 1
kHz gives about 0.01.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from drivers.compiled.compiler import kernel, record
from drivers.tick_columns import TICK, Record, part
from hil.mathematics.linear_algebra import condition_from_lu, lu_factor, lu_solve
from hil.robot.geometry import Platform
from hil.robot.kinematics import MAX_SUBSTEPS, check_rotation, check_vector
from hil.robot.kinematics_kernels import continuation_kernel, lengths_and_jacobian, newton

ESTIMATOR = np.dtype(
    [
        ("base_joints", "<f8", (6, 3)),
        ("platform_joints", "<f8", (6, 3)),
        ("radius", "<f8"),
        ("tolerance", "<f8"),
        ("max_iterations", "<i8"),
        ("p", "<f8", (3,)),
        ("R", "<f8", (3, 3)),
    ]
)
"""The robot, and the last pose: m, base frame."""
TOLERANCE_M = 1e-10
"""Residual, m, that ends Newton's method; the final residual is mostly far smaller."""
MAX_ITERATIONS = 12
"""Largest number of Newton steps."""


class Estimator:
    """Tracks the pose from tick to tick.

    Mutable state: the last pose, ``p`` and ``R``, in its `record`. ``update`` adopts a new one only if
    Newton's method converged and ``hop`` < 1, so a doubtful tick cannot become valid by repetition.

    Parameters
    ----------
    platform : Platform
    p0 : (3,) m, and R0 : (3, 3)
        First pose.

    Raises
    ------
    KinematicsError
        If p0 is not finite, or R0 is not a rotation.
    """

    def __init__(self, platform: Platform, p0: ArrayLike, R0: ArrayLike) -> None:
        own = self.record = np.zeros((), ESTIMATOR)
        own["base_joints"], own["platform_joints"] = platform.base_joints, platform.platform_joints
        own["radius"], own["tolerance"], own["max_iterations"] = platform.radius, TOLERANCE_M, MAX_ITERATIONS
        self.p: Array = own["p"]
        """Position of the last pose, (3,) m, base frame."""
        self.R: Array = own["R"]
        """Rotation of the last pose, (3, 3), platform to base."""
        self.reset(p0, R0)

    def adopt(self, p: Array, R: Array) -> None:
        """Set the last pose, p (3,) m and R (3, 3), base frame, from which the next search starts."""
        self.record["p"], self.record["R"] = p, R

    def reset(self, p0: ArrayLike, R0: ArrayLike) -> None:
        """Set the last pose, p0 (3,) m and R0 (3, 3), base frame. Raises KinematicsError if invalid."""
        self.adopt(check_vector("p0", p0, 3), check_rotation(R0))

    def update(self, tick: Record) -> None:
        """Fill in the estimated pose and twist of a tick from its q, m, and dq, m/s. Never raises.

        See `estimate_pose`, which adopts the pose.
        """
        estimate_pose(self.record, tick)

    def acquire(self, q: Array) -> bool:
        """Move the last pose to the lengths ``q`` (6,) m, far away or after a gap; False if that fails.

        Follows a straight line in the lengths, in steps that each pass the assembly check: see
        ``hil.robot.kinematics.continue_kinematics``. Takes up to some milliseconds: not for the loop.
        """
        own = self.record
        p, R, _, residual = continuation_kernel(
            own["base_joints"],
            own["platform_joints"],
            q,
            self.p,
            self.R,
            float(own["tolerance"]),
            MAX_SUBSTEPS,
        )
        if not residual < np.inf:
            return False
        self.adopt(p, R)
        return True


@kernel(record(ESTIMATOR), record(TICK, *part("estimate")))
def estimate_pose(own: Any, tick: Any) -> float:
    """Fill in a tick's estimate from its q and dq, starting at the last pose; returns the residual, m.

    Never raises. twist = J^-1 dq. If Newton's method fails (`fk_residual` inf), p and R are those of the last
    pose, with J, twist and condition there. `condition` as in ``condition_kernel`` with the platform's
    radius; inf, with twist nan, if J is singular. `hop` >= 1: the pose may belong to another assembly mode
    than the last one. Without these two failures the pose becomes the last one.
    """
    a, b = own.base_joints, own.platform_joints
    p, R, J = tick.p, tick.R, tick.J
    p[:] = own.p
    R[:] = own.R
    order = np.empty(6, np.int64)
    work = np.empty((25, 6))
    LU = work[0:6]
    iterations, residual, hop = newton(a, b, tick.q, p, R, own.tolerance, own.max_iterations, J, order, work)
    if residual == np.inf:
        p[:] = own.p
        R[:] = own.R
        lengths_and_jacobian(a, b, p, R, work[6], J)
    tick.condition = np.inf
    if lu_factor(J, LU, order):
        lu_solve(LU, order, tick.dq, tick.twist)
        tick.condition = condition_from_lu(J, own.radius, LU, order, work[6:25])
    else:
        tick.twist[:] = np.nan
    tick.fk_iterations = iterations
    tick.fk_residual = residual
    tick.hop = hop
    if residual < np.inf and hop < 1.0:
        own.p[:] = p
        own.R[:] = R
    return float(residual)
