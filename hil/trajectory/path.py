"""The interface of a trajectory, its C function, and the conversion of pose coordinates to a sample.

A trajectory of this project is a C function of a record that it owns: `callee`. A trajectory in plain Python
is wrapped in a callback of the same signature, see `callee_of`.

The pose coordinates chi = (x, y, z, rx, ry, rz) are the position in m and the rotation vector in rad of the
platform frame in the base frame.
"""

import ctypes
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import INTEGER, REAL, VECTOR, helper, kernel, record, records
from drivers.compiled.pointed import (
    FAILED,
    Callee,
    address_of,
    call,
    context_of,
    data_at,
    of_python,
    pointed,
    record_at,
)
from drivers.errors import ConfigurationError
from drivers.tick_columns import Record
from hil.config.reference import AxisLimits, Waypoint
from hil.config.values import Pose
from hil.mathematics.rotations import rotation_motion
from hil.mathematics.vectors import at

SAMPLE = np.dtype([("p", "<f8", 3), ("R", "<f8", (3, 3)), ("twist", "<f8", 6), ("dtwist", "<f8", 6)])
"""Layout of a `PoseSample`, which a trajectory's C function `(context, t, into)` fills."""


sample_at = record_at(record(SAMPLE))


class PoseSample(NamedTuple):
    """Pose and motion of the platform at one instant, base frame. Readers must not change the arrays."""

    p: Array
    """(3,) m, platform origin."""
    R: Array
    """(3, 3), x_base = p + R x_platform."""
    twist: Array
    """(6,) m/s, rad/s: [v of the platform origin; omega]."""
    dtwist: Array
    """(6,) m/s^2, rad/s^2."""


def of_record(sample: Record) -> PoseSample:
    """Pose, twist and dtwist of a record with the fields of SAMPLE, as views of its memory."""
    return PoseSample(sample["p"], sample["R"], sample["twist"], sample["dtwist"])


class Trajectory(Protocol):
    """A motion of the platform as a function of time, without a state: equal t give equal bits."""

    @property
    def duration_s(self) -> float | None:
        """Length of the motion, s; None for a motion without an end."""

    def sample(self, t: float) -> PoseSample:
        """Pose and motion at t (s); outside 0 .. duration the nearest end pose, at rest."""


class CompiledTrajectory:
    """A trajectory that is a C function of a record; a subclass sets `callee`, the address of both."""

    callee: Callee

    def sample(self, t: float) -> PoseSample:
        """Pose and motion at t (s); outside 0 .. duration the nearest end pose, at rest."""
        return sampled_by(self.callee, t)


@pointed(record(SAMPLE), REAL, record(SAMPLE))
def kept(sample: Any, _t: float, into: Any) -> int:
    """Fill `into` with a stored sample at every t: the function of a trajectory at rest."""
    for i in range(3):
        into.p[i] = sample.p[i]
        for j in range(3):
            into.R[i, j] = sample.R[i, j]
    for i in range(6):
        into.twist[i], into.dtwist[i] = sample.twist[i], sample.dtwist[i]
    return 0


class HoldTrajectory(CompiledTrajectory):
    """Rest at the pose p (3,) m, R (3, 3), base frame, for `duration_s`, or without an end if it is None."""

    def __init__(self, p: Array, R: Array, duration_s: float | None = None) -> None:
        self.duration_s = duration_s
        pose = context_of(SAMPLE, p=p, R=R, twist=ZERO6, dtwist=ZERO6)
        self.callee = Callee(kept.address, data_at(pose), pose)


class _Callback:
    """C callback that samples a trajectory written in plain Python. `error`: its last exception."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self.error: BaseException | None = None
        self.address, self._callback = of_python(self._sample, INTEGER, REAL, INTEGER)

    def _sample(self, _context: int, t: float, where: int) -> int:
        memory: Any = (ctypes.c_double * (SAMPLE.itemsize // 8)).from_address(where)
        np.frombuffer(memory)[:] = np.nan
        try:
            for into, part in zip(
                of_record(np.ndarray((), SAMPLE, memory)), self._trajectory.sample(t), strict=True
            ):
                into[:] = part
        except BaseException as error:  # noqa: BLE001 - nothing can be raised through machine code
            np.frombuffer(memory)[:] = np.nan
            self.error = error
            return FAILED
        return 0


def callee_of(trajectory: Trajectory) -> Callee:
    """C function of a trajectory, with its context: compiled code samples the trajectory through it.

    If a trajectory in plain Python raises, the status is FAILED, the sample nan, and `failure` gives the
    exception.
    """
    own = getattr(trajectory, "callee", None)
    if isinstance(own, Callee):
        return own
    callback = _Callback(trajectory)
    return Callee(callback.address, 0, callback)


def failure(keeps: Any) -> BaseException | None:
    """Last exception of a trajectory in plain Python, found among the objects that a Callee keeps alive."""
    if isinstance(keeps, _Callback):
        return keeps.error
    if isinstance(keeps, tuple):
        return next(filter(None, map(failure, keeps)), None)
    return None


def sampled_by(callee: Callee, t: float) -> PoseSample:
    """Sample at t (s) in new arrays. Raises what a trajectory in plain Python raises."""
    into = np.ndarray((), SAMPLE)
    require(_by_address(callee.address, callee.context, t, into), callee)
    return of_record(into)


def require(status: int, callee: Callee) -> None:
    """If a trajectory's C function returned FAILED, raise the exception of its Python code."""
    if status < 0:
        raise failure(callee) or RuntimeError("a trajectory's function gave no sample")


