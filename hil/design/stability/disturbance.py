"""What a linearising law does not know of its robot, as accelerations of the axes whose error it controls.

A law of this family asks its axes (the legs, or the pose) for an acceleration a* = a_d + u. At one state of
the robot its forces are affine in a*, and the axes accelerate by Gamma u + a_d + d. So the error obeys

::

    e'' + Gamma u = -d,   u = K_D de + K_P e
    legs:  Gamma = J M^-1 J^T d tau / d a*,    d = ddq(tau at u = 0) - ddq_d + J M^-1 w
    pose:  Gamma = M^-1 J^T d tau / d a*,      d = dtwist(tau at u = 0) - dtwist_d + M^-1 w

With an exact model Gamma = I and d = J M^-1 w. Masses believed to be s times what they are give Gamma = s I
and d = J M^-1 w - (1 - s) J M^-1 J^T tau, tau the force that the motion takes.
"""

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.design.stability.local_kernels import local_kernel, reference_kernel
from hil.robot.dynamics import Model
from hil.trajectory.path import PoseSample

_STEP = 1e-6
"""Of the differences, m, rad, m/s or rad/s."""


class Load(NamedTuple):
    """Stated bound of a wrench that the law does not know; its direction may be any, and change."""

    force_N: float = 0.0
    torque_N_m: float = 0.0
    """About the platform's origin."""


class Friction(NamedTuple):
    """Stated bound of what the law's model of the friction is wrong by, per leg."""

    viscous_N_s_m: Array
    """(6,)."""
    coulomb_N: Array
    """(6,)."""


class Local(NamedTuple):
    """The loop of a linearising law at one state."""

    Gamma: Array
    """(6, 6)."""
    stale: Array
    """(6, 6), Gamma of forces that were computed for where the reference was before."""
    per_force: Array
    """(6, 6) 1/kg or 1/(kg m), accelerations of the axes per force of the legs."""
    d: Array
    """(6,) m/s^2 or rad/s^2, the largest |d| of each axis."""
    extremes: Array
    """(12, 6), the disturbances at which each axis has its largest and its smallest, friction left out."""
    by_error: Array
    """(6, 6) 1/s^2, change of the axes' accelerations per error, while the forces stay."""
    by_rate: Array
    """(6, 6) 1/s, likewise per rate."""
    condition: float
    """Of J, lengths made comparable; inf where it is singular."""


class Survey(NamedTuple):
    """The same over many states."""

    d: Array
    """(6,), largest."""
    gamma: float
    """Middle of the smallest and largest diagonal element of Gamma."""
    spread: Array
    """(6, 6), largest |Gamma - gamma I| of stale forces."""
    by_error: Array
    """(6, 6) 1/s^2, largest change of the axes' accelerations per error, while the forces stay."""
    by_rate: Array
    """(6, 6) 1/s, likewise per rate."""
    condition: float
    """Largest."""


class Linearised:
    """A robot under a law that linearises it with what it believes. No mutable state."""

    def __init__(
        self, robot: Model, believed: Model, axes: Literal["joint", "pose"], load: Load, friction: Friction
    ) -> None:
        """Both models without friction: what is wrong with it is stated by itself."""
        self.robot = robot
        self.believed = believed
        self.axes = axes
        self.load = load
        self.friction = friction
        self._models = robot.constants, believed.constants, believed.code, axes == "joint"
        parts = ([load.force_N, load.torque_N_m], friction.viscous_N_s_m, friction.coulomb_N)
        self._stated = np.concatenate(parts, dtype=float)
        self._sizes = robot.platform.radius, _STEP

    def at(self, s: PoseSample, e: Array, de: Array, stale_s: float = 0.0) -> Local:
        """Return the loop where the reference is `s` and the axes are behind it by e (6,) and de (6,).

        The pose that belongs to an error of the legs is taken to first order, J^-1 e. stale_s: so old are the
        pose and the twist of the reference for which the law answers u.
        """
        motion, behind = np.array([s.twist, s.dtwist]), np.array([e, de])
        return Local(
            *local_kernel(*self._models, s.p, s.R, motion, behind, self._stated, stale_s, *self._sizes)
        )

    def along_reference(self, s: PoseSample) -> tuple[Array, Array]:
        """Return the law's forces (6,) N without error, and the axes' accelerations per force (6, 6)."""
        tau, per_force = reference_kernel(*self._models, s.p, s.R, np.array([s.twist, s.dtwist]))
        return tau, per_force


def along(linearised: Linearised, path: Iterable[PoseSample], stale_s: float = 0.0) -> list[Local]:
    """Return the loop at each sample of a path, without error."""
    still = np.zeros(6)
    return [linearised.at(s, still, still, stale_s) for s in path]


def around(
    linearised: Linearised, path: Iterable[PoseSample], errors: Array, rates: Array, stale_s: float = 0.0
) -> list[Local]:
    """Return the loop at each sample of a path under each of the errors (n, 6), with its rate (n, 6) +- 1."""
    return [
        linearised.at(s, e, sign * de, stale_s)
        for s in path
        for e, de in zip(errors, rates, strict=True)
        for sign in (-1, 1)
    ]


def summary(found: list[Local], gamma: float | None = None) -> Survey:
    """Return what covers all of them, by default with the gain in the middle of Gamma's diagonal."""
    if gamma is None:
        diagonal = np.diagonal([local.Gamma for local in found], axis1=1, axis2=2)
        gamma = float(diagonal.min() + diagonal.max()) / 2.0
    return Survey(
        np.max([local.d for local in found], axis=0),
        gamma,
        np.abs(np.array([local.stale for local in found]) - gamma * np.eye(6)).max(axis=0),
        np.max([np.abs(local.by_error) for local in found], axis=0),
        np.max([np.abs(local.by_rate) for local in found], axis=0),
        max(local.condition for local in found),
    )
