"""Model error of a linearising law, as accelerations of the axes that the law controls.

The law requests an acceleration a* = a_d + u of its axes (the legs, or the pose). At one state of the robot
its forces are affine in a*, and the axes accelerate by Gamma u + a_d + d. The error therefore obeys

::

    e'' + Gamma u = -d,   u = K_D de + K_P e
    legs:  Gamma = J M^-1 J^T d tau / d a*,    d = ddq(tau at u = 0) - ddq_d + J M^-1 w
    pose:  Gamma = M^-1 J^T d tau / d a*,      d = dtwist(tau at u = 0) - dtwist_d + M^-1 w

With an exact model Gamma = I and d = J M^-1 w. If all masses of the model are s times the real ones,
Gamma = s I and d = J M^-1 w - (1 - s) J M^-1 J^T tau, tau the force of the motion.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple, Self

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import BOOLEAN, INTEGER, MATRIX, VECTOR, kernel
from hil.mathematics.linear_algebra import condition_kernel
from hil.mathematics.rotations import rotation_from_vector
from hil.mathematics.vectors import at
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import (
    BASE,
    FULL,
    PLATFORM,
    fill_jacobian,
    fill_mass_matrix,
    inverse_dynamics_kernel,
    joint_idc_kernel,
    newton_euler,
)
from hil.robot.dynamics_kernels import GRAVITY as G
from hil.robot.kinematics_kernels import jacobian_rate_twist
from hil.trajectory.path import PoseSample

_STEP = 1e-6
"""Step of the finite differences, m, rad, m/s or rad/s."""
_UNIT = np.eye(6)


class Load(NamedTuple):
    """Bound on the unmodelled wrench; its direction is arbitrary and may change."""

    force_N: float = 0.0
    torque_N_m: float = 0.0
    """Torque about the platform's origin."""


class Friction(NamedTuple):
    """Bound on the error of the law's friction model, per leg."""

    viscous_N_s_m: Array
    """(6,) N s/m, error of viscous friction."""
    coulomb_N: Array
    """(6,) N, error of Coulomb friction."""


class Local(NamedTuple):
    """Properties of the loop of a linearising law at n states of the robot."""

    Gamma: Array
    """(n, 6, 6), derivative of the axes' accelerations by the requested ones; I for an exact model."""
    stale: Array
    """(n, 6, 6), Gamma of delayed forces, computed for an earlier state of the reference."""
    per_force: Array
    """(n, 6, 6) 1/kg or 1/(kg m), accelerations of the axes per force of the legs."""
    d: Array
    """(n, 6) m/s^2 or rad/s^2, the largest |d| of each axis."""
    extremes: Array
    """(n, 12, 6), the disturbances at which each axis has its largest and its smallest d, without
    friction."""
    by_error: Array
    """(n, 6, 6) 1/s^2, change of the axes' accelerations per error at constant forces."""
    by_rate: Array
    """(n, 6, 6) 1/s, change of the axes' accelerations per rate error at constant forces."""
    condition: Array
    """(n,), condition number of J with lengths scaled; inf where J is singular."""
    tau: Array
    """(n, 6) N, the law's forces at u = 0."""


class Survey(NamedTuple):
    """Bounds on a loop over many states of the robot."""

    d: Array
    """(6,) m/s^2 or rad/s^2, largest |d| of each axis."""
    gamma: float
    """Mean of the smallest and largest diagonal element of Gamma."""
    spread: Array
    """(6, 6), largest |Gamma - gamma I|, Gamma of delayed forces."""
    by_error: Array
    """(6, 6) 1/s^2, largest change of the axes' accelerations per error at constant forces."""
    by_rate: Array
    """(6, 6) 1/s, largest change of the axes' accelerations per rate error at constant forces."""
    condition: float
    """Largest condition number of J."""

    @classmethod
    def of(cls, found: Local, gamma: float | None = None) -> Self:
        """Bounds over all states; the default gamma is the middle of Gamma's diagonal."""
        if gamma is None:
            diagonal = np.diagonal(found.Gamma, axis1=1, axis2=2)
            gamma = float(diagonal.min() + diagonal.max()) / 2.0
        return cls(
            found.d.max(axis=0),
            gamma,
            np.abs(found.stale - gamma * _UNIT).max(axis=0),
            np.abs(found.by_error).max(axis=0),
            np.abs(found.by_rate).max(axis=0),
            float(found.condition.max()),
        )


