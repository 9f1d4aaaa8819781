"""Emulated sensors, compiled: reception of SYNC, the pose between two grid points, bias and noise."""

from math import asin, atan2, pi
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, REAL, VECTOR, helper, kernel, record
from drivers.compiled.pointed import pointed, reals_at, record_at
from drivers.frame_array import FRAME
from drivers.frame_pointers import frame_at
from drivers.legs.crc import intact
from drivers.legs.kernels import STRANGE
from drivers.rotations import rotation_vector_kernel, times, turn
from drivers.sensing.kernels import put_sample, rows_at, slots_at
from drivers.sensing.layout import (
    FORCE,
    IMU,
    INCLINATION,
    LENGTH,
    QUANTITIES,
    SENSORS,
    SLOTS,
    STAMPED,
    TRACKER,
    WRENCH,
)
from drivers.signals import LEGS

SENSED = np.dtype(
    [
        *((name, "<i8") for name in ("sensors", "wrench", "length", "rate", "force")),
        *((name, "<i8") for name in ("sync_id", "start_ns", "before_ns")),
        *((name, "<i8", (SLOTS,)) for name in ("bus", "heard_ns", "cycle", "turns")),
        *((name, "<f8", (SLOTS, QUANTITIES)) for name in ("bias", "noise", "drift")),
        ("frame", "<f8", (SLOTS, 3, 3)),
        ("lever", "<f8", (SLOTS, 3)),
        ("target", "<f8", (3, 3)),
        *((name, "<f8", (QUANTITIES,)) for name in ("drawn", "values")),
        *((name, "<f8", (3,)) for name in ("gravity", "before", "acceleration")),
    ]
)
"""Emulated sensors. Addresses of SENSORS, of the wrench (6,) N, N m on the platform, of lengths (6,) m, rates
(6,) m/s and forces (6,) N of the legs; identifier of SYNC; begin of the drift; instant of the velocity
`before`. By slot: bus; reception and counter of the last SYNC on it; bias, standard deviation of the noise,
and drift per second (angles of the tracker in degrees); rotation to the sensor's frame, used if `turns`;
place of the sensor on the platform, m; rotation from the tracker's target to the platform. Random
numbers drawn, measured values; gravity m/s^2, velocity m/s at `before_ns`, acceleration m/s^2 of the IMU."""
SILENT = 1
"""Status of `measure`: the last SYNC is too long ago for a time stamp relative to it."""
_LONGEST_STAMP_S = 0.0655
_sensors_at: Any = record_at(record(SENSORS))


@helper
def carried(p: Array, R: Array, twist: Array, dt_s: float) -> tuple[Array, Array]:
    """Position (3,) m and rotation (3, 3) after `dt_s` at a constant twist (6,), base frame."""
    return p + dt_s * twist[:3], turn(dt_s * twist[3:], R)


@helper
def cross3(u: Array, v: Array) -> Array:
    """Cross product of two vectors (3,)."""
    return np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


@pointed(record(SENSED), INTEGER)
def listen(n: Any, frame_address: int) -> int:
    """Store the time and counter of a SYNC; other frames and damaged ones are ignored."""
    frame = frame_at(frame_address)
    is_sync = np.int64(frame.id) == n.sync_id and not frame.flags & STRANGE and frame.length == 2
    if is_sync and intact(frame):
        for slot in range(SLOTS):
            if frame.bus == n.bus[slot]:
                n.heard_ns[slot], n.cycle[slot] = frame.t_ns, frame.data[0]
    return 0


@helper
def velocity_at(lever: Array, R: Array, twist: Array) -> Array:
    """Velocity (3,) m/s, base frame, of the point `lever` (3,) m of a platform with R and `twist`."""
    return twist[:3] + cross3(twist[3:], times(R, lever))


