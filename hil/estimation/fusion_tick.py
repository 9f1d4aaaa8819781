"""One tick of the filter of `hil.estimation.fusion`: its interval, late samples, what becomes of the legs."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.apart import apart
from drivers.compiled.compiler import INTEGER, direct, helper, record
from drivers.compiled.pointed import integers_at, matrix_at, pointed, reals_at
from drivers.sensor_kernels import IMU, SENSORS, TRACKER, samples_of
from drivers.signals import LEGS, DriveState, Fault, Warn
from drivers.tick_columns import TICK
from hil.estimation import fusion_layout as k
from hil.estimation.fusion_kernels import fill_estimate, rerun_kernel
from hil.estimation.fusion_predict import accelerate_kernel
from hil.mathematics.rotations import rotation_motion_kernel
from hil.robot.dynamics_kernels import SIZE

FUSION = np.dtype(
    [
        ("base_joints", "<f8", (6, 3)), ("platform_joints", "<f8", (6, 3)), ("radius", "<f8"),
        ("period_s", "<f8"), ("slip_m", "<f8"), ("patience", "<f8", (2,)),
        ("constants", "<i8"), ("code", "<i8"), ("noise", "<i8"),
        ("states", "<i8"), ("covariances", "<i8"), ("intervals", "<i8"), ("ticks", "<i8"), ("latched", "<i8"),
        ("size", "<i8"), ("errors", "<i8"), ("newest", "<i8"), ("count", "<i8"),
        ("may_lose", "<i8", (6,)), ("at_once", "<i8"), ("gap_max_s", "<f8"), ("std_max_m", "<f8"),
        ("driven", "<i8"), ("tau", "<f8", (6,)),
        ("left_out", "<i8", (6,)), ("against", "<i8", (6,)), ("slipped", "<i8", (6,)), ("heard", "<i8", (2,)),
        ("R", "<f8", (3, 3)),
        ("lost", "<i8"), ("contradicting", "<i8"), ("missed", "<i8"),
        ("position_std_m", "<f8"), ("gap_s", "<f8"), ("alone_s", "<f8"),
    ]
)  # fmt: skip
"""The robot; s; m, what makes a slip; ticks in which tracker and IMU may be silent; addresses and code of the
model's constants, the noise and the rings; their length, numbers of an error, the newest place and how many
are filled. Limits: legs that may be lost, how many at once, s, m. State: whether `tau` are the last forces;
of each leg ticks left out, contradictions in a row, whether it has slipped; ticks in which tracker and IMU
were of use; R of the last estimate. What the last tick was judged by: bits of legs that do not count, and of
those that slipped and may not; whether a sensor is missed; the position's standard deviation over all
directions; since the tracker's last sample of use, and the same while a leg is lost, else 0."""

SLIP_TICKS = 3
"""Contradictions in a row that make a slip."""
LEFT_OUT_TICKS = 10
"""For how long a leg is left out at most that contradicts the prediction, but not by as much as a slip."""
LOST_TICKS = 2
"""Age from which a leg counts as lost."""
STANDING_m_s = 5e-3
"""On shut brakes no leg is faster that stands."""
_ALL_LEGS = (1 << LEGS) - 1
_RUN = int(DriveState.RUN)
_ENCODER, _UNCERTAIN = int(Fault.ENCODER), int(Fault.UNCERTAIN)
_WARN_ENCODER, _WARN_SENSOR = int(Warn.ENCODER), int(Warn.SENSOR)
_NOWHERE = -1
_NEVER_NS = -1.0
_rerun, _accelerate, _rotation = apart(rerun_kernel), apart(accelerate_kernel), apart(rotation_motion_kernel)


@helper
def latched_ns(tick: Any) -> int:
    """Return when the first encoder of a tick was latched, ns."""
    first = np.int64(0)
    for leg in range(LEGS):
        at_ns = tick.latch_ns[leg]
        if at_ns and (first == 0 or at_ns < first):
            first = at_ns
    return tick.t_ns + tick.lateness_ns + first  # type: ignore[no-any-return]


latched_at = direct(record(TICK, "t_ns", "lateness_ns", "latch_ns"))(latched_ns)
"""`latched_ns` for Python."""


@helper
def _stands(tick: Any) -> bool:
    """Tell whether all brakes are shut and no leg that is heard moves."""
    fresh = False
    for leg in range(LEGS):
        if tick.drive_state[leg] == _RUN:
            return False
        if tick.age[leg] == 0:
            fresh = True
            if not abs(tick.rate[leg]) < STANDING_m_s:
                return False
    return fresh