class Inertia(NamedTuple):
    """Effect of an inertia error on the requested accelerations: Gamma = J M^-1 M_model J^-1."""

    alpha: float = 0.0
    """Largest row-sum norm of Gamma - I."""
    alpha_2: float = 0.0
    """Largest spectral norm of Gamma - I."""
    dominance: float = 1.0
    """Smallest diagonal dominance: Gamma_ii minus the magnitudes of the rest of its row."""
    definite: float = 1.0
    """Smallest eigenvalue of the symmetric part of Gamma."""
    eigenvalues: tuple[float, float] = (1.0, 1.0)
    """Smallest and largest eigenvalue of Gamma; real, because Gamma is similar to M^-1 M_model."""

    @classmethod
    def of(cls, Gamma: Array) -> Self:
        """Bounds over n states, from their matrices Gamma (n, 6, 6)."""
        off = Gamma - _UNIT
        diagonal = np.diagonal(Gamma, axis1=1, axis2=2)
        values = np.linalg.eigvals(Gamma).real
        return cls(
            float(np.abs(off).sum(axis=2).max()),
            float(np.linalg.norm(off, ord=2, axis=(1, 2)).max()),
            float((diagonal + np.abs(diagonal) - np.abs(Gamma).sum(axis=2)).min()),
            float(np.linalg.eigvalsh(0.5 * (Gamma + Gamma.transpose(0, 2, 1))).min()),
            (float(values.min()), float(values.max())),
        )


@kernel(VECTOR, MATRIX, MATRIX, MATRIX)
def robot_kernel(c: Array, p: Array, turns: Array, twist: Array) -> tuple[Array, Array, Array, Array]:
    """J, M (n, 6, 6), H + G and (dJ/dt) twist (n, 6) at n states: p (n, 3), R (3 n, 3), twist (n, 6)."""
    n, still = len(p), np.zeros(6)
    J, M, bias, curve = np.empty((n, 6, 6)), np.empty((n, 6, 6)), np.empty((n, 6)), np.empty((n, 6))
    for k in range(n):
        R = turns[3 * k : 3 * k + 3]
        fill_jacobian(c, FULL, p[k], R, J[k])
        fill_mass_matrix(c, p[k], R, M[k])
        newton_euler(c, p[k], R, at(c, G), twist[k], still, bias[k])
        for i in range(6):
            a, b = at(c, BASE + 3 * i), at(c, PLATFORM + 3 * i)
            curve[k, i] = jacobian_rate_twist(a, b, at(p[k], 0), R, at(twist[k], 0), at(twist[k], 3))
    return J, M, bias, curve


@kernel(VECTOR, INTEGER, BOOLEAN, MATRIX, MATRIX, MATRIX, MATRIX)
def forces_kernel(
    c: Array, code: int, joint: bool, p: Array, turns: Array, twist: Array, demanded: Array
) -> Array:
    """Leg forces (n, 6) N of a law for requested accelerations (n, 6) of the legs or the pose.

    c and code: constants and variant of the law's model.
    """
    tau, J, none = np.empty((len(p), 6)), np.empty((6, 6)), np.zeros(6)
    for k in range(len(p)):
        R = turns[3 * k : 3 * k + 3]
        if joint:
            fill_jacobian(c, FULL, p[k], R, J)
            tau[k] = joint_idc_kernel(c, code, p[k], R, twist[k], J, demanded[k], none)
        else:
            tau[k] = inverse_dynamics_kernel(c, code, p[k], R, twist[k], demanded[k], none)
    return tau


class _Robot(NamedTuple):
    joint: bool
    J: Array
    M: Array
    bias: Array
    curve: Array

    def of_axes(self, dtwist: Array) -> Array:
        """Accelerations (n, 6) of the controlled axes, legs if `joint`, else dtwist (n, 6) itself."""
        return _times(self.J, dtwist) + self.curve if self.joint else dtwist

    def answer(self, tau: Array) -> Array:
        """Accelerations (n, 6) of the controlled axes under leg forces tau (n, 6) N without external load."""
        return self.of_axes(_solved(self.M, _times(self.J.transpose(0, 2, 1), tau) - self.bias))


