"""Leg lengths from a pose, leg rates through the Jacobian, and the pose from six leg lengths.

Checked versions of ``hil.robot.kinematics_kernels``; the control loop calls the kernels. Arguments, in the
base frame: p (3,) m, platform origin; R (3, 3), x_base = p + R x_platform; twist (6,) m/s and rad/s, [v of
the platform origin; omega]; q (6,) m, leg lengths. All functions raise KinematicsError for an argument that
is not finite or an R that is not a rotation.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from drivers.errors import ModelError
from hil.mathematics.linear_algebra import condition_kernel
from hil.robot import kinematics_kernels as kernels
from hil.robot.geometry import Platform

ROTATION_TOLERANCE = 1e-8
"""Largest entry of R^T R - 1 that counts as rounding."""
SINGULAR = 1e12
"""Condition number of J above which a pose counts as singular."""


class KinematicsError(ModelError):
    """Invalid pose or leg lengths, or a pose that is singular or cannot be found.

    Attributes
    ----------
    values : dict
        The quantities in the message (``p``, ``R``, ``q``, ``residual``, ``condition`` ...).
    """

    def __init__(self, message: str, **values: object) -> None:
        super().__init__(message)
        self.values = values


class Pose(NamedTuple):
    """Pose that forward kinematics has found, with the number of iterations and the residual."""

    p: Array
    """(3,) m, platform origin in the base frame."""
    R: Array
    """(3, 3), x_base = p + R x_platform."""
    iterations: int
    """Newton steps taken."""
    residual: float
    """m, largest difference between a given leg length and the leg length at the pose."""


def _shaped(name: str, value: ArrayLike, shape: tuple[int, ...], allowed: str) -> Array:
    try:
        x = np.ascontiguousarray(value, np.float64)
    except (TypeError, ValueError):
        raise KinematicsError(f"{name}: got {value!r}, allowed {allowed}", **{name: value}) from None
    if x.shape != shape:
        raise KinematicsError(f"{name}: got shape {x.shape}, allowed is {shape}", **{name: x})
    return x


def check_vector(name: str, value: ArrayLike, size: int) -> Array:
    """``value`` as a contiguous float64 vector; KinematicsError for a wrong size or a non-finite number."""
    x = _shaped(name, value, (size,), f"are {size} numbers")
    if not np.isfinite(x).all():
        raise KinematicsError(f"{name}: got {x.tolist()}, allowed are finite numbers", **{name: x})
    return x


def check_rotation(R: ArrayLike) -> Array:
    """``R`` as a contiguous float64 array (3, 3); KinematicsError if it is not a rotation matrix."""
    x = _shaped("R", R, (3, 3), "is a 3x3 rotation matrix")
    error = float(np.abs(x.T @ x - np.eye(3)).max())
    determinant = float(np.dot(x[0], np.cross(x[1], x[2])))
    if not error <= ROTATION_TOLERANCE or determinant < 0:
        raise KinematicsError(
            f"R is not a rotation: largest entry of R^T R - 1 is {error:.3g} "
            f"(allowed {ROTATION_TOLERANCE:.0e}), determinant {determinant:.6g} (allowed 1). "
            f"R = {x.tolist()}",
            R=x,
            error=error,
            determinant=determinant,
        )
    return x


def leg_lengths(platform: Platform, p: ArrayLike, R: ArrayLike) -> Array:
    """Inverse kinematics: leg lengths at a pose.

    q_i = |p + R b_i - a_i|, (6,) m (Merlet, Parallel Robots, 2006, 2.4).
    """
    return kernels.leg_lengths_kernel(
        platform.base_joints, platform.platform_joints, check_vector("p", p, 3), check_rotation(R)
    )


def jacobian(platform: Platform, p: ArrayLike, R: ArrayLike) -> Array:
    """Jacobian J of the leg lengths, dq = J twist.

    Row i is [s_i, (R b_i) x s_i], s_i the unit vector from base to platform joint (Merlet, 2006, 5.3).
    (6, 6); columns 0-2 have no unit, columns 3-5 are in m. Also raises KinematicsError for a leg of length
    zero.
    """
    J = kernels.jacobian_kernel(
        platform.base_joints, platform.platform_joints, check_vector("p", p, 3), check_rotation(R)
    )
    return _finite(J, p, R)


def jacobian_rate(platform: Platform, p: ArrayLike, R: ArrayLike, twist: ArrayLike) -> Array:
    """Time derivative of J along a motion, ddq = J dtwist + jacobian_rate twist.

    Row i is [ds_i, (omega x r_i) x s_i + r_i x ds_i], r_i = R b_i, ds_i = (u_i - s_i s_i.u_i) / q_i,
    u_i = v + omega x r_i. (6, 6); columns 0-2 in 1/s, columns 3-5 in m/s. Raises the errors of ``jacobian``.
    """
    Jdot = kernels.jacobian_rate_kernel(
        platform.base_joints,
        platform.platform_joints,
        check_vector("p", p, 3),
        check_rotation(R),
        check_vector("twist", twist, 6),
    )
    return _finite(Jdot, p, R)


def _finite(J: Array, p: ArrayLike, R: ArrayLike) -> Array:
    if not np.isfinite(J).all():
        raise KinematicsError(
            f"a leg has length zero at p = {np.asarray(p).tolist()}: its direction is undefined", p=p, R=R
        )
    return J


def condition(platform: Platform, p: ArrayLike, R: ArrayLike) -> float:
    """Upper bound on the condition number of J diag(1, 1, 1, 1/r, 1/r, 1/r): distance from a singular pose.

    r is ``platform.radius``. The bound is between 1 and 6^(1/8) = 1.251 times the 2-norm condition number;
    inf where J is singular. Raises the errors of ``jacobian``.
    """
    return condition_kernel(jacobian(platform, p, R), platform.radius)


def forward_kinematics(
    platform: Platform,
    q: ArrayLike,
    p0: ArrayLike,
    R0: ArrayLike,
    *,
    tolerance: float = 1e-12,
    max_iterations: int = 50,
) -> Pose:
    """Forward kinematics: the pose with the leg lengths q (6,) m near an initial guess.

    Newton's method on SE(3): J step = q - lengths, p += step_v, R = C(step_omega) R with the Cayley map C.
    The method needs no Euler angles and converges quadratically except at singular poses. Up to 40 poses
    share six leg lengths (Dietmaier, 1998); p0, R0 decide which one is found. From a distant guess use
    ``continue_kinematics``.

    Parameters
    ----------
    p0, R0 : initial guess of p and R.
    tolerance : m, residual that ends the iteration.
    max_iterations : largest number of Newton steps.

    Also raises KinematicsError for lengths that are unreachable or not positive, at a singular pose, and
    without convergence.
    """
    a, b, q = platform.base_joints, platform.platform_joints, _check_lengths(q)
    p, R, J, iterations, residual, _ = kernels.forward_kinematics_kernel(
        a, b, q, check_vector("p0", p0, 3), check_rotation(R0), tolerance, max_iterations
    )
    bound = condition_kernel(J, platform.radius)
    if not residual <= tolerance or not bound < SINGULAR:
        raise KinematicsError(
            f"no pose found for the leg lengths {q.tolist()} m from p0 = {np.asarray(p0).tolist()} m: after "
            f"{iterations} of {max_iterations} iterations p = {p.tolist()} m, condition of J {bound:.3g}. "
            "The lengths are out of reach, the pose is singular, or the first guess is too far away",
            q=q,
            p=p,
            R=R,
            iterations=iterations,
            condition=bound,
            residual=float(np.abs(kernels.leg_lengths_kernel(a, b, p, R) - q).max()),
        )
    return Pose(p, R, iterations, residual)


def continue_kinematics(
    platform: Platform, q: ArrayLike, p0: ArrayLike, R0: ArrayLike, *, tolerance: float = 1e-12
) -> Pose:
    """Forward kinematics from a cold start: follow the pose while the lengths move from those of p0, R0 to q.

    The lengths move on a straight line. The steps are as long as Newton's method provably stays on one
    branch (see ``hil.estimation.pose``). The result is the assembly that the machine reaches from p0, R0 on
    this path. ``iterations`` counts all steps tried. Raises the errors of ``forward_kinematics``.
    """
    q = _check_lengths(q)
    p, R, steps, residual = kernels.continuation_kernel(
        platform.base_joints,
        platform.platform_joints,
        q,
        check_vector("p0", p0, 3),
        check_rotation(R0),
        tolerance,
        MAX_SUBSTEPS,
    )
    if not residual <= tolerance:
        raise KinematicsError(
            f"the leg lengths {q.tolist()} m cannot be reached from p0 = {np.asarray(p0).tolist()} m on a "
            f"straight line of the lengths: stopped at p = {p.tolist()} m after {steps} steps",
            q=q,
            p=p,
            R=R,
            iterations=steps,
        )
    return Pose(p, R, steps, residual)


MAX_SUBSTEPS = 400
"""Largest number of steps of a continuation, failed ones included."""


def _check_lengths(q: ArrayLike) -> Array:
    lengths = check_vector("q", q, 6)
    if not (lengths > 0).all():
        raise KinematicsError(f"q: got {lengths.tolist()} m, allowed are lengths > 0", q=lengths)
    return lengths
