"""Laws that do not linearise the robot, near a pose of rest: first-order stiffness, and energy as V.

The forces tau of a law act on the robot as J^T tau, J at the present pose, tau from the measured pose:

::

    M x'' = J(x)^T tau(x_T, x'_T) - G(x)

To first order around the pose of rest, x_T delayed, the law has a stiffness K, a damping D and an integral
K_I. The robot has a stiffness of its own, from its weight under constant leg forces.

The springs K_p, the compensated forces, and the robot's weight may have one potential S of the pose. With the
robot's kinetic energy (Takegaki and Arimoto, 1981; LaSalle)

::

    V = t^T M t / 2 + S,     dV/dt = -dq^T K_v dq  (friction dissipates further)

For a reference at rest a pose where dS = 0 and d^2 S is positive definite is asymptotically stable.
"""

from collections.abc import Callable
from math import ceil, pi
from typing import NamedTuple

import numpy as np

from drivers.arrays import ZERO6, Array, ComplexArray
from drivers.errors import ModelError
from hil.design.stability.observed_loop import Observer, observed
from hil.design.stability.sampled_loop import Axis, crossing_margins, root, sampled_axis
from hil.mathematics.linear_system import LinearSystem, lag, static
from hil.mathematics.rotations import rotation_from_vector
from hil.robot import dynamics_kernels as kernels
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian

Forces = Callable[[Array, Array, Array], Array]
"""Leg forces (6,) N of a law at p, R and a twist, with its reference at rest."""
STEP = 1e-5
"""Step of the finite differences: m and rad; m/s and rad/s for rates."""
NEAR = 0.5
"""m and rad, largest Newton step towards the pose of rest."""
NOTHING = np.zeros((6, 6))


class Springs(NamedTuple):
    """Law and robot, linearised at a pose of rest: (6, 6) each, shifts in m and turns in rad, base frame."""

    mobility: Array
    """Acceleration of the platform per force, M^-1."""
    law: Array
    """Stiffness of the law, which acts on the measured pose."""
    damping: Array
    own: Array = NOTHING
    """Stiffness of the robot under constant leg forces, which acts without delay."""
    integral: Array = NOTHING
    """K_I: rate of the law's force per position error and second."""
    observer: Observer | None = None
    """Observer of the wrench, if the law compensates its estimate."""

    def slowest(self) -> float:
        """Largest real part, 1/s, of the eigenvalues without sampling and delay; below 0: stable."""
        unit, B = np.eye(6), self.mobility
        rows = [[NOTHING, unit, NOTHING], [-B @ (self.law + self.own), -B @ self.damping, B]]
        A = np.block([*rows, [-self.integral, NOTHING, NOTHING]])
        return float(np.linalg.eigvals(A if self.integral.any() else A[:12, :12]).real.max())

    def stiffness(self, radius: float) -> Array:
        """Eigenvalues (6,) of the symmetric stiffness, N/m, with rotations scaled by radius."""
        scale = np.array([1.0] * 3 + [1.0 / radius] * 3)
        K = scale[:, None] * (self.law + self.own) * scale
        return np.asarray(np.linalg.eigvalsh(0.5 * (K + K.T)), float)

    def loop(self, axis: Axis) -> tuple[LinearSystem, LinearSystem]:
        """Sampled law from [e; de] to forces, its integral by Euler's rule; sampled robot, to [x; x']."""
        T, unit = axis.period_s, np.eye(6)
        rise = np.hstack([T * self.integral, NOTHING])
        D = np.hstack([self.law, self.damping]) + rise
        law = LinearSystem(unit, rise, unit, D, T) if self.integral.any() else static(D, T)
        if self.observer is not None:
            law = observed(law, self.observer, np.asarray(np.linalg.inv(self.mobility), float))
            seen = np.vstack([np.eye(12), np.hstack([-self.own, NOTHING])])  # its model contains the weight
            law = law._replace(B=law.B @ seen, D=law.D @ seen)
        return law, sampled_axis(axis.transport_s, lag(axis.lag_s), T, axis.gain * self.mobility, self.own)

    def closed(self, axis: Axis) -> LinearSystem:
        """Sampled closed loop, whose first states are [x; x']."""
        law, robot = self.loop(axis)
        return robot._replace(C=-robot.C).closed_with(law)

    def growth(self, axis: Axis) -> float:
        """Largest pole magnitude |z| of the sampled loop; below 1 the loop is stable."""
        return float(np.abs(self.closed(axis).poles()).max())

    def gain_up(self, axis: Axis) -> float:
        """Factor on all gains of the law, up to 1000, at which a stable loop becomes unstable."""

        def grown(power: float) -> float:
            k = 10.0**power
            stiffer = self._replace(law=k * self.law, damping=k * self.damping, integral=k * self.integral)
            return stiffer.growth(axis) - 1.0

        return float(10.0 ** root(grown, 0.0, 3.0))

    def per_force(self, axis: Axis, J: Array) -> float:
        """Largest leg error per force on the platform, m/N, for any course and direction of the force.

        J (6, 6): Jacobian of the leg lengths. The force is held for each period.
        """
        T, A = axis.period_s, self.closed(axis).A
        x, error = np.zeros((len(A), 3)), np.zeros(6)
        x[:6], x[6:12] = T * T / 2.0 * self.mobility[:, :3], T * self.mobility[:, :3]
        for _ in range(min(20_000, ceil(-12.0 / np.log(self.growth(axis))) + len(A))):
            error += np.linalg.norm(J @ x[:6], axis=1)
            x = A @ x
        return float(error.max())

    def margins(self, axis: Axis) -> tuple[float, float, float] | None:
        """Margins of a stable loop for a change of all axes: delay, s; crossover, rad/s; phase, deg.

        An additional delay or phase beyond them makes the loop unstable; inf: none does. The crossover is the
        highest frequency at which a locus below has magnitude 1.

        A common delay turns all eigenvalues of the loop's frequency response by the same angle. The smallest
        margin of these characteristic loci is the loop's (A. G. J. MacFarlane and I. Postlethwaite, 1977).
        None if the axes oscillate by themselves above half the rate, where a response shows no delay.
        """
        law, robot = self.loop(axis)
        top = pi / axis.period_s
        squares = np.linalg.eigvals(self.mobility @ self.own).real
        peaks = np.sqrt(squares[squares > 0.0])
        if (peaks >= top).any():
            return None

        def loci(omega: Array) -> ComplexArray:
            """Eigenvalues (n, 6) of the open loop at n frequencies, the largest magnitude first."""
            values = np.linalg.eigvals(law.response(omega) @ robot.response(omega))
            order = np.argsort(-np.abs(values), axis=1)
            return np.asarray(np.take_along_axis(values, order, axis=1), np.complex128)

        grid = np.geomspace(1e-4, 1.0, 1500) * top
        near = np.sort(np.concatenate([grid, peaks * (1.0 - 1e-7), peaks * (1.0 + 1e-7)]))  # narrow peaks
        return crossing_margins(loci, near)


