"""What the filter of `hil.estimation.fusion` believes of measurements and model, as its kernels take it."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.config import ImuSettings, TrackerSettings
from hil.config.estimation import FusionSettings
from hil.estimation import fusion_layout as k


class LegErrors(NamedTuple):
    """What lengths, rates and forces of a leg are wrong by. Standard deviations, equal for all legs."""

    length_std_m: float
    rate_std_m_s: float
    rate_skew_std_s: float = 0.0
    """Of the instant of a rate beside that of its length."""
    rate_scale_std: float = 0.0
    """Of the share of a rate that is wrong."""
    force_std_N: float = 0.0
    """Of the force along a leg that model and drives do not know; 0: there is none."""
    force_time_s: float = 0.1
    """Its correlation time."""


def pack_noise(
    s: FusionSettings,
    legs: LegErrors,
    tracker: TrackerSettings | None,
    imu: ImuSettings | None,
    gravity: Array,
) -> Array:
    """Return the constants (NOISE,) of the kernels: variances, densities, gate, gravity (3,) m/s^2."""
    c = np.zeros(k.NOISE)
    c[k.Q_V] = s.acceleration_noise_m_s2_sqrtHz**2
    c[k.Q_W] = s.angular_acceleration_noise_rad_s2_sqrtHz**2
    c[k.R_LENGTH] = legs.length_std_m**2
    c[k.R_RATE] = legs.rate_std_m_s**2
    c[k.RATE_SKEW] = legs.rate_skew_std_s**2
    c[k.RATE_SCALE] = legs.rate_scale_std**2
    c[k.LEG_FORCE_VARIANCE] = legs.force_std_N**2
    c[k.LEG_FORCE_TIME] = legs.force_time_s
    if tracker is not None:
        c[k.R_POSITION] = tracker.position_std_m**2
        c[k.R_ROTATION] = np.deg2rad(tracker.orientation_std_deg) ** 2
    c[k.LATCH] = (s.latch_std_us * 1e-6) ** 2
    c[k.GATE] = s.gate_std**2
    if imu is not None:
        c[k.BIASED] = float(s.imu_biases)
        c[k.R_GYRO] = imu.angular_rate_std_rad_s**2
        c[k.R_FORCE] = imu.specific_force_std_m_s2**2
        c[k.Q_GYRO_BIAS] = s.gyro_bias_walk_rad_s_sqrts**2
        c[k.Q_FORCE_BIAS] = s.accelerometer_bias_walk_m_s2_sqrts**2
    c[k.GRAVITY : k.GRAVITY + 3] = gravity
    return c
