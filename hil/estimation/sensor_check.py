"""Sensors next to the drives, compared with the legs: the mean difference of each, as a share of its limit.

The legs give pose, rates, lengths and forces of the tick; the newest sample of a sensor is compared with what
they were at its instant, by the rates of the tick. The mean is exponential over SAMPLES samples, each the one
of the last two that is nearer to it: a single outlier does not count.
"""

from math import inf, isinf, isnan, nan
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import pointed
from drivers.sensing.kernels import age_of, latched_ns, slots_at
from drivers.sensing.layout import (
    FORCE,
    IMU,
    INCLINATION,
    LENGTH,
    QUANTITIES,
    SENSORS,
    SLOTS,
    TRACKER,
)
from drivers.signals import Mode, Warn
from drivers.tick_columns import TICK, part
from hil.estimation.external_wrench import WRENCH
from hil.estimation.fusion_predict import exp_step
from hil.mathematics.rotations import relative_rotation, rotation_motion
from hil.mathematics.trigonometry import sincos
from hil.mathematics.vectors import at, cross, rotate_back, scale

SAMPLES = 50
"""Samples of the exponential mean."""
STARTS_S = 0.5
"""Time in which a sensor has to send its first sample."""
FEWEST = 5
"""Samples before a mean is compared with its limit."""


@helper
def _rotation_then(tick: Any, dt: float) -> Array:
    """Rotation (3, 3) of the platform dt s before the tick, platform to base."""
    R: Array = tick.R.copy()
    exp_step(R, scale(-dt, at(tick.twist, 3)))
    return R


@helper
def difference(tick: Any, slot: int, values: Array, dt: float, gap: Array, rate: Array) -> bool:
    """Fill in a sample less what the legs say dt s before the tick, and the rates of that; False: unknown.

    gap, rate (6,): SI, of position and rotation vector, angular rate, vertical about the platform's axes,
    length, or force.
    """
    if slot >= FORCE:
        force = tick.drive_force[slot - FORCE]
        gap[0] = values[0] - force
        return bool(force != 0.0)
    if slot >= LENGTH:
        leg = slot - LENGTH
        rate[0] = tick.rate[leg]
        dt += 1e-9 * (tick.t_ns + tick.lateness_ns + tick.latch_ns[leg] - latched_ns(tick))
        gap[0] = values[0] - (tick.length[leg] - rate[0] * dt)
        return bool(tick.age[leg] == 0)
    R = _rotation_then(tick, dt)
    if slot == TRACKER:
        Z, none = np.empty((3, 3)), (0.0, 0.0, 0.0)
        rotation_motion(at(values, 3), none, none, Z)
        turned = relative_rotation(R, Z)
        for i in range(3):
            gap[i], gap[3 + i] = values[i] - (tick.p[i] - dt * tick.twist[i]), turned[i]
        rate[:] = tick.twist
    elif slot == IMU:
        turns = rotate_back(R, at(tick.twist, 3))
        for i in range(3):
            gap[i] = values[i] - turns[i]
    elif slot == INCLINATION:
        sr, cr = sincos(values[0])
        sp, cp = sincos(values[1])
        apart = cross((R[2, 0], R[2, 1], R[2, 2]), (-sp, cp * sr, cp * cr))
        turns = rotate_back(R, at(tick.twist, 3))
        for i in range(3):
            gap[i], rate[i] = -apart[i], turns[i]
    return True


SEEN = record(TICK, "tick", "t_ns", "lateness_ns", "latch_ns", *part("measurement", "estimate"))


@pointed(record(WRENCH), record(SENSORS), INTEGER, INTEGER, SEEN)
def compare(k: Any, sensors: Any, mode: int, fusing: int, tick: Any) -> int:
    """Compare the samples of a tick with the legs; fill in `sensor_share` and the gaps.

    fusing: not 0 while the fusion filter runs, which checks tracker and IMU by itself.
    Returns Warn.SENSOR if a sensor differs by more than its limit, or is silent while the drives are powered.
    """
    slots, apart = slots_at(sensors.slots, SLOTS), False
    gap, rate = np.empty(QUANTITIES), np.empty(QUANTITIES)
    for slot in range(SLOTS):
        of = slots[slot]
        if of.present == 0 or (fusing and slot in (TRACKER, IMU)):
            continue
        age_s = age_of(of, tick.tick, k.period_s)
        gap[:] = rate[:] = 0.0
        free = slot < FORCE or Mode.APPROACH <= mode <= Mode.STOPPING  # a shut brake carries the load
        if of.count > 0 and free and difference(tick, slot, of.last, age_s, gap, rate):
            of.compared += 1
            of.share = nan
            for j in range(QUANTITIES):
                if of.compared == 1:
                    of.gap[j] = of.mean[j] = gap[j]
                now, was = gap[j], of.gap[j]
                of.gap[j], gap[j] = now, now if abs(now - of.mean[j]) < abs(was - of.mean[j]) else was
                of.mean[j] += (gap[j] - of.mean[j]) / min(of.compared, SAMPLES)
                if not isinf(of.limit[j]):
                    share = abs(of.mean[j]) / (of.limit[j] + of.time_s * abs(rate[j]))
                    of.share = share if isnan(of.share) else max(of.share, share)
            if LENGTH <= slot < FORCE:
                tick.length_gap_now[slot - LENGTH] = gap[0]
        if of.compared >= FEWEST:
            tick.sensor_share[slot] = of.share
            if slot == TRACKER and age_s <= of.patience_s:
                tick.tracker_gap[:] = of.mean
            elif LENGTH <= slot < FORCE:
                tick.length_gap[slot - LENGTH] = of.mean[0]
        heard = of.compared > 0 or tick.tick * k.period_s > STARTS_S
        if heard and age_s > of.patience_s and Mode.LOADING <= mode <= Mode.UNLOADING:
            tick.sensor_share[slot] = inf
        apart = apart or tick.sensor_share[slot] > 1.0
    return Warn.SENSOR.value if apart else 0