def samples(trajectory: Trajectory, t: Array) -> np.ndarray[Any, np.dtype[np.void]]:
    """Samples (n,) of SAMPLE at t (n,) s. Raises what a trajectory in plain Python raises."""
    callee, into = callee_of(trajectory), np.empty(len(t), SAMPLE)
    require(_all_by_address(callee.address, callee.context, t, into), callee)
    return into


@kernel(INTEGER, INTEGER, VECTOR, records(SAMPLE))
def _all_by_address(function: int, context: int, t: Array, into: Any) -> int:
    status: int = 0
    for k in range(len(t)):
        status = min(status, call(function, (context, t[k], address_of(into[k]))))
    return status


@kernel(INTEGER, INTEGER, REAL, record(SAMPLE))
def _by_address(function: int, context: int, t: float, into: Any) -> int:
    status: int = call(function, (context, t, address_of(into)))
    return status


@helper
def lift(chi: Array, dchi: Array, ddchi: Array, into: Any) -> None:
    """Fill a SAMPLE from pose coordinates chi (6,) m, rotation vector in rad, and their two derivatives."""
    omega, domega = rotation_motion(at(chi, 3), at(dchi, 3), at(ddchi, 3), into.R)
    for i in range(3):
        into.p[i] = chi[i]
        into.twist[i], into.twist[3 + i] = dchi[i], omega[i]
        into.dtwist[i], into.dtwist[3 + i] = ddchi[i], domega[i]


@helper
def quintic(u: float) -> tuple[float, float, float]:
    """Path share s = 10 u^3 - 15 u^4 + 6 u^5 with ds/du, d2s/du2: from 0 to 1, derivatives 0 at the ends."""
    s = u * u * u * (10.0 + u * (-15.0 + 6.0 * u))
    ds = 30.0 * u * u * (1.0 + u * (-2.0 + u))
    dds = 60.0 * u * (1.0 + u * (-3.0 + 2.0 * u))
    return s, ds, dds


def pose_coordinates(pose: Pose | Waypoint) -> Array:
    """Pose coordinates chi (6,) of a configured pose: position, m, and rotation vector, rad."""
    return np.concatenate([np.asarray(pose.position_m, float), np.deg2rad(pose.rotation_vector_deg)])


def checked_coordinates(pose: Pose | Waypoint, where: str) -> Array:
    """Coordinates chi (6,) m, rad of `pose`; ConfigurationError at key `where` for more than half a turn."""
    chi = pose_coordinates(pose)
    require_half_turn(float(np.linalg.norm(chi[3:])), f"{where}.rotation_vector_deg")
    return chi


def axis_limits(limits: AxisLimits) -> Array:
    """Limits (3, 6): largest velocity, acceleration, jerk of position (m) and rotation vector (rad)."""

    def six(linear: float | tuple[float, ...], angular: float | tuple[float, ...]) -> Array:
        return np.concatenate([np.broadcast_to(linear, 3), np.deg2rad(np.broadcast_to(angular, 3))])

    return np.array(
        [
            six(limits.velocity_m_s, limits.velocity_deg_s),
            six(limits.acceleration_m_s2, limits.acceleration_deg_s2),
            six(limits.jerk_m_s3, limits.jerk_deg_s3),
        ]
    )


def coordinates_of_points(points: Sequence[Pose | Waypoint]) -> Array:
    """Coordinates chi (n, 6) m, rad of `reference.points`; ConfigurationError for more than half a turn."""
    return np.array([checked_coordinates(point, f"reference.points[{k}]") for k, point in enumerate(points)])


def require_half_turn(angle: float, where: str) -> None:
    """Raise ConfigurationError, with the key `where`, for a rotation angle, rad, of more than half a turn.

    No platform turns so far, and the power series of the rotations hold for a limited angle.
    """
    if angle > np.pi:
        raise ConfigurationError(
            f"{where}: the rotation vector reaches {np.rad2deg(angle):.6g} deg; at most 180 deg is allowed. "
            "It is given in degrees, as axis times angle."
        )
