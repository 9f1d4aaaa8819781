"""Where the platform is: forward kinematics seeded with the last pose, and a watch on its assembly.

Six lengths belong to up to 40 poses, and Newton's method finds one of them wherever it starts. It is the
one that the machine can have reached if the iteration started well inside the region of Kantorovich's
theorem: with K a Lipschitz constant of J^-1 dJ and eta the first step, h = K eta <= 1/2 means that there
is exactly one solution within 2 eta and that J is regular on the way to it. In that region each Newton
step is at most h/2 times the one before (Deuflhard, Newton Methods for Nonlinear Problems, 2004, 2.1), so
a ratio Theta > 1/4 of two steps proves that h > 1/2. The converse does not hold, Theta being seen along
the iteration only, hence a factor of two: ``hop`` = 8 max Theta, steps measured as the largest
displacement of a platform joint. hop >= 1 means that the change of the lengths does not explain the
change of the pose. Tracking at 1 kHz gives about 0.01.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, REAL, VECTOR, direct, record
from drivers.tick_columns import TICK, Record, part
from hil.mathematics.linear_algebra import condition_from_lu, lu_factor, lu_solve
from hil.robot.geometry import Platform
from hil.robot.kinematics import MAX_SUBSTEPS, check_rotation, check_vector
from hil.robot.kinematics_kernels import continuation_kernel, lengths_and_jacobian, newton


class Estimator:
    """Tracks the pose from tick to tick.

    Mutable state: the last pose, ``p`` and ``R``. ``update`` adopts a new one only if Newton's method
    converged and ``hop`` < 1, so that a doubtful tick cannot become the truth by being repeated.

    Parameters
    ----------
    platform : Platform
    p0 : (3,) m, and R0 : (3, 3)
        First pose.
    tolerance : m, largest residual that ends Newton's method; the last one is mostly far smaller.
    max_iterations : Newton steps before giving up.

    Raises
    ------
    KinematicsError
        Where p0 is not finite or R0 no rotation.
    """

    def __init__(
        self,
        platform: Platform,
        p0: ArrayLike,
        R0: ArrayLike,
        *,
        tolerance: float = 1e-10,
        max_iterations: int = 12,
    ) -> None:
        self._a = platform.base_joints
        self._b = platform.platform_joints
        self._radius = platform.radius
        self._tolerance = tolerance
        self._max_iterations = max_iterations
        self.reset(p0, R0)

    def reset(self, p0: ArrayLike, R0: ArrayLike) -> None:
        """Set the last pose."""
        self.p = check_vector("p0", p0, 3).copy()
        self.R = check_rotation(R0).copy()

    def update(self, tick: Record) -> None:
        """Fill the estimate of a tick from its lengths q and rates dq. Never raises.

        `fk_residual` is inf where Newton's method failed: p, R and J are then the last pose's. `hop` >= 1:
        the
        pose may belong to another assembly than the last one. Adopts the pose unless one of the two holds.
        """
        residual, hop = estimate_kernel(
            self._a, self._b, self._radius, self.p, self.R, self._tolerance, self._max_iterations, tick
        )
        if residual < np.inf and hop < 1.0:
            self.p = tick["p"]
            self.R = tick["R"]

    def acquire(self, q: Array) -> bool:
        """Move the last pose to the lengths ``q`` (6,) m, far away or after a gap; False if it cannot.

        Follows a straight line in the lengths, in steps that each pass the watch: see
        ``hil.robot.kinematics.continue_kinematics``. Takes up to some milliseconds: not for the loop.
        """
        p, R, _, residual = continuation_kernel(
            self._a, self._b, q, self.p, self.R, self._tolerance, MAX_SUBSTEPS
        )
        if not residual < np.inf:
            return False
        self.p = p
        self.R = R
        return True


@direct(MATRIX, MATRIX, REAL, VECTOR, MATRIX, REAL, INTEGER, record(TICK, *part("estimate")))
def estimate_kernel(
    a: Array, b: Array, radius: float, p0: Array, R0: Array, tolerance: float, max_iterations: int, tick: Any
) -> tuple[float, float]:
    """Fill the estimate from its q and dq, started at p0, R0; return residual and hop. Never raises.

    twist = J^-1 dq. Where Newton's method fails (residual inf), p and R are p0 and R0, and J, twist,
    condition
    belong there. `condition` as in ``condition_kernel`` with r = ``radius``; inf and twist nan where J is
    singular.
    """
    p, R, J = tick.p, tick.R, tick.J
    p[:] = p0
    R[:] = R0
    order = np.empty(6, np.int64)
    work = np.empty((25, 6))
    LU = work[0:6]
    iterations, residual, hop = newton(a, b, tick.q, p, R, tolerance, max_iterations, J, order, work)
    if residual == np.inf:
        p[:] = p0
        R[:] = R0
        lengths_and_jacobian(a, b, p, R, work[6], J)
    tick.condition = np.inf
    if lu_factor(J, LU, order):
        lu_solve(LU, order, tick.dq, tick.twist)
        tick.condition = condition_from_lu(J, radius, LU, order, work[6:25])
    else:
        tick.twist[:] = np.nan
    tick.fk_iterations = iterations
    tick.fk_residual = residual
    tick.hop = hop
    return residual, hop