def _times(A: Array, x: Array) -> Array:
    return np.asarray((A @ x[..., None])[..., 0], float)


def _solved(A: Array, b: Array) -> Array:
    return np.asarray(np.linalg.solve(A, b[..., None])[..., 0], float)


def _displaced(p: Array, R: Array, x: Array) -> tuple[Array, Array]:
    """Poses shifted by x[:, :3] m and turned by the rotation vectors x[:, 3:] rad, base frame."""
    return p + x[:, :3], np.array([rotation_from_vector(turn) for turn in x[:, 3:]]) @ R


class Linearised:
    """A robot and a control law that linearises it with a model of its own. No mutable state."""

    def __init__(
        self, robot: Model, believed: Model, axes: Literal["joint", "pose"], load: Load, friction: Friction
    ) -> None:
        """Both models must be without friction; `friction` bounds the error of the law's friction model."""
        self.robot, self.believed, self.axes, self._joint = robot, believed, axes, axes == "joint"
        self.load, self.friction = load, friction

    def _robot(self, p: Array, R: Array, twist: Array) -> _Robot:
        found = robot_kernel(self.robot.constants, p, R.reshape(-1, 3), np.ascontiguousarray(twist))
        return _Robot(self._joint, *found)

    def _forces(self, p: Array, R: Array, twist: Array, demanded: Array) -> Array:
        model = self.believed
        turns = np.ascontiguousarray(R).reshape(-1, 3)
        return forces_kernel(model.constants, model.code, self._joint, p, turns, twist, demanded)

    def _by_demand(self, p: Array, R: Array, twist: Array, demanded: Array) -> tuple[Array, Array]:
        """Law's forces (n, 6) N, and their derivative (n, 6, 6) by the requested acceleration."""
        tau = self._forces(p, R, twist, demanded)
        more = [self._forces(p, R, twist, demanded + unit) - tau for unit in _UNIT]
        return tau, np.stack(more, axis=2)

    def at(
        self,
        path: Sequence[PoseSample],
        e: Array | float = 0.0,
        de: Array | float = 0.0,
        stale_s: float = 0.0,
    ) -> Local:
        """Loop with the reference at each sample and the axes' errors e and de (n, 6).

        A leg error is converted to a pose error to first order, J^-1 e. stale_s: delay between the state for
        which the law computes u and the present state.
        """
        s = PoseSample(*(np.array(part, float) for part in zip(*path, strict=True)))
        x, dx = (np.broadcast_to(np.asarray(behind, float), s.twist.shape) for behind in (e, de))
        reference = self._robot(s.p, s.R, s.twist)
        demanded = reference.of_axes(s.dtwist)
        if self._joint:
            x, dx = _solved(reference.J, x), _solved(reference.J, dx)
        (p, R), twist = _displaced(s.p, s.R, -x), s.twist - dx
        here = self._robot(p, R, twist)
        tau, per_demand = self._by_demand(p, R, twist, demanded)
        mobility = np.asarray(np.linalg.inv(here.M), np.float64)
        if self._joint:
            mobility = here.J @ mobility
        per_force = mobility @ here.J.transpose(0, 2, 1)
        Gamma = stale = per_force @ per_demand
        if stale_s != 0.0:
            was = _displaced(p, R, -stale_s * s.twist)
            stale = per_force @ self._by_demand(*was, twist - stale_s * s.dtwist, demanded)[1]
        error = here.answer(tau) - demanded
        d, extremes = self._extremes(mobility, error)
        rates = np.abs(_times(here.J, twist))
        lost = self.friction.viscous_N_s_m * rates + self.friction.coulomb_N
        radius = self.robot.platform.radius
        condition = [condition_kernel(J, radius) for J in here.J]
        return Local(
            Gamma,
            stale,
            per_force,
            d + _times(np.abs(per_force), lost),
            extremes,
            *self._by_state(p, R, twist, tau, here),
            np.array(condition),
            tau,
        )

    def _extremes(self, mobility: Array, error: Array) -> tuple[Array, Array]:
        """Largest |d| (n, 6) of each axis under load and error, and d of all axes then, (n, 12, 6)."""
        halves = mobility.reshape(-1, 6, 2, 3)  # by a force, by a torque
        size = np.linalg.norm(halves, axis=3, keepdims=True)
        most = np.array([[self.load.force_N], [self.load.torque_N_m]])
        wrench = most * np.divide(halves, size, out=np.zeros_like(halves), where=size > 0.0)
        loads = wrench.reshape(-1, 6, 6) @ mobility.transpose(0, 2, 1)  # (n, the axis it is worst for, axes)
        extremes = np.concatenate([error[:, None] + loads, error[:, None] - loads], axis=1)
        return np.abs(error) + np.diagonal(loads, axis1=1, axis2=2), extremes

    def _by_state(self, p: Array, R: Array, twist: Array, tau: Array, here: _Robot) -> tuple[Array, Array]:
        """Partial derivatives (n, 6, 6) of the axes' accelerations by their positions and by their rates.

        The derivative by a position keeps the rates of the axes constant.
        """
        steps = _STEP * (np.linalg.inv(here.J) if self._joint else np.broadcast_to(_UNIT, here.J.shape))
        still, rates = here.answer(tau), _times(here.J, twist)
        found = []
        for x in steps.transpose(2, 0, 1):  # of the pose, for a step of one axis
            moved = _displaced(p, R, x)
            there = twist
            if self._joint:
                there = _solved(self._robot(*moved, twist).J, rates)
            by_place = self._robot(*moved, there).answer(tau) - still
            found.append([by_place, self._robot(p, R, twist + x).answer(tau) - still])
        by_error, by_rate = np.array(found).transpose(1, 2, 3, 0) / _STEP
        return by_error, by_rate

    def along_reference(self, s: PoseSample) -> tuple[Array, Array]:
        """Law's forces (n, 6) N at zero error, and the axes' accelerations per force (n, 6, 6).

        s: samples of the reference, stacked to arrays (n, ...).
        """
        s = PoseSample(*map(np.ascontiguousarray, s))
        robot = self._robot(s.p, s.R, s.twist)
        per_force = np.linalg.solve(robot.M, robot.J.transpose(0, 2, 1))
        tau = self._forces(s.p, s.R, s.twist, robot.of_axes(s.dtwist))
        return tau, np.asarray(robot.J @ per_force if self._joint else per_force, float)

    def around(self, path: Sequence[PoseSample], errors: Array, rates: Array, stale_s: float = 0.0) -> Local:
        """Properties of the loop at each sample for each error (m, 6), with plus and minus its rate."""
        e, de = np.vstack([errors, errors]), np.vstack([-rates, rates])
        all_samples = [s for s in path for _ in e]
        return self.at(all_samples, np.tile(e, (len(path), 1)), np.tile(de, (len(path), 1)), stale_s)


class Drives(NamedTuple):
    """Quantisation and losses of six drives, each array (6,)."""

    length: Array
    """m, largest error of a measured length: by the resolution of drive and encoder, and by its age."""
    rate: Array
    """m/s, largest error of a measured rate."""
    force: Array
    """N at the leg, resolution of the force commands."""
    loss: Array
    """(6,), largest relative error of the compensation of transmission losses in a force."""

    @property
    def stepped(self) -> bool:
        """True if the drives quantise a measured length or rate, or the commanded force."""
        return bool(np.any([self.length, self.rate, self.force]))

    def disturb(self, found: Local) -> tuple[Array, Array]:
        """Disturbance of the axes: constant part (6,) m/s^2 or rad/s^2, and shares (6, 6) of |u|."""
        P = np.abs(found.per_force)
        by_path = _times(P, self.force + self.loss * np.abs(found.tau)).max(axis=0)
        if not self.loss.any():
            return by_path, np.zeros((6, 6))
        back = np.abs(np.linalg.solve(found.per_force, found.Gamma))
        return by_path, (P @ (self.loss[:, None] * back)).max(axis=0)
