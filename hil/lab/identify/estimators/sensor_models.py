"""What a sensor would report for a known motion of platform and legs, by calibration parameters.

Parameters are scaled by their sizes: a direction whose standard error exceeds 1 is not determined.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.arrays import Array
from hil.lab.identify.estimators.leg_motion import PlatformMotion

DEG = 180.0 / np.pi


class Parameter(NamedTuple):
    """Some unknowns of a sensor: key, unit as printed, factor from SI to it, size in SI, number, start."""

    key: str
    unit: str
    factor: float
    size: float
    number: int = 3
    start: float = 0.0


class At(NamedTuple):
    """Motion at the m instants of a sensor's samples: (m, 3) in the base frame, SI; (m, 6) of each leg."""

    p: Array
    R: Rotation
    w: Array
    dw: Array
    a: Array
    q: Array
    force: Array


def motion_at(motion: PlatformMotion, t_s: Array, period_s: float) -> At:
    """Motion at instants (m, 1), or (m, 6) of each leg, in seconds after the first tick.

    Each is a polynomial from the nearest tick; the platform is that of the first column.
    """
    row = np.clip(np.rint(t_s / period_s).astype(np.int64), 1, len(motion.p) - 2)
    after = t_s - row * period_s
    leg, n, t = np.arange(6), row[:, 0], after[:, :1]
    v, dv = motion.twist[n], motion.dtwist[n]
    x = v * t + 0.5 * dv * t * t
    acceleration = dv + (motion.dtwist[n + 1] - motion.dtwist[n - 1]) * (0.5 / period_s) * t
    q, dq, ddq = (each[row, leg] for each in (motion.q, motion.dq, motion.ddq))
    return At(
        motion.p[n] + x[:, :3],
        Rotation.from_rotvec(x[:, 3:]) * Rotation.from_matrix(motion.R[n]),
        v[:, 3:] + dv[:, 3:] * t,
        acceleration[:, 3:],
        acceleration[:, :3],
        q + dq * after + 0.5 * ddq * after * after,
        motion.force[row, leg] + motion.dforce[row, leg] * after,
    )


class SensorModel(NamedTuple):
    """Model of one role: its unknowns, and the residual by a motion and unknowns."""

    parameters: tuple[Parameter, ...]
    residual: Callable[[At, Array, Array, Array], Array]
    """(motion, values (m, k), unknowns after the time offset, gravity (3,)) -> (m, r) residuals in SI."""

    @property
    def size(self) -> Array:
        """Sizes of all unknowns."""
        return np.concatenate([np.full(each.number, each.size) for each in self.parameters])

    @property
    def start(self) -> Array:
        """Unknowns of a perfect sensor."""
        return np.concatenate([np.full(each.number, each.start) for each in self.parameters])


def _tracker(at: At, y: Array, x: Array, _gravity: Array) -> Array:
    """Position T + B (p + R a), Y = B R C; the rotation's residual in the tracker's axes."""
    B, C = Rotation.from_rotvec(x[3:6]), Rotation.from_rotvec(x[9:12])
    position = x[:3] + B.apply(at.p + at.R.apply(x[6:9]))
    turned = Rotation.from_rotvec(y[:, 3:]) * (B * at.R * C).inv()
    return np.hstack([y[:, :3] - position, turned.as_rotvec()])


def _imu(at: At, y: Array, x: Array, gravity: Array) -> Array:
    """Rate F^T R^T w + b, specific force F^T R^T (a + dw x r + w x (w x r) - g) + b, r = R lever."""
    F, r = Rotation.from_rotvec(x[:3]), at.R.apply(x[3:6])
    force = at.a + np.cross(at.dw, r) + np.cross(at.w, np.cross(at.w, r)) - gravity
    to_sensor = (at.R * F).inv()
    return np.hstack([y[:, :3] - to_sensor.apply(at.w) - x[6:9], y[:, 3:] - to_sensor.apply(force) - x[9:12]])


def _inclination(at: At, y: Array, x: Array, _gravity: Array) -> Array:
    """Roll and pitch of R, plus offsets."""
    M = at.R.as_matrix()
    angles = np.column_stack([np.arctan2(M[:, 2, 1], M[:, 2, 2]), np.arcsin(-M[:, 2, 0])])
    return np.asarray(y[:, :2] - angles - x, np.float64)


def _linear(name: str) -> Callable[[At, Array, Array, Array], Array]:
    return lambda at, y, x, _gravity: y - x[:6] * getattr(at, name) - x[6:12]


_TIME = Parameter("time_offset_ms", "ms", 1e3, 2e-3, 1)
_FRAME = Parameter("frame_rotation_deg", "deg", DEG, 1.0 / DEG)
_LEVER = Parameter("lever_arm_m", "m", 1.0, 0.01)
_ORIGIN = Parameter("frame_position_m", "m", 1.0, 0.01)
_TARGET = Parameter("target_rotation_deg", "deg", DEG, 1.0 / DEG)
_RATE = Parameter("angular_rate_bias_rad_s", "rad/s", 1.0, 0.02)
_FORCE = Parameter("specific_force_bias_m_s2", "m/s^2", 1.0, 0.5)
_OFFSET = Parameter("offset_deg", "deg", DEG, 1.0 / DEG, 2)
MODELS: dict[str, SensorModel] = {
    "tracker": SensorModel((_TIME, _ORIGIN, _FRAME, _LEVER, _TARGET), _tracker),
    "imu": SensorModel((_TIME, _FRAME, _LEVER, _RATE, _FORCE), _imu),
    "inclination": SensorModel((_TIME, _OFFSET), _inclination),
    "lengths": SensorModel(
        (_TIME, Parameter("scale", "", 1.0, 0.01, 6, 1.0), Parameter("offset_m", "m", 1.0, 0.01, 6)),
        _linear("q"),
    ),
    "forces": SensorModel(
        (_TIME, Parameter("scale", "", 1.0, 0.3, 6, 1.0), Parameter("offset_N", "N", 1.0, 100.0, 6)),
        _linear("force"),
    ),
}
"""Model of each role; a wrench sensor is missing, since the pose of the legs does not show its load."""
