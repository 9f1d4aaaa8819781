"""Springs to first order where the robot rests: the loop that runs, and laws without an energy.

Forces tau of a law act on the robot as J^T tau, J of the pose where it is, tau of the pose that was measured:

::

    M x'' = J(x)^T tau(x_T, x'_T) - G(x)

To first order around the pose where that is 0, x_T late, the law has a stiffness K and a damping D, and the
robot, under the forces that hold it there, a stiffness of its own: that of its weight. Laws without an energy
are judged by the eigenvalues of that (Lyapunov's indirect method).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.errors import ModelError
from hil.app.stability.spring_loop import at_rest, sampled_loop, unstable
from hil.app.stability.subject import Subject
from hil.control.cartesian_pd import ROTATION_ERRORS, CartesianPDSettings
from hil.control.feedforward_pd import FeedforwardPDSettings
from hil.control.law import per_leg
from hil.control.pd import PDSettings
from hil.control.pd_gravity import PDGravitySettings
from hil.design.stability.assessment import Assessment
from hil.design.stability.energy import displaced
from hil.mathematics.linear_system import static
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.robot.kinematics import jacobian, leg_lengths

LegSettings = PDSettings | PDGravitySettings | FeedforwardPDSettings
Forces = Callable[[Array, Array, Array], Array]
"""Leg forces (6,) N of a law at p, R and a twist, its reference at rest."""
STEP = 1e-5
"""m and rad, of the differences that derivatives are taken by; m/s and rad/s of rates."""
NEAR = 0.5
"""m and rad, the largest step to the pose of rest."""


class Linear(NamedTuple):
    """A law and the robot around a pose of rest, shifts and turns of the base frame, each array (6, 6)."""

    p: Array
    R: Array
    law: Array
    """Stiffness by what the law answers to where the robot was."""
    damping: Array
    own: Array
    """Stiffness of the robot itself under the forces that hold it."""


def cartesian_forces(subject: Subject, law: CartesianPDSettings) -> Forces:
    """Return the forces of a PD on the pose."""
    p_d, R_d = subject.path[0].p, subject.path[0].R
    K_p, K_v = law.gains()
    turned = ROTATION_ERRORS[law.rotation_error]
    model = None if law.model is None else subject.believed(law.model)

    def tau(p: Array, R: Array, twist: Array) -> Array:
        pull = K_p * np.concatenate([p_d - p, turned(R, R_d)]) - K_v * twist
        if model is None:
            return np.linalg.solve(jacobian(subject.platform, p, R).T, pull)
        return inverse_dynamics_kernel(model.constants, model.code, p, R, ZERO6, ZERO6, -pull)

    return tau


def leg_forces(subject: Subject, law: LegSettings) -> Forces:
    """Return the forces of a PD on leg lengths, with what it adds where the robot is, or at its reference."""
    p_d, R_d = subject.path[0].p, subject.path[0].R
    q_d = leg_lengths(subject.platform, p_d, R_d)
    K_p, K_v = per_leg(law.kp_N_m), per_leg(law.kv_N_s_m)
    model = None if isinstance(law, PDSettings) else subject.believed(law.model)
    ahead = isinstance(law, FeedforwardPDSettings)

    def tau(p: Array, R: Array, twist: Array) -> Array:
        e = q_d - leg_lengths(subject.platform, p, R)
        spring = K_p * e - K_v * (jacobian(subject.platform, p, R) @ twist)
        if model is None:
            return spring
        at = (p_d, R_d) if ahead else (p, R)
        return spring + inverse_dynamics_kernel(model.constants, model.code, *at, ZERO6, ZERO6, ZERO6)

    return tau


def of_first_order(subject: Subject, tau: Forces, reason: str) -> Assessment:
    """Judge forces by the eigenvalues where they bring the robot to rest. reason: why by no energy."""
    start = subject.path[0]
    try:
        found = _linear(subject, tau)
    except (ModelError, np.linalg.LinAlgError):
        claim = "the springs of the law carry what is left of the weight nowhere near: stiffen them"
        return Assessment("not proven", claim, at_rest(subject), [], {})
    if (met := subject.outside(found.p, found.R)) is not None:
        claim = f"it comes to rest outside its limits: {met}"
        return Assessment("not proven", claim, at_rest(subject), [], {})
    sag = leg_lengths(subject.platform, found.p, found.R) - leg_lengths(subject.platform, start.p, start.R)
    sag_mm = 1e3 * float(np.abs(sag).max())
    mobility = np.asarray(np.linalg.inv(subject.robot.mass_matrix(found.p, found.R)), float)
    nothing, unit = np.zeros((6, 6)), np.eye(6)
    A = np.block([[nothing, unit], [-mobility @ (found.law + found.own), -mobility @ found.damping]])
    slowest = float(np.linalg.eigvals(A).real.max())
    lines, figures, radius = loop_at_rest(subject, found)
    lines.insert(0, f"eigenvalues    slowest exp({slowest:+.3g} t) of 12, the weight's stiffness included")
    figures |= {"slowest_eigenvalue_1_s": slowest, "sag_mm": sag_mm}
    where = "the set-point" if sag_mm < 1e-3 else f"a pose {sag_mm:.3g} mm of leg length off the set-point"
    if slowest >= 0.0:
        claim = f"{reason}: no energy function; at {where} an eigenvalue grows as exp({slowest:.3g} t)"
        return Assessment("unstable", claim, [], lines, figures)
    if radius >= 1.0:
        return Assessment("unstable", unstable(subject, radius), [], lines, figures)
    rate = -np.log(radius) / subject.axis.period_s
    claim = f"{reason}: no energy function; small errors from {where} die out as exp(-{rate:.3g} t)"
    return Assessment("conditional", claim, [*at_rest(subject), "errors are small"], lines, figures)


def _linear(subject: Subject, tau: Forces) -> Linear:
    """Return the robot and its law around the pose of rest next to the reference's start (Newton's method).

    Raises ModelError where there is none near, LinAlgError where J is singular.
    """
    p, R = subject.path[0].p, subject.path[0].R
    for _ in range(30):
        left = _wrench(subject, p, R, tau(p, R, ZERO6))
        law, own = _stiffness(subject, tau, p, R)
        step = np.asarray(np.linalg.solve(law + own, left), np.float64)
        if not np.linalg.norm(step) <= NEAR:
            break
        p, R = displaced(p, R, step)
        if np.linalg.norm(step) < 1e-9:
            return linear_at(subject, tau, p, R)
    raise ModelError("no pose of rest near the reference's start")


def linear_at(subject: Subject, tau: Forces, p: Array, R: Array) -> Linear:
    """Return the robot and its law around a pose where the forces hold the weight."""
    law, own = _stiffness(subject, tau, p, R)
    damping = -jacobian(subject.platform, p, R).T @ _slopes(lambda x: tau(p, R, x), STEP * np.eye(6))
    return Linear(p, R, law, damping, own)


def loop_at_rest(subject: Subject, found: Linear) -> tuple[list[str], dict[str, Any], float]:
    """Return the loop that runs as lines, figures, and its largest |z|."""
    controller = static(np.hstack([found.law, found.damping]), subject.axis.period_s)
    mobility = np.asarray(np.linalg.inv(subject.robot.mass_matrix(found.p, found.R)), float)
    return sampled_loop(subject, controller, mobility, found.own, "where it comes to rest")


def _stiffness(subject: Subject, tau: Forces, p: Array, R: Array) -> tuple[Array, Array]:
    """Return the stiffness that the law has at a pose, and that of the robot under the forces there."""
    J, held = jacobian(subject.platform, p, R), tau(p, R, ZERO6)
    shifts = STEP * np.eye(6)
    law = -J.T @ _slopes(lambda x: tau(*displaced(p, R, x), ZERO6), shifts)
    own = -_slopes(lambda x: _wrench(subject, *displaced(p, R, x), held), shifts)
    return law, own


def _slopes(of: Callable[[Array], Array], steps: Array) -> Array:
    """Return the derivative (6, 6) of six values by central differences."""
    return np.column_stack([of(x) - of(-x) for x in steps]) / (2.0 * STEP)


def _wrench(subject: Subject, p: Array, R: Array, tau: Array) -> Array:
    """Return what is left of leg forces beside the weight, (6,) N and N m."""
    return jacobian(subject.platform, p, R).T @ tau - subject.robot.gravity(p, R)
