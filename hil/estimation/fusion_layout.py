"""Where the state, an interval and the noise of the filter of `hil.estimation.fusion` keep what they hold."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.config import ImuSettings, TrackerSettings
from hil.config.estimation import FusionSettings

STATE = 30
TWIST, GYRO_BIAS, FORCE_BIAS, LEG_FORCE = 12, 18, 21, 24

# One interval, from the tick before to this one: what was measured, and what was decided about it.
T = 0
"""s."""
DTWIST = 1
"""6: acceleration of the model, mean over the interval."""
LENGTH, RATE = 7, 13
"""6 each: leg lengths m and rates m/s at its end."""
USED = 19
"""6: 0 the leg is not used, 1 unless it alone contradicts the prediction, KEPT whatever it says."""
KEPT = 2.0
FADE = 25
"""Factor on the process noise that the decision found necessary."""
DECIDED = 26
"""1 once legs and noise are decided."""
UNDECIDED = 2.0
"""TRACKER of a sample that no run has seen yet."""
TRACKER, TRACKER_AT, TRACKER_P, TRACKER_R = 27, 28, 29, 32
"""0 none, 1 used, -1 refused; instant as a share of the interval; (3,) m; (3, 3)."""
IMU, IMU_AT, GYRO, FORCE = 41, 42, 43, 46
"""0 or 1; instant as a share of the interval; (3,) rad/s; (3,) m/s^2, both in the platform frame."""
INNOVATION = 49
"""6: measured less predicted length, m."""
TRACKER_INNOVATION = 55
"""6: measured less predicted pose, m and rad."""
GRADIENT = 61
"""(6, 6): how the model's acceleration changes with dp, dtheta."""
INFLUENCE = 97
"""(6, 6): M^-1 J^T, how forces along the legs accelerate the platform; 0 on brakes."""
INTERVAL = 133

# Noise: variances of one sample, densities of what is white in time.
(
    Q_V, Q_W, R_LENGTH, R_RATE, R_POSITION, R_ROTATION, GATE, R_GYRO, R_FORCE, Q_GYRO_BIAS, Q_FORCE_BIAS,
    LATCH, RATE_SKEW, RATE_SCALE, LEG_FORCE_VARIANCE, LEG_FORCE_TIME, BIASED, GRAVITY,
) = range(18)  # fmt: skip
"""GATE is the square of the allowed number of standard deviations; LATCH and RATE_SKEW variances of the
instants of latching a length and of a rate beside it, s^2; RATE_SCALE that of the share of a rate that is
wrong; LEG_FORCE_VARIANCE N^2, 0 without these states; LEG_FORCE_TIME s; BIASED 1 with the biases of an IMU;
GRAVITY the first of three, m/s^2."""
NOISE = 21

DIFFERENCE = 1e-6
"""m or rad: step of the gradient."""
FADES = 6
"""Process noise is raised by 100 up to so often, before the measurements are taken as they are."""


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
    c = np.zeros(NOISE)
    c[Q_V] = s.acceleration_noise_m_s2_sqrtHz**2
    c[Q_W] = s.angular_acceleration_noise_rad_s2_sqrtHz**2
    c[R_LENGTH] = legs.length_std_m**2
    c[R_RATE] = legs.rate_std_m_s**2
    c[RATE_SKEW] = legs.rate_skew_std_s**2
    c[RATE_SCALE] = legs.rate_scale_std**2
    c[LEG_FORCE_VARIANCE] = legs.force_std_N**2
    c[LEG_FORCE_TIME] = legs.force_time_s
    if tracker is not None:
        c[R_POSITION] = tracker.position_std_m**2
        c[R_ROTATION] = np.deg2rad(tracker.orientation_std_deg) ** 2
    c[LATCH] = (s.latch_std_us * 1e-6) ** 2
    c[GATE] = s.gate_std**2
    if imu is not None:
        c[BIASED] = float(s.imu_biases)
        c[R_GYRO] = imu.angular_rate_std_rad_s**2
        c[R_FORCE] = imu.specific_force_std_m_s2**2
        c[Q_GYRO_BIAS] = s.gyro_bias_walk_rad_s_sqrts**2
        c[Q_FORCE_BIAS] = s.accelerometer_bias_walk_m_s2_sqrts**2
    c[GRAVITY : GRAVITY + 3] = gravity
    return c
