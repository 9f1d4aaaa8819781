"""What every trajectory gives, and the step from a six-word path to it.

The six words chi = (x, y, z, rx, ry, rz) are the position in m and the rotation vector in rad of the platform
frame in the base frame.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import OUT_MATRIX, OUT_VECTOR, helper
from drivers.errors import ConfigurationError
from hil.config.reference import AxisLimits, Waypoint
from hil.config.values import Pose
from hil.mathematics.rotations import rotation_motion
from hil.mathematics.vectors import at

SAMPLE = (OUT_VECTOR, OUT_MATRIX, OUT_VECTOR, OUT_VECTOR)
"""The arguments of a kernel that fills p, R, twist, dtwist: returning them would cost 0.3 us each."""


class PoseSample(NamedTuple):
    """Pose and motion of the platform at one instant, base frame. Arrays are read-only to every reader."""

    p: Array
    """(3,) m, platform origin."""
    R: Array
    """(3, 3), x_base = p + R x_platform."""
    twist: Array
    """(6,) m/s, rad/s: [v of the platform origin; omega]."""
    dtwist: Array
    """(6,) m/s^2, rad/s^2."""


SAMPLE_RECORD = np.dtype(
    [("p", "<f8", (3,)), ("R", "<f8", (3, 3)), ("twist", "<f8", (6,)), ("dtwist", "<f8", (6,))]
)
"""A `PoseSample` as a record."""


def blank() -> PoseSample:
    """Return a sample that a kernel can fill."""
    return PoseSample(np.empty(3), np.empty((3, 3)), np.empty(6), np.empty(6))


class Trajectory(Protocol):
    """A path in time. No state: the same t gives the same bits."""

    @property
    def duration_s(self) -> float | None:
        """Length in s; None goes on until stopped."""

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s). Outside [0, duration] the nearest end pose, at rest."""


@helper
def lift(chi: Array, dchi: Array, ddchi: Array, p: Array, R: Array, twist: Array, dtwist: Array) -> None:
    """Fill p, R, twist, dtwist of a six-word path with value chi, first and second derivative."""
    omega, domega = rotation_motion(at(chi, 3), at(dchi, 3), at(ddchi, 3), R)
    for i in range(3):
        p[i] = chi[i]
        twist[i], twist[3 + i] = dchi[i], omega[i]
        dtwist[i], dtwist[3 + i] = ddchi[i], domega[i]


@helper
def quintic(u: float) -> tuple[float, float, float]:
    """Scaling s = 10 u^3 - 15 u^4 + 6 u^5 with ds/du, d2s/du2: 0 to 1, at rest without acceleration."""
    s = u * u * u * (10.0 + u * (-15.0 + 6.0 * u))
    ds = 30.0 * u * u * (1.0 + u * (-2.0 + u))
    dds = 60.0 * u * (1.0 + u * (-3.0 + 2.0 * u))
    return s, ds, dds


def six_words(pose: Pose | Waypoint) -> Array:
    """Return chi (6,) of a configured pose: m and rad."""
    return np.concatenate([np.asarray(pose.position_m, float), np.deg2rad(pose.rotation_vector_deg)])


def checked_words(pose: Pose | Waypoint, where: str) -> Array:
    """As `six_words`. Raises ConfigurationError for a turn of more than a half; `where` is the pose's key."""
    chi = six_words(pose)
    require_half_turn(float(np.linalg.norm(chi[3:])), f"{where}.rotation_vector_deg")
    return chi


def axis_limits(limits: AxisLimits) -> Array:
    """Return (3, 6): largest velocity, acceleration and jerk of the six words, in m and rad."""

    def words(linear: float | tuple[float, ...], angular: float | tuple[float, ...]) -> Array:
        return np.concatenate([np.broadcast_to(linear, 3), np.deg2rad(np.broadcast_to(angular, 3))])

    return np.array(
        [
            words(limits.velocity_m_s, limits.velocity_deg_s),
            words(limits.acceleration_m_s2, limits.acceleration_deg_s2),
            words(limits.jerk_m_s3, limits.jerk_deg_s3),
        ]
    )


def words_of_points(points: Sequence[Pose | Waypoint]) -> Array:
    """Return chi (n, 6) of `reference.points`. Raises ConfigurationError for a turn of more than a half."""
    return np.array([checked_words(point, f"reference.points[{k}]") for k, point in enumerate(points)])


def require_half_turn(angle: float, where: str) -> None:
    """Refuse a rotation vector longer than half a turn: no platform turns so far, and the series end there.

    angle in rad. Raises ConfigurationError.
    """
    if angle > np.pi:
        raise ConfigurationError(
            f"{where}: the rotation vector reaches {np.rad2deg(angle):.6g} deg; at most 180 deg is allowed. "
            "It is given in degrees, as axis times angle."
        )