def rest(robot: Model, tau: Forces, p: Array, R: Array) -> tuple[Array, Array, Springs]:
    """Nearest pose to p, R at which the law's forces carry the weight (Newton's method), and its springs.

    Raises ModelError if no such pose is near, LinAlgError where J is singular.
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
    raise ModelError("no pose of rest near the reference: the law is too soft, increase its gains")


def _springs(robot: Model, tau: Forces, p: Array, R: Array) -> Springs:
    J, held = jacobian(robot.platform, p, R), tau(p, R, ZERO6)
    mobility = np.asarray(np.linalg.inv(robot.mass_matrix(p, R)), float)
    law = -J.T @ _slopes(lambda x: tau(*displaced(p, R, x), ZERO6))
    damping = -J.T @ _slopes(lambda x: tau(p, R, x))
    return Springs(mobility, law, damping, -_slopes(lambda x: _wrench(robot, *displaced(p, R, x), held)))


def _slopes(of: Callable[[Array], Array]) -> Array:
    """Jacobian (6, 6) of six values by central differences."""
    return np.column_stack([of(x) - of(-x) for x in STEP * np.eye(6)]) / (2.0 * STEP)


def _wrench(robot: Model, p: Array, R: Array, tau: Array) -> Array:
    """Wrench (6,) N, N m on the platform: leg forces tau (6,) N minus weight, base frame."""
    return jacobian(robot.platform, p, R).T @ tau - kernels.gravity_kernel(robot.constants, p, R)


def cubic_rest(x_d: Array, K_p: Array, linear: Array, cubic: Array) -> Array:
    """Positions x (6,) m of legs on springs at rest: k0 x + k1 x^3 = K_p (x_d - x), 0: springs relaxed."""
    low, high = np.minimum(x_d, 0.0), np.maximum(x_d, 0.0)
    for _ in range(60):
        x = 0.5 * (low + high)
        pulled = linear * x + cubic * x**3 > K_p * (x_d - x)
        low, high = np.where(pulled, low, x), np.where(pulled, x, high)
    return np.asarray(0.5 * (low + high), np.float64)


def same_weight(one: Model, other: Model) -> bool:
    """True if two models have the same weight in every pose, to 1e-9."""
    return bool(np.allclose(_moments(one), _moments(other), rtol=1e-9, atol=1e-9))


def _moments(model: Model) -> Array:
    """Parameters, N and N m, that determine the weight and its potential in every pose."""
    c = model.constants
    mass, cylinder, rod = c[kernels.MASS], c[kernels.CYLINDER_MASS], c[kernels.ROD_MASS]
    along = cylinder * c[kernels.CYLINDER_COM] - rod * c[kernels.ROD_COM]
    parts = np.array([mass, *(mass * c[kernels.COM : kernels.COM + 3]), rod, along])
    return np.asarray(np.linalg.norm(c[kernels.GRAVITY : kernels.GRAVITY + 3]) * parts, np.float64)


def displaced(p: Array, R: Array, x: Array) -> tuple[Array, Array]:
    """Pose shifted by x[:3] m and turned by the rotation vector x[3:] rad, base frame."""
    return p + x[:3], rotation_from_vector(x[3:]) @ R
