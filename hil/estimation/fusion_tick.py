"""One tick of the fusion filter of `hil.estimation.fusion`: its interval, late samples, and lost legs."""

from math import nan
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, kernel, record
from drivers.compiled.pointed import address_of, integers_at, pointed, reals_at
from drivers.sensing.kernels import count_of, latched_ns, samples_of
from drivers.sensing.layout import IMU, SENSORS, TRACKER
from drivers.signals import LEGS, DriveState, Fault, Warn
from drivers.tick_columns import TICK
from hil.estimation.fusion_kernels import covariances_of, fill_estimate, rerun_kernel, steps_at
from hil.estimation.fusion_layout import FUSION, KEPT, STEP, TWIST, UNDECIDED
from hil.estimation.fusion_predict import accelerate_kernel
from hil.mathematics.rotations import rotation_motion_kernel

SLIP_TICKS = 3
"""Number of contradictions in a row that count as a slip."""
LEFT_OUT_TICKS = 10
"""Most ticks for which a leg is left out that contradicts the prediction by less than a slip."""
LOST_TICKS = 2
"""Age in ticks from which a leg counts as lost."""
STANDING_m_s = 5e-3
"""Largest rate of a leg that stands on shut brakes."""
_ALL_LEGS = (1 << LEGS) - 1
_NOWHERE = -1
_STEP_WORDS = STEP.itemsize // 8


latched_at = kernel(record(TICK, "t_ns", "lateness_ns", "latch_ns"))(latched_ns)
"""`latched_ns` for Python."""


@helper
def _brakes(tick: Any) -> tuple[bool, bool]:
    """(all brakes are open, all brakes are closed and no leg with a reading moves), by drive states."""
    free = shut = at_rest = True
    heard = False
    for leg in range(LEGS):
        runs = tick.drive_state[leg] == DriveState.RUN
        free, shut = free and runs, shut and not runs
        if tick.age[leg] == 0:
            heard = True
            at_rest = at_rest and abs(tick.rate[leg]) < STANDING_m_s
    return free, shut and heard and at_rest


@helper
def _open(f: Any, tick: Any, command: Array, wrench: Array) -> None:
    steps = steps_at(f.steps, f.size)
    before = steps[f.newest]
    f.newest = (f.newest + 1) % f.size
    f.count = min(f.count + 1, f.size)
    s = steps[f.newest]
    integers_at(address_of(s), _STEP_WORDS)[:] = 0
    s.tick, s.latched_ns = tick.tick, latched_ns(tick)
    s.T = (s.latched_ns - before.latched_ns) * 1e-9
    s.fade = 1.0
    free, stands = _brakes(tick)
    tau, mean = np.empty(LEGS), np.empty(LEGS)
    for leg in range(LEGS):
        s.length[leg], s.rate[leg] = tick.length[leg], tick.rate[leg]
        if tick.latch_ns[leg]:  # polled drives sample one after the other
            after_ns = tick.t_ns + tick.lateness_ns + tick.latch_ns[leg] - s.latched_ns
            s.length[leg] -= tick.rate[leg] * (1e-9 * after_ns)
        if tick.age[leg] == 0 and not f.slipped[leg]:
            doubted = (free or stands) and f.left_out[leg] < LEFT_OUT_TICKS
            s.used[leg] = 1 if doubted else KEPT
        heard = f.reports_force and (tick.age[leg] == 0 or tick.blind[leg] != 0)
        tau[leg] = tick.drive_force[leg] if heard else command[leg]
        mean[leg] = 0.5 * (tau[leg] + f.tau[leg]) if f.driven else tau[leg]
    if free:
        accelerate_kernel(f, before, mean, wrench, s)
        f.tau[:] = tau
    elif stands and s.T > 0.0:
        for i in range(6):
            s.dtwist[i] = before.x[TWIST + i] / -s.T
    f.driven = np.int64(free)


@helper
def _interval_of(f: Any, sample: Any) -> tuple[int, float]:
    """Index of the interval in which a sample was taken, and the share of the interval before the sample.

    _NOWHERE if the sample is older than the rings, or stamped after the newest encoder reading.
    """
    steps, at_ns = steps_at(f.steps, f.size), nan
    for back in range(f.count):
        s = steps[(f.newest - back) % f.size]
        since = sample.tick - s.tick
        if since >= 0:
            at_ns = s.latched_ns + 1e9 * (since * f.period_s + sample.offset_s)
            break
    if not at_ns > steps[f.newest].latched_ns:
        for back in range(f.count - 1):
            i = (f.newest - back) % f.size
            if at_ns > steps[(i - 1) % f.size].latched_ns:
                return i, 1.0 - (steps[i].latched_ns - at_ns) * 1e-9 / steps[i].T
    return _NOWHERE, nan