@helper
def _is_free(tick: Any) -> bool:
    for leg in range(LEGS):  # noqa: SIM110 - compiled
        if tick.drive_state[leg] != _RUN:
            return False
    return True


@helper
def _open(f: Any, tick: Any, command: Array, wrench: Array) -> None:
    """Begin the interval that ends at the tick."""
    ticks, latched = integers_at(f.ticks, f.size), integers_at(f.latched, f.size)
    before = f.newest
    f.newest = now = (before + 1) % f.size
    f.count = min(f.count + 1, f.size)
    ticks[now], latched[now] = tick.tick, latched_ns(tick)
    x, u = matrix_at(f.states, f.size, k.STATE)[before], matrix_at(f.intervals, f.size, k.INTERVAL)[now]
    u[:] = 0.0
    u[k.T] = (latched[now] - latched[before]) * 1e-9
    u[k.FADE] = 1.0
    free, stands = _is_free(tick), _stands(tick)
    tau, mean = np.empty(LEGS), np.empty(LEGS)
    for leg in range(LEGS):
        u[k.LENGTH + leg], u[k.RATE + leg] = tick.length[leg], tick.rate[leg]
        if tick.age[leg] == 0 and not f.slipped[leg]:
            doubted = (free or stands) and f.left_out[leg] < LEFT_OUT_TICKS
            u[k.USED + leg] = 1.0 if doubted else k.KEPT
        heard = tick.age[leg] == 0 or tick.blind[leg] != 0
        tau[leg] = tick.drive_force[leg] if heard else command[leg]
        mean[leg] = 0.5 * (tau[leg] + f.tau[leg]) if f.driven else tau[leg]
    if free:
        _accelerate(reals_at(f.constants, SIZE), f.code, x, mean, wrench, u)
        f.tau[:] = tau
    elif stands and u[k.T] > 0.0:
        for i in range(6):
            u[k.DTWIST + i] = x[k.TWIST + i] / -u[k.T]
    f.driven = np.int64(free)


@helper
def _instant(f: Any, sample: Any) -> float:
    """Return when a sample was taken, ns; _NEVER_NS if the rings do not reach."""
    ticks, latched = integers_at(f.ticks, f.size), integers_at(f.latched, f.size)
    for back in range(f.count):
        i = (f.newest - back) % f.size
        since = sample.tick - ticks[i]
        if since >= 0:
            return float(latched[i] + 1e9 * (since * f.period_s + sample.offset_s))
    return _NEVER_NS


@helper
def _interval_of(f: Any, at_ns: float) -> int:
    """Return which interval holds an instant; _NOWHERE when it is older than all, or not past."""
    latched = integers_at(f.latched, f.size)
    if at_ns > latched[f.newest]:
        return _NOWHERE
    for back in range(f.count - 1):
        i = (f.newest - back) % f.size
        if at_ns > latched[(i - 1) % f.size]:
            return int(i)
    return _NOWHERE


@helper
def _write(u: Array, kind: int, share: float, values: Array) -> None:
    if kind == IMU:
        u[k.IMU], u[k.IMU_AT] = 1.0, share
        u[k.GYRO : k.GYRO + 6] = values
        return
    u[k.TRACKER], u[k.TRACKER_AT] = k.UNDECIDED, share
    u[k.TRACKER_P : k.TRACKER_P + 3] = values[:3]
    zero = np.zeros(3)
    R = _rotation(values[3:].copy(), zero, zero)[0]
    for i in range(3):
        for j in range(3):
            u[k.TRACKER_R + 3 * i + j] = R[i, j]


@helper
def _place(f: Any, sensors: Any) -> tuple[int, int]:
    """Put samples into their intervals; return the first to run again, and the newest with a new pose.

    A sample is passed over that is older than the rings, or stamped after the newest latching.
    """
    ticks, latched = integers_at(f.ticks, f.size), integers_at(f.latched, f.size)
    intervals = matrix_at(f.intervals, f.size, k.INTERVAL)
    first, tracked = f.newest, _NOWHERE
    for kind in (TRACKER, IMU):
        samples = samples_of(sensors, kind)
        for n in range(sensors.count[kind]):
            at_ns = _instant(f, samples[n])
            i = _NOWHERE if at_ns == _NEVER_NS else _interval_of(f, at_ns)
            if i == _NOWHERE:
                continue
            share = 1.0 - (latched[i] - at_ns) * 1e-9 / intervals[i, k.T]
            _write(intervals[i], kind, share, samples[n].values)
            if kind == TRACKER:
                tracked = i
            else:
                f.heard[IMU] = ticks[f.newest]
            if (f.newest - i) % f.size > (f.newest - first) % f.size:
                first = i
    return first, tracked


