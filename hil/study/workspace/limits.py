"""The limits of a pose: stroke, joint angles, static force, singularity, distance of the legs.

All other files ask a `Surveyor` whether a pose is inside.
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

Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is finished, 0 to 1."""

KINDS = ("stroke", "joint angle", "force", "singularity", "interference")
"""Names of the limits; a kind is an index into it."""
SINGULARITY = 3
CHUNK = 4096
"""Poses surveyed at once: some 1 MB of figures."""
BISECTIONS = 30
"""Halvings of a step that leaves the workspace: 1e-9 of the step is left."""


def silent(_what: str, _share: float) -> None:
    """Report no progress."""


class WorkspaceError(ModelError):
    """A workspace that has no beginning: home, or a pose asked for, lies outside the limits.

    Attributes
    ----------
    problems : tuple of str
        One for each limit that does not hold.
    """

    def __init__(self, where: str, problems: tuple[str, ...]) -> None:
        super().__init__(f"{where}: " + "; ".join(problems))
        self.problems = problems


@dataclass(frozen=True)
class Limits:
    """What a reachable pose has to keep. None: this limit is not looked at."""

    length_min: float
    """m, each leg."""
    length_max: float
    """m, each leg."""
    force: float | None = None
    """N, each leg, to hold platform, legs and payload still."""
    condition: float = 1e9
    """Bound on the condition of J as `hil.mathematics.linear_algebra.condition_kernel` has it, which is what
    the controller watches. Crossing a singularity (det J = 0) counts as leaving at any value."""
    base_angle: float | None = None
    """rad, of each leg to the axis of its base joint."""
    platform_angle: float | None = None
    """rad, of each leg to the axis of its platform joint."""
    leg_diameter: float | None = None
    """m; the axes of two legs stay further apart. Pairs whose joints lie closer than that at either end are
    built to meet and are not looked at."""