@helper
def _on_platform(n: Any, slot: int, R: Array, turned: Array, twist: Array, grid_ns: int) -> None:
    """Fill the values of IMU and wrench sensor, in the sensor's frame."""
    v, lever = n.values, n.lever[slot]
    if slot == IMU:
        if grid_ns > n.before_ns:
            velocity = velocity_at(lever, R, twist)
            n.acceleration[:] = (velocity - n.before) / ((grid_ns - n.before_ns) * 1e-9)
        v[:3], v[3:] = twist[3:], n.acceleration - n.gravity
    else:
        v[:] = reals_at(n.wrench, QUANTITIES)
        v[3:] -= cross3(times(turned, lever), v[:3])
    for k in (0, 3):
        x, y, z = v[k], v[k + 1], v[k + 2]
        for i in range(3):
            v[k + i] = turned[0, i] * x + turned[1, i] * y + turned[2, i] * z
        if n.turns[slot]:
            x, y, z, F = v[k], v[k + 1], v[k + 2], n.frame[slot]
            for i in range(3):
                v[k + i] = F[0, i] * x + F[1, i] * y + F[2, i] * z


@kernel(record(SENSED), INTEGER, INTEGER, INTEGER, VECTOR, MATRIX, VECTOR)
def measure(n: Any, slot: int, t_ns: int, grid_ns: int, p: Array, R: Array, twist: Array) -> int:
    """Fill the measured values at `t_ns`, given the truth at the grid point; 0 or SILENT."""
    dt_s = (t_ns - grid_ns) * 1e-9
    there, turned = carried(p, R, twist, dt_s)
    bias, noise, v = n.bias[slot].copy(), n.noise[slot] * n.drawn, n.values
    for k in range(QUANTITIES):
        if n.drift[slot, k] != 0.0:
            bias[k] += n.drift[slot, k] * (t_ns - n.start_ns) * 1e-9
    if slot == TRACKER:
        there = there + times(turned, n.lever[slot])
        if n.turns[slot]:
            there = times(n.frame[slot], there)
            for k in range(3):
                turned[:, k] = times(n.frame[slot], turned[:, k])
        for i in range(3):
            turned[i, :] = times(n.target.T, turned[i, :])
        v[:3] = there + bias[:3] + noise[:3]
        v[3:] = rotation_vector_kernel(turn((bias[3:] + noise[3:]) * (pi / 180.0), turned))
    else:
        if slot in (IMU, WRENCH):
            _on_platform(n, slot, R, turned, twist, grid_ns)
        elif slot == INCLINATION:
            v[0], v[1] = atan2(turned[2, 1], turned[2, 2]), asin(-turned[2, 0])
        elif slot < FORCE:
            leg = slot - LENGTH
            v[0] = reals_at(n.length, LEGS)[leg] + reals_at(n.rate, LEGS)[leg] * dt_s
        else:
            v[0] = reals_at(n.force, LEGS)[slot - FORCE]
        for k in range(QUANTITIES):
            v[k] = v[k] + bias[k] + noise[k]
    stamped = slots_at(_sensors_at(n.sensors).slots, SLOTS)[slot].timing == STAMPED
    return SILENT if stamped and (t_ns - n.heard_ns[slot]) * 1e-9 > _LONGEST_STAMP_S else 0


@kernel(record(SENSED), INTEGER, INTEGER, INTEGER, REAL, VECTOR, record(FRAME))
def fill_frame(n: Any, row: int, counter: int, t_ns: int, late_s: float, raw: Array, frame: Any) -> int:
    """Fill in the frame of a message with the quantities of its fields, measured at `t_ns`; 0 or FAILED.

    late_s: error of its time stamp.
    """
    s = _sensors_at(n.sensors)
    of = rows_at(s.rows, s.size)[row]
    offset_s = (t_ns - n.heard_ns[of.slot]) * 1e-9
    if slots_at(s.slots, SLOTS)[of.slot].timing != STAMPED:
        offset_s = max(0.0, 1e-9 * t_ns + late_s)  # by its own clock, in frames with a field for it
    elif late_s != 0.0:
        offset_s = max(0.0, offset_s + late_s)
    return put_sample(of, raw, n.cycle[of.slot], offset_s, counter, frame)