@helper
def _close(f: Any, tick: Any, tracked: int) -> None:
    """Fill what the filter has found, and tell which legs do not count any more."""
    now = f.newest
    intervals = matrix_at(f.intervals, f.size, k.INTERVAL)
    x, u = matrix_at(f.states, f.size, k.STATE)[now], intervals[now]
    P = reals_at(f.covariances + 8 * now * f.errors * f.errors, f.errors * f.errors)
    fill_estimate(f.base_joints, f.platform_joints, f.radius, x, u, P.reshape((f.errors, f.errors)), tick)
    used = slipped = f.lost = 0
    for leg in range(LEGS):
        is_used = u[k.USED + leg] != 0.0
        left_out = tick.age[leg] == 0 and not is_used
        f.left_out[leg] = f.left_out[leg] + 1 if left_out else 0
        off = left_out and abs(tick.innovation_q[leg]) > f.slip_m
        f.against[leg] = f.against[leg] + 1 if off else 0
        if f.against[leg] >= SLIP_TICKS:
            f.slipped[leg] = 1
        if is_used:
            used |= 1 << leg
        slipped |= f.slipped[leg] << leg
        if tick.age[leg] >= LOST_TICKS or tick.blind[leg] != 0 or f.slipped[leg]:
            f.lost |= 1 << leg
    if tracked != _NOWHERE:
        v = intervals[tracked]
        tick.tracker = np.int64(v[k.TRACKER])
        tick.innovation_tracker[:] = v[k.TRACKER_INNOVATION : k.TRACKER_INNOVATION + 6]
        if v[k.TRACKER] > 0.0:
            f.heard[TRACKER] = tick.tick
    f.missed = np.int64(
        tick.tick - f.heard[TRACKER] > f.patience[TRACKER] or tick.tick - f.heard[IMU] > f.patience[IMU]
    )
    s = tick.pose_std
    f.position_std_m = np.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
    f.gap_s = (tick.tick - f.heard[TRACKER]) * f.period_s
    tick.legs_used, tick.legs_lost, tick.legs_slipped = used, f.lost, slipped
    f.R[:] = tick.R


@helper
def judge(f: Any, tick: Any) -> None:
    """Fill which legs may be lost, what warns and what faults."""
    lost = allowed = 0
    for leg in range(LEGS):
        lost += f.lost >> leg & 1
    for leg in range(LEGS):
        excused = lost <= f.at_once and f.lost >> leg & 1 and f.may_lose[leg]
        tick.counted_age[leg] = 0 if excused else tick.age[leg]
        if excused:
            allowed |= 1 << leg
    f.contradicting = tick.legs_slipped & ~allowed
    f.alone_s = f.gap_s if allowed else 0.0
    faults = _ENCODER if f.contradicting else 0
    if not f.position_std_m <= f.std_max_m or not f.alone_s <= f.gap_max_s:
        faults |= _UNCERTAIN
    tick.unseen = np.int64(tick.legs_used != _ALL_LEGS)
    tick.fusion_faults = faults
    tick.fusion_warnings = (_WARN_ENCODER if f.lost else 0) | (_WARN_SENSOR if f.missed else 0)


@pointed(record(FUSION), record(SENSORS), INTEGER, INTEGER, record(TICK))
def fuse(f: Any, sensors: Any, command: int, wrench: int, tick: Any) -> int:
    """Fill estimate and fusion of a tick, see `FusedEstimator`.

    command, wrench: addresses of the forces last sent, (6,) N, and the external load, (6,) N, N m.
    """
    _open(f, tick, reals_at(command, LEGS), reals_at(wrench, 6))
    first, tracked = _place(f, sensors)
    shape = (f.size, f.errors, f.errors)
    covariances = reals_at(f.covariances, f.size * f.errors * f.errors).reshape(shape)
    _rerun(
        f.base_joints,
        f.platform_joints,
        reals_at(f.noise, k.NOISE),
        matrix_at(f.intervals, f.size, k.INTERVAL),
        matrix_at(f.states, f.size, k.STATE),
        covariances,
        first,
        (f.newest - first) % f.size + 1,
    )
    _close(f, tick, tracked)
    judge(f, tick)
    return 0
