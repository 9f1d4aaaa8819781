"""Emulated sensors in kernels: reception of SYNC, the pose between two time steps, bias and noise."""

from math import atan2, pi, sin, sqrt
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, VECTOR, helper, kernel, record
from drivers.compiled.pointed import pointed, reals_at, record_at
from drivers.frame_array import FRAME
from drivers.frame_pointers import frame_at
from drivers.legs.kernels import STRANGE, intact
from drivers.sensor_kernels import IMU, QUANTITIES, SENSORS, TRACKER, put_sample

SENSED = np.dtype(
    [
        *((name, "<i8") for name in ("sensors", "wrench", "sync_id", "before_ns", "start_ns")),
        *((name, "<i8", (3,)) for name in ("heard_ns", "cycle", "late_ns")),
        *((name, "<f8", (3, QUANTITIES)) for name in ("bias", "noise")),
        *((name, "<f8", (QUANTITIES,)) for name in ("drawn", "values")),
        *((name, "<f8", (3,)) for name in ("gravity", "before", "acceleration", "drift", "stamped_s")),
    ]
)
"""Emulated sensors. Addresses of SENSORS and of the wrench (6,) N, N m on the platform; identifier of SYNC;
instants of the velocity `before` and of the start. By kind: reception and counter of the last SYNC on its
bus, latency in ns, bias and standard deviation of the noise (angles of the tracker in degrees). Random
numbers drawn, measured values; gravity m/s^2, velocity m/s at `before_ns`, acceleration m/s^2 of the IMU;
drift of the tracker m/s; by kind, error of the stamps s."""
SILENT = 1
"""Status of `measure`: the last SYNC is too long ago for a time stamp relative to it."""
_LONGEST_STAMP_S = 0.0655
_sensors_at: Any = record_at(record(SENSORS))
_SMALL = 1e-4
"""rad: below it the second term of a series is less than the last bit."""


@helper
def turn(r: Array, R: Array) -> Array:
    """exp([r]x) R by Rodrigues' formula; r (3,) rad."""
    angle = sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    if angle < _SMALL:
        a, b = 1.0 - angle * angle / 6.0, 0.5 - angle * angle / 24.0
    else:
        half = sin(0.5 * angle) / angle
        a, b = sin(angle) / angle, 2.0 * half * half
    found = np.empty((3, 3))
    for j in range(3):
        x, y, z = R[0, j], R[1, j], R[2, j]
        u, v, w = r[1] * z - r[2] * y, r[2] * x - r[0] * z, r[0] * y - r[1] * x
        found[0, j] = x + a * u + b * (r[1] * w - r[2] * v)
        found[1, j] = y + a * v + b * (r[2] * u - r[0] * w)
        found[2, j] = z + a * w + b * (r[0] * v - r[1] * u)
    return found


@helper
def carried(p: Array, R: Array, twist: Array, dt_s: float) -> tuple[Array, Array]:
    """Position (3,) m and rotation (3, 3) after `dt_s` s at a constant twist (6,); all in the base frame."""
    return p + dt_s * twist[:3], turn(dt_s * twist[3:], R)


@helper
def rotation_vector_of(r: Array, R: Array) -> Array:
    """Rotation vector (3,) rad of exp([r]x) R, norm <= pi, from its quaternion, largest component first."""
    M = turn(r, R)
    trace = M[0, 0] + M[1, 1] + M[2, 2]
    q = np.empty(4)
    i = 0
    for k in range(1, 3):
        if M[k, k] > M[i, i]:
            i = k
    if trace > M[i, i]:
        q[3] = 1.0 + trace
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            q[k] = M[b, a] - M[a, b]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 - trace + 2.0 * M[i, i]
        q[j], q[k] = M[j, i] + M[i, j], M[k, i] + M[i, k]
        q[3] = M[k, j] - M[j, k]
    if q[3] < 0.0:
        q *= -1.0
    sine = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    scale = 2.0 / q[3] if sine < _SMALL * _SMALL * q[3] else 2.0 * atan2(sine, q[3]) / sine
    return scale * q[:3]


@pointed(record(SENSED), INTEGER)
def listen(n: Any, frame_address: int) -> int:
    """Store the time and counter of a SYNC; other frames and damaged ones are ignored."""
    frame, s = frame_at(frame_address), _sensors_at(n.sensors)
    is_sync = np.int64(frame.id) == n.sync_id and not frame.flags & STRANGE and frame.length == 2
    if is_sync and intact(frame):
        for kind in range(3):
            if frame.bus == s.bus[kind]:
                n.heard_ns[kind], n.cycle[kind] = frame.t_ns, frame.data[0]
    return 0


@kernel(record(SENSED), INTEGER, INTEGER, INTEGER, INTEGER, VECTOR, MATRIX, VECTOR, record(FRAME))
def measure(
    n: Any, kind: int, counter: int, t_ns: int, grid_ns: int, p: Array, R: Array, twist: Array, frame: Any
) -> int:
    """Measure at `t_ns`, given pose and twist at the plant's last time step `grid_ns`, and fill in the frame.

    twist (6,) m/s, rad/s, base frame. Returns 0, SILENT if the last SYNC is too old, or FAILED for NaN.
    """
    there, turned = carried(p, R, twist, (t_ns - grid_ns) * 1e-9)
    bias, noise, v = n.bias[kind], n.noise[kind] * n.drawn, n.values
    if kind == TRACKER:
        v[:3] = there + bias[:3] + noise[:3] + n.drift * ((t_ns - n.start_ns) * 1e-9)
        v[3:] = rotation_vector_of((bias[3:] + noise[3:]) * (pi / 180.0), turned)
    else:
        if kind == IMU:
            if grid_ns > n.before_ns:
                n.acceleration[:] = (twist[:3] - n.before) / ((grid_ns - n.before_ns) * 1e-9)
            v[:3], v[3:] = twist[3:], n.acceleration - n.gravity
        else:
            v[:] = reals_at(n.wrench, QUANTITIES)
        for k in (0, 3):
            x, y, z = v[k], v[k + 1], v[k + 2]
            for i in range(3):
                seen = turned[0, i] * x + turned[1, i] * y + turned[2, i] * z
                v[k + i] = seen + bias[k + i] + noise[k + i]
    offset_s = (t_ns - n.heard_ns[kind]) * 1e-9 + n.stamped_s[kind]
    if offset_s > _LONGEST_STAMP_S:
        return SILENT
    frame.t_ns = t_ns + n.late_ns[kind]
    return put_sample(_sensors_at(n.sensors), kind, v, n.cycle[kind], offset_s, counter, frame)