class Surveyor:
    """Looks at poses: figures of each, and whether it keeps the limits.

    Parameters
    ----------
    platform : Platform
    limits : Limits
    home_p : (3,) m, home_R : (3, 3)
        Home, where every path begins.
    base_axes : (6, 3), platform_axes : (6, 3)
        Axes of the joints: directions from base to platform, in the base and in the platform frame; any
        length. Default: each leg's own direction at home.
    payload : kg, on the platform at ``payload_at`` (3,) m, platform frame.

    Raises
    ------
    WorkspaceError
        Where home is outside the limits; all that do not hold, with their values.
    GeometryError, KinematicsError
        Where an argument is no direction, no vector or no rotation.
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
            raise WorkspaceError(f"home, p = {self.p.tolist()} m, is outside the limits", problems)

    def survey(self, P: Array, R: Array) -> Array:
        """Return the figures of poses, (n, 27): columns of `hil.study.workspace.kernels`.

        P (n, 3) or (3,) m; R (n, 3, 3), or (3, 3) for all.
        """
        P = np.ascontiguousarray(P, np.float64).reshape(-1, 3)
        RR = np.ascontiguousarray(np.broadcast_to(R, (len(P), 3, 3))).reshape(-1, 9)
        out = np.empty((len(P), kernels.COLUMNS))
        survey_kernel(
            self._constants,
            self.payload,
            self.base_axes,
            self.platform_axes,
            self._watched,
            self.platform.radius,
            P,
            RR,
            out,
        )
        return out

    def margins(self, figures: Array) -> Array:
        """Return (n, 5), one column of KINDS each: >= 0 where the limit holds, inf where there is none.

        Stroke in shares of the stroke; joint angle as difference of cosines; force and condition in shares
        of the limit; interference in shares of the diameter. -1 beyond a singularity.
        """
        m = np.full((len(figures), len(KINDS)), np.inf)
        lim = self.limits
        q = figures[:, kernels.LENGTH : kernels.LENGTH + 6]
        stroke = lim.length_max - lim.length_min
        m[:, 0] = np.minimum(q - lim.length_min, lim.length_max - q).min(axis=1) / stroke
        for angle, first in (
            (lim.base_angle, kernels.BASE_COSINE),
            (lim.platform_angle, kernels.PLATFORM_COSINE),
        ):
            if angle is not None:
                cosine = figures[:, first : first + 6].min(axis=1)
                m[:, 1] = np.minimum(m[:, 1], cosine - np.cos(angle))
        regular = figures[:, kernels.ORIENTATION] == self.orientation
        if lim.force is not None:
            tau = np.abs(figures[:, kernels.FORCE : kernels.FORCE + 6]).max(axis=1)
            m[:, 2] = np.where(np.isnan(tau), np.inf, 1.0 - tau / lim.force)
        m[:, SINGULARITY] = np.where(regular, 1.0 - figures[:, kernels.CONDITION] / lim.condition, -1.0)
        if lim.leg_diameter is not None:
            m[:, 4] = figures[:, kernels.CLEARANCE] / lim.leg_diameter - 1.0
        m[np.isnan(m)] = -1.0  # a leg of length zero has no direction
        return m

    def inside(self, P: Array, R: Array, what: str = "", progress: Progress = silent) -> Flags:
        """Return (n,): whether each pose keeps all limits and lies on home's side of det J = 0."""
        found: Flags = np.ones(len(P), np.bool_)
        for k in range(0, len(P), CHUNK):
            progress(what, k / len(P))
            part = R if R.ndim == 2 else R[k : k + CHUNK]
            found[k : k + CHUNK] = (self.margins(self.survey(P[k : k + CHUNK], part)) >= 0).all(axis=1)
        return found

    def leave(
        self, poses: Callable[[Array], tuple[Array, Array]], low: Array, high: Array
    ) -> tuple[Array, Ints]:
        """Find where paths leave the workspace, by bisection.

        poses(t (n,)) -> P (n, 3), R: path k at its parameter t[k]; inside at low (n,), outside at high (n,).
        Returns t (n,), the last parameter inside, and the kind (n,) of the limit met there.
        """
        low, high = low.copy(), high.copy()
        for _ in range(BISECTIONS):
            t = 0.5 * (low + high)
            good = self.inside(*poses(t))
            low = np.where(good, t, low)
            high = np.where(good, high, t)
        return low, self.kinds(*poses(high))

    def kinds(self, P: Array, R: Array) -> Ints:
        """Return (n,): the first kind of limit that each of these poses breaks."""
        kinds: Ints = np.argmax(self.margins(self.survey(P, R)) < 0, axis=1)
        return kinds

    def dexterity(self, P: Array, R: Array) -> tuple[Array, Array]:
        """Return condition number (n,) and smallest singular value (n,) of J diag(1, 1, 1, 1/r, 1/r, 1/r).

        r is ``platform.radius``, so that all columns count displacements of the platform joints' circle and
        both figures have no unit. The smallest singular value is the measure of singularity: the least rate
        of the legs together for a unit rate of the platform; its reciprocal bounds the leg forces that a
        unit load can cause. The condition number is the 2-norm's (Merlet, Parallel Robots, 2006, 5.5).
        """
        a, b = self.platform.base_joints, self.platform.platform_joints
        R = np.ascontiguousarray(np.broadcast_to(R, (len(P), 3, 3)))
        sigma = np.empty((len(P), 6))
        scaling = np.array([1.0, 1.0, 1.0, *[1.0 / self.platform.radius] * 3])
        for k in range(0, len(P), CHUNK):
            J = [jacobian_kernel(a, b, p, r) for p, r in zip(P[k : k + CHUNK], R[k : k + CHUNK], strict=True)]
            sigma[k : k + CHUNK] = np.linalg.svd(np.array(J) * scaling, compute_uv=False)
        return sigma[:, 0] / sigma[:, 5], sigma[:, 5]

    def largest_payload(self) -> float:
        """Return the mass (kg) at the payload's place, its own included, that the legs can hold at home.

        inf without limit.
        """
        limit = self.limits.force
        if limit is None:
            return np.inf
        still = np.zeros(6)
        g = self.platform.gravity
        load = np.concatenate([g, np.cross(self.R @ self.payload[1:], g)])
        model = Model(self.platform)
        empty = model.inverse_dynamics(self.p, self.R, still, still)
        slope = model.inverse_dynamics(self.p, self.R, still, still, load) - empty  # N per kg
        room = np.where(slope > 0, limit - empty, -limit - empty)
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.min(np.where(slope != 0, room / slope, np.inf)))

    def _problems(self, figures: Array) -> tuple[str, ...]:
        lim = self.limits
        row = figures[0]
        broken = self.margins(figures)[0] < 0
        q = row[kernels.LENGTH : kernels.LENGTH + 6]
        tau = row[kernels.FORCE : kernels.FORCE + 6]
        angles = [
            f"{name} joint up to {np.rad2deg(np.arccos(np.clip(row[k : k + 6], -1, 1))).max():.2f} deg "
            f"from its axis (allowed {np.rad2deg(angle):g})"
            for name, k, angle in (
                ("base", kernels.BASE_COSINE, lim.base_angle),
                ("platform", kernels.PLATFORM_COSINE, lim.platform_angle),
            )
            if angle is not None
        ]
        stroke = f"{lim.length_min:g} to {lim.length_max:g}"
        texts = (
            f"leg lengths {q.min():.4f} to {q.max():.4f} m (allowed {stroke})",
            ", ".join(angles),
            f"static leg force {np.abs(tau).max():.1f} N (allowed {lim.force:g})"
            if lim.force is not None
            else "",
            f"condition of J {row[kernels.CONDITION]:.4g} (allowed {lim.condition:g})",
            f"legs {row[kernels.CLEARANCE]:.4f} m apart (allowed more than {lim.leg_diameter} m)",
        )
        return tuple(text for text, bad in zip(texts, broken, strict=True) if bad)


def _distinct(platform: Platform, diameter: float) -> Array:
    """Return (6, 6): 1 where two legs have joints further apart than the diameter at both ends."""
    apart = np.ones((6, 6))
    for joints in (platform.base_joints, platform.platform_joints):
        apart *= np.linalg.norm(joints[:, None] - joints[None, :], axis=2) > diameter
    return apart
