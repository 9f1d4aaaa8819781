"""Laws that do not linearise the robot, where it rests: springs to first order, and energy as V.

Forces tau of a law act on the robot as J^T tau, J of the pose where it is, tau of the pose that was measured:

::

    M x'' = J(x)^T tau(x_T, x'_T) - G(x)

To first order around the pose where that is 0, x_T late, the law has a stiffness K, a damping D and an
integral K_I, and the robot, under the forces that hold it there, a stiffness of its own: that of its weight.

Springs of K_p, what the law compensates, and the robot's weight may be one potential S of the pose. With the
robot's kinetic energy (Takegaki and Arimoto, 1981; LaSalle)

::

    V = t^T M t / 2 + S,     dV/dt = -dq^T K_v dq  (friction only adds to that)

For a reference at rest a pose where dS = 0 and d^2 S is positive definite is asymptotically stable.
"""

from collections.abc import Callable
from math import pi
from typing import NamedTuple

import numpy as np

from drivers.arrays import ZERO6, Array, ComplexArray
from drivers.errors import ModelError
from hil.design.stability.sampled_loop import Axis, crossings, sampled_axis
from hil.mathematics.linear_system import LinearSystem, lag, static
from hil.mathematics.rotations import rotation_from_vector
from hil.robot import dynamics_kernels as kernels
from hil.robot.dynamics import Model
from hil.robot.kinematics_kernels import jacobian_kernel

Forces = Callable[[Array, Array, Array], Array]
"""Leg forces (6,) N of a law at p, R and a twist, its reference at rest."""
STEP = 1e-5
"""m and rad, of the differences that derivatives are taken by; m/s and rad/s of rates."""
NEAR = 0.5
"""m and rad, the largest step to the pose of rest."""
NOTHING = np.zeros((6, 6))


class Springs(NamedTuple):
    """A law and the robot around a pose of rest, of shifts and turns of the base frame, each array (6, 6)."""

    mobility: Array
    """Acceleration per force, M^-1."""
    law: Array
    """Stiffness by what the law answers to where the robot was."""
    damping: Array
    own: Array = NOTHING
    """Stiffness of the robot itself under the forces that hold it, which answers at once."""
    integral: Array = NOTHING
    """K_I, by which the law's force grows per s."""

    def slowest(self) -> float:
        """Return the largest real part of the eigenvalues, 1/s: the law without sampling and delay."""
        unit, B = np.eye(6), self.mobility
        rows = [[NOTHING, unit, NOTHING], [-B @ (self.law + self.own), -B @ self.damping, B]]
        A = np.block([*rows, [-self.integral, NOTHING, NOTHING]])
        return float(np.linalg.eigvals(A if self.integral.any() else A[:12, :12]).real.max())

    def stiffness(self, radius: float) -> Array:
        """Return the eigenvalues (6,) of a stiffness that is symmetric, N/m, rotations times radius."""
        scale = np.array([1.0] * 3 + [1.0 / radius] * 3)
        K = scale[:, None] * (self.law + self.own) * scale
        return np.asarray(np.linalg.eigvalsh(0.5 * (K + K.T)), float)

    def loop(self, axis: Axis) -> tuple[LinearSystem, LinearSystem]:
        """Return the law from [e; de] to forces, its integral by Euler's rule, and the robot to [x; x']."""
        T, unit = axis.period_s, np.eye(6)
        rise = np.hstack([T * self.integral, NOTHING])
        D = np.hstack([self.law, self.damping]) + rise
        law = LinearSystem(unit, rise, unit, D, T) if self.integral.any() else static(D, T)
        return law, sampled_axis(axis.transport_s, lag(axis.lag_s), T, axis.gain * self.mobility, self.own)

    def growth(self, axis: Axis) -> float:
        """Return the largest |z| of the loop: below 1 it is stable."""
        law, robot = self.loop(axis)
        return float(np.abs(robot._replace(C=-robot.C).closed_with(law).poles()).max())

    def delay_margin_s(self, axis: Axis) -> float | None:
        """Return the further delay of all axes at which a stable loop turns unstable, s; inf where none does.

        A common delay turns all eigenvalues of the loop's frequency response by the same angle: the least
        margin of these characteristic loci is the loop's (A. G. J. MacFarlane and I. Postlethwaite, 1977).
        None where the axes swing by themselves beyond half the rate: a response tells no delay there.
        """
        law, robot = self.loop(axis)
        top = pi / axis.period_s
        squares = np.linalg.eigvals(self.mobility @ self.own).real
        peaks = np.sqrt(squares[squares > 0.0])
        if (peaks >= top).any():
            return None

        def loci(omega: Array) -> ComplexArray:
            """Return the eigenvalues (n, 6), the largest first."""
            values = np.linalg.eigvals(law.response(omega) @ robot.response(omega))
            order = np.argsort(-np.abs(values), axis=1)
            return np.asarray(np.take_along_axis(values, order, axis=1), np.complex128)

        grid = np.geomspace(1e-4, 1.0, 1500) * top
        near = np.sort(np.concatenate([grid, peaks * (1.0 - 1e-7), peaks * (1.0 + 1e-7)]))  # narrow peaks
        return min((left / omega for omega, left in crossings(loci, near)), default=np.inf)


