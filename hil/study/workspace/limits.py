"""Limits of a reachable pose: stroke, joint angles, static force, singularity, distance of the legs.

All other files of the workspace test poses with a `Surveyor`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array, Flags, Ints
from drivers.errors import ModelError
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform, unit_rows
from hil.robot.kinematics import check_rotation, check_vector
from hil.robot.kinematics_kernels import jacobian_kernel
from hil.study.workspace import kernels
from hil.study.workspace.kernels import survey_kernel

Paths = Callable[[Array, Ints], tuple[Array, Array]]
"""(t (n,), which (n,)) -> poses P (n, 3), R (n, 3, 3) or (3, 3): path which[k] at t[k]; t = 0 is inside."""
FREE = -1
"""Kind of a path that ends without reaching a limit."""
KINDS = ("stroke", "joint angle", "force", "singularity", "interference")
"""Names of the limits; a kind is an index into it."""
SINGULARITY = 3
CHUNK = 4096
"""Poses surveyed at once; their figures take some 1 MB."""
BISECTIONS = 30
"""Bisections of a step that leaves the workspace; they find its exit to 1e-9 of the step."""


class WorkspaceError(ModelError):
    """Home, or the requested position, is outside the limits of the workspace."""


@dataclass(frozen=True)
class Limits:
    """Limits that a reachable pose must keep."""

    length_min: float
    """m, each leg."""
    length_max: float
    """m, each leg."""
    force: float = np.inf
    """N, each leg, to hold platform, legs and payload still."""
    condition: float = 1e9
    """Bound on the condition of J as `hil.mathematics.linear_algebra.condition_kernel` computes it, also for
    the controller. Crossing a singularity (det J = 0) violates any bound.
    """
    base_angle: float = np.pi
    """rad, between each leg and the axis of its base joint."""
    platform_angle: float = np.pi
    """rad, between each leg and the axis of its platform joint."""
    leg_diameter: float | None = None
    """m, smallest distance between the axes of two legs; None: not checked. Pairs whose joints are closer
    than that at an end are built to meet and are not checked.
    """


class Surveyor:
    """Computes figures of poses and tests poses against limits. Every path begins at home.

    home_p (3,) m, home_R (3, 3): home. base_axes, platform_axes : (6, 3), joint axes from base to platform,
    in the frame of the base and of the platform, of any length; default: each leg's own direction at home.
    payload : kg, on the platform at ``payload_at`` (3,) m, platform frame.

    Raises WorkspaceError: home is outside the limits; GeometryError, KinematicsError: an argument is not a
    direction, vector or rotation.
    """

    def __init__(
        self,
        platform: Platform,
        limits: Limits,
        home_p: ArrayLike,
        home_R: ArrayLike,
        *,
        base_axes: ArrayLike | None = None,
        platform_axes: ArrayLike | None = None,
        payload: float = 0.0,
        payload_at: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.platform = platform
        self.limits = limits
        self.p = check_vector("home p", home_p, 3)
        self.R = check_rotation(home_R)
        self.payload = np.array([payload, *check_vector("payload_at", payload_at, 3)])
        self._constants = Model(platform).constants
        self._watched = np.zeros((6, 6))
        if limits.leg_diameter is not None:
            self._watched = _distinct(platform, limits.leg_diameter)
        s = jacobian_kernel(platform.base_joints, platform.platform_joints, self.p, self.R)[:, :3]
        self.base_axes = s.copy() if base_axes is None else unit_rows("base_axes", base_axes)
        self.platform_axes = (
            s @ self.R if platform_axes is None else unit_rows("platform_axes", platform_axes)
        )
        self.orientation = 0.0
        figures = self.survey(self.p, self.R)
        self.orientation = float(figures[0, kernels.ORIENTATION])
        problems = self._problems(figures)
        if problems:
            raise WorkspaceError(f"home, p = {self.p.tolist()} m, is outside the limits: {problems}")

    def survey(self, P: Array, R: Array, payload_kg: float | None = None) -> Array:
        """Figures of n poses, (n, 27): columns of `hil.study.workspace.kernels`.

        P (n, 3) or (3,) m; R (n, 3, 3), or (3, 3) for all. payload_kg : another mass of the payload.
        """
        payload = self.payload if payload_kg is None else np.array([payload_kg, *self.payload[1:]])
        P = np.ascontiguousarray(P, np.float64).reshape(-1, 3)
        RR = np.ascontiguousarray(np.broadcast_to(R, (len(P), 3, 3))).reshape(-1, 9)
        out = np.empty((len(P), kernels.COLUMNS))
        axes = self.base_axes, self.platform_axes
        survey_kernel(self._constants, payload, *axes, self._watched, self.platform.radius, P, RR, out)
        return out

    def margins(self, figures: Array) -> Array:
        """Margins (n, 5), one column per limit of KINDS: >= 0 within the limit.

        Stroke as a share of the stroke; joint angle as difference of cosines; force and condition as shares
        of the limit; interference as a share of the diameter. -1 beyond a singularity.
        """
        m = np.full((len(figures), len(KINDS)), np.inf)
        lim = self.limits
        q = figures[:, kernels.LENGTH : kernels.LENGTH + 6]
        stroke = lim.length_max - lim.length_min
        m[:, 0] = np.minimum(q - lim.length_min, lim.length_max - q).min(axis=1) / stroke
        firsts = (kernels.BASE_COSINE, kernels.PLATFORM_COSINE)
        for angle, first in zip((lim.base_angle, lim.platform_angle), firsts, strict=True):
            cosine = figures[:, first : first + 6].min(axis=1)
            m[:, 1] = np.minimum(m[:, 1], cosine - np.cos(angle))
        regular = figures[:, kernels.ORIENTATION] == self.orientation
        tau = np.abs(figures[:, kernels.FORCE : kernels.FORCE + 6]).max(axis=1)
        m[:, 2] = np.where(np.isnan(tau), np.inf, 1.0 - tau / lim.force)
        m[:, SINGULARITY] = np.where(regular, 1.0 - figures[:, kernels.CONDITION] / lim.condition, -1.0)
        if lim.leg_diameter is not None:
            m[:, 4] = figures[:, kernels.CLEARANCE] / lim.leg_diameter - 1.0
        m[np.isnan(m)] = -1.0  # a leg of length zero has no direction
        return m

    def inside(self, P: Array, R: Array) -> Flags:
        """Mask (n,) of poses P (n, 3) m within all limits and on home's side of the singularity det J = 0."""
        found: Flags = np.ones(len(P), np.bool_)
        for k in range(0, len(P), CHUNK):
            part = R if R.ndim == 2 else R[k : k + CHUNK]
            found[k : k + CHUNK] = (self.margins(self.survey(P[k : k + CHUNK], part)) >= 0).all(axis=1)
        return found

    def first_exit(self, paths: Paths, count: int, step: float, end: float) -> tuple[Array, Ints]:
        """Follow paths from t = 0; return the last t inside the limits, and the kind of limit met there.

        Paths end at t = ``end``. They are followed in steps, and the step that leaves is bisected: a gap
        shorter than ``step`` may be missed.
        """
        low, high = np.zeros(count), np.full(count, np.nan)
        going = np.arange(count)
        while len(going):
            t = np.minimum(low[going] + step, end)
            good = self.inside(*paths(t, going))
            high[going[~good]] = t[~good]
            low[going[good]] = t[good]
            going = going[good & (t < end)]
        kinds: Ints = np.full(count, FREE)
        met = np.flatnonzero(~np.isnan(high))
        for _ in range(BISECTIONS if len(met) else 0):
            t = 0.5 * (low[met] + high[met])
            good = self.inside(*paths(t, met))
            low[met[good]], high[met[~good]] = t[good], t[~good]
        if len(met):
            kinds[met] = np.argmax(self.margins(self.survey(*paths(high[met], met))) < 0, axis=1)
        return low, kinds

    def rays(self, start: Array, directions: Array, step: float, end: float) -> tuple[Array, Ints]:
        """``first_exit`` along lines at home's orientation: start (n, 3) m from home, directions (n, 3)."""

        def lines(t: Array, which: Ints) -> tuple[Array, Array]:
            return self.p + start[which] + t[:, None] * directions[which], self.R

        return self.first_exit(lines, len(start), step, end)

    def dexterity(self, P: Array, R: Array) -> tuple[Array, Array]:
        """Condition number (n,) and smallest singular value (n,) of J diag(1, 1, 1, 1/r, 1/r, 1/r).

        r is ``platform.radius``, so that all columns are displacements of the platform joints' circle and
        both figures have no unit. The smallest singular value measures the distance to a singularity: it is
        the least norm of the leg rates at a unit rate of the platform. Its reciprocal bounds the leg forces
        of a unit load. The condition number is that of the 2-norm (Merlet, Parallel Robots, 2006, 5.5).
        """
        r = self.platform.platform_joints @ np.swapaxes(R, -1, -2)
        d = P[:, None] + r - self.platform.base_joints
        s = d / np.linalg.norm(d, axis=2, keepdims=True)
        J = np.concatenate([s, np.cross(r, s) / self.platform.radius], axis=2)
        sigma = np.linalg.svd(J, compute_uv=False)
        return sigma[:, 0] / sigma[:, 5], sigma[:, 5]

    def largest_payload(self) -> float:
        """Largest mass, kg, at the payload's place that the legs can hold at home, payload included."""
        limit, forces = self.limits.force, slice(kernels.FORCE, kernels.FORCE + 6)
        empty, loaded = (self.survey(self.p, self.R, kg)[0, forces] for kg in (0.0, 1.0))
        slope = loaded - empty  # N per kg
        room = np.where(slope > 0, limit - empty, -limit - empty)
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.min(np.where(slope != 0, room / slope, np.inf)))

    def _problems(self, figures: Array) -> str:
        lim, row = self.limits, figures[0]
        q, tau, *cosines = (row[k : k + 6] for k in range(0, kernels.ORIENTATION, 6))
        bent = np.rad2deg(np.arccos(np.clip(cosines, -1, 1))).max(axis=1)
        joints = (("base", bent[0], lim.base_angle), ("platform", bent[1], lim.platform_angle))
        angles = [
            f"{name} joint up to {angle:.2f} deg from its axis (allowed {np.rad2deg(allowed):g})"
            for name, angle, allowed in joints
        ]
        stroke = f"{lim.length_min:g} to {lim.length_max:g}"
        texts = (
            f"leg lengths {q.min():.4f} to {q.max():.4f} m (allowed {stroke})",
            ", ".join(angles),
            f"static leg force {np.abs(tau).max():.1f} N (allowed {lim.force:g})",
            f"condition of J {row[kernels.CONDITION]:.4g} (allowed {lim.condition:g})",
            f"legs {row[kernels.CLEARANCE]:.4f} m apart (allowed more than {lim.leg_diameter} m)",
        )
        broken = self.margins(figures)[0] < 0
        return "; ".join(text for text, bad in zip(texts, broken, strict=True) if bad)


def levels(below: float, above: float, count: int) -> Array:
    """Values (2 count + 1,) from -below to above, with `count` even steps on either side of zero."""
    return np.concatenate([-below * np.arange(count, 0, -1), above * np.arange(count + 1)]) / count


def _distinct(platform: Platform, diameter: float) -> Array:
    """Matrix (6, 6): 1 if the joints of two legs are further apart than `diameter`, m, at both ends."""
    apart = np.ones((6, 6))
    for joints in (platform.base_joints, platform.platform_joints):
        apart *= np.linalg.norm(joints[:, None] - joints[None, :], axis=2) > diameter
    return apart
