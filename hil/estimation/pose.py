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

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from hil.robot.geometry import Platform
from hil.robot.kinematics import MAX_SUBSTEPS, check_rotation, check_vector
from hil.robot.kinematics_kernels import continuation_kernel, estimate_kernel


class Estimate(NamedTuple):
    """One tick's pose and rate."""

    p: Array
    """(3,) m, platform origin in the base frame."""
    R: Array
    """(3, 3), x_base = p + R x_platform."""
    twist: Array
    """(6,) m/s, rad/s: [v of the platform origin; omega], base frame; nan where J is singular."""
    J: Array
    """(6, 6) at p, R: dq = J twist."""
    iterations: int
    """Newton steps."""
    residual: float
    """m, largest leg residual; inf where Newton's method failed: p, R and J are then the last pose's."""
    condition: float
    """Bound on the condition number of J diag(1, 1, 1, 1/r, 1/r, 1/r):
    ``hil.mathematics.linear_algebra.condition_kernel``."""
    hop: float
    """>= 1: the pose may belong to another assembly than the last one."""


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

    def update(self, q: Array, dq: Array) -> Estimate:
        """Return the pose with the lengths ``q`` (6,) m and its twist J^-1 dq, ``dq`` (6,) m/s. Never raises.

        Both arrays contiguous float64. Adopts the pose unless residual is inf or hop >= 1.
        """
        p, R, twist, J = np.empty(3), np.empty((3, 3)), np.empty(6), np.empty((6, 6))
        iterations, residual, condition, hop = estimate_kernel(
            self._a,
            self._b,
            self._radius,
            q,
            dq,
            self.p,
            self.R,
            self._tolerance,
            self._max_iterations,
            p,
            R,
            twist,
            J,
        )
        if residual < np.inf and hop < 1.0:
            self.p = p
            self.R = R
        return Estimate(p, R, twist, J, iterations, residual, condition, hop)

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