def rest(robot: Model, tau: Forces, p: Array, R: Array) -> tuple[Array, Array, Springs]:
    """Return the pose next to p, R at which forces hold the weight (Newton's method), and the springs there.

    Raises ModelError where there is none near, LinAlgError where J is singular.
    """
    for _ in range(30):
        found = _springs(robot, tau, p, R)
        left = _wrench(robot, p, R, tau(p, R, ZERO6))
        step = np.asarray(np.linalg.solve(found.law + found.own, left), np.float64)
        if not np.linalg.norm(step) <= NEAR:
            break
        p, R = displaced(p, R, step)
        if np.linalg.norm(step) < 1e-9:
            return p, R, _springs(robot, tau, p, R)
    raise ModelError("the springs of the law carry what is left of the weight nowhere near: stiffen them")


def _springs(robot: Model, tau: Forces, p: Array, R: Array) -> Springs:
    J, held = _jacobian(robot, p, R), tau(p, R, ZERO6)
    mobility = np.asarray(np.linalg.inv(robot.mass_matrix(p, R)), float)
    law = -J.T @ _slopes(lambda x: tau(*displaced(p, R, x), ZERO6))
    damping = -J.T @ _slopes(lambda x: tau(p, R, x))
    return Springs(mobility, law, damping, -_slopes(lambda x: _wrench(robot, *displaced(p, R, x), held)))


def _slopes(of: Callable[[Array], Array]) -> Array:
    """Return the derivative (6, 6) of six values by central differences."""
    return np.column_stack([of(x) - of(-x) for x in STEP * np.eye(6)]) / (2.0 * STEP)


def _wrench(robot: Model, p: Array, R: Array, tau: Array) -> Array:
    """Return what is left of leg forces beside the weight, (6,) N and N m."""
    return _jacobian(robot, p, R).T @ tau - kernels.gravity_kernel(robot.constants, p, R)


def _jacobian(robot: Model, p: Array, R: Array) -> Array:
    return jacobian_kernel(robot.platform.base_joints, robot.platform.platform_joints, p, R)


def cubic_rest(x_d: Array, K_p: Array, linear: Array, cubic: Array) -> Array:
    """Return where legs (6,) m come to rest, k0 x + k1 x^3 = K_p (x_d - x), from their springs' rest."""
    low, high = np.minimum(x_d, 0.0), np.maximum(x_d, 0.0)
    for _ in range(60):
        x = 0.5 * (low + high)
        pulled = linear * x + cubic * x**3 > K_p * (x_d - x)
        low, high = np.where(pulled, low, x), np.where(pulled, x, high)
    return np.asarray(0.5 * (low + high), np.float64)


def same_weight(one: Model, other: Model) -> bool:
    """Tell whether two models weigh the same wherever the robot is, however it is turned."""
    return bool(np.allclose(_moments(one), _moments(other), rtol=1e-9, atol=1e-9))


def _moments(model: Model) -> Array:
    """Return what weight and its potential are made of beside the place, N and N m."""
    c = model.constants
    mass, cylinder, rod = c[kernels.MASS], c[kernels.CYLINDER_MASS], c[kernels.ROD_MASS]
    along = cylinder * c[kernels.CYLINDER_COM] - rod * c[kernels.ROD_COM]
    parts = np.array([mass, *(mass * c[kernels.COM : kernels.COM + 3]), rod, along])
    return np.asarray(np.linalg.norm(c[kernels.GRAVITY : kernels.GRAVITY + 3]) * parts, np.float64)


def displaced(p: Array, R: Array, x: Array) -> tuple[Array, Array]:
    """Return the pose shifted by x[:3] m and turned by the rotation vector x[3:] rad, base frame."""
    return p + x[:3], rotation_from_vector(x[3:]) @ R