@helper
def _place(f: Any, sensors: Any) -> tuple[int, int]:
    """Insert samples into their intervals; returns the first to run again and the newest with a tracker pose.

    A sample outside all intervals is ignored.
    """
    first, tracked, zero = f.newest, _NOWHERE, np.zeros(3)
    for kind in (TRACKER, IMU):
        samples = samples_of(sensors, kind)
        for n in range(count_of(sensors, kind)):
            i, share = _interval_of(f, samples[n])
            if i == _NOWHERE:
                continue
            s, values = steps_at(f.steps, f.size)[i], samples[n].values
            if kind == TRACKER:
                s.tracker, s.tracker_at, tracked = UNDECIDED, share, i
                s.tracker_p[:] = values[:3]
                s.tracker_R[:] = rotation_motion_kernel(values[3:].copy(), zero, zero)[0]
            else:
                s.imu, s.imu_at, f.heard[IMU] = 1, share, steps_at(f.steps, f.size)[f.newest].tick
                s.gyro[:], s.force[:] = values[:3], values[3:]
            if (f.newest - i) % f.size > (f.newest - first) % f.size:
                first = i
    return first, tracked


@helper
def _close(f: Any, tick: Any, tracked: int) -> None:
    steps = steps_at(f.steps, f.size)
    s = steps[f.newest]
    fill_estimate(f, s, covariances_of(f)[f.newest], tick)
    used = slipped = f.lost = 0
    for leg in range(LEGS):
        left_out = tick.age[leg] == 0 and s.used[leg] == 0
        f.left_out[leg] = f.left_out[leg] + 1 if left_out else 0
        off = left_out and abs(tick.innovation_q[leg]) > f.slip_m
        f.against[leg] = f.against[leg] + 1 if off else 0
        if f.against[leg] >= SLIP_TICKS:
            f.slipped[leg] = 1
        used |= int(s.used[leg] != 0) << leg
        slipped |= f.slipped[leg] << leg
        if tick.age[leg] >= LOST_TICKS or tick.blind[leg] != 0 or f.slipped[leg]:
            f.lost |= 1 << leg
    if tracked != _NOWHERE:
        tick.tracker = steps[tracked].tracker
        tick.innovation_tracker[:] = steps[tracked].tracker_innovation
        if tick.tracker > 0:
            f.heard[TRACKER] = tick.tick
    f.missed = np.int64(
        tick.tick - f.heard[TRACKER] > f.patience[TRACKER] or tick.tick - f.heard[IMU] > f.patience[IMU]
    )
    std = tick.pose_std
    f.position_std_m = np.sqrt(std[0] * std[0] + std[1] * std[1] + std[2] * std[2])
    f.gap_s = (tick.tick - f.heard[TRACKER]) * f.period_s
    tick.legs_used, tick.legs_lost, tick.legs_slipped = used, f.lost, slipped
    f.R[:] = tick.R


@helper
def judge(f: Any, tick: Any) -> None:
    """Fill in which lost legs the configuration allows, and the filter's warnings and faults."""
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
    faults = Fault.ENCODER.value if f.contradicting else 0
    if not f.position_std_m <= f.std_max_m or not f.alone_s <= f.gap_max_s:
        faults |= Fault.UNCERTAIN.value
    tick.unseen = np.int64(tick.legs_used != _ALL_LEGS)
    tick.fusion_faults = faults
    tick.fusion_warnings = (Warn.ENCODER.value if f.lost else 0) | (
        Warn.SENSOR.value if f.missed or f.strays else 0
    )


@pointed(record(FUSION), record(SENSORS), INTEGER, INTEGER, record(TICK))
def fuse(f: Any, sensors: Any, command: int, wrench: int, tick: Any) -> int:
    """Run the fusion filter for a tick and fill in its columns, see `FusedEstimator`; returns 0.

    command, wrench: addresses of the last forces sent, (6,) N, and the external load, (6,) N, N m.
    """
    _open(f, tick, reals_at(command, LEGS), reals_at(wrench, 6))
    first, tracked = _place(f, sensors)
    rerun_kernel(f, first)
    _close(f, tick, tracked)
    judge(f, tick)
    return 0
