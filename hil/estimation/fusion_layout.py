"""Memory of the fusion filter of `hil.estimation.fusion`: its record, and the ticks that it keeps."""

from typing import NamedTuple

import numpy as np

TWIST, GYRO_BIAS, FORCE_BIAS, LEG_FORCE, STAMP = 12, 18, 21, 24, 30
"""Indices in a state (37,), behind p and R."""
KEPT, UNDECIDED = 2, 2
"""`used` of a leg that is used in any case; `tracker` of a sample that no run has seen yet."""

STEP = np.dtype(
    [
        ("tick", "<i8"), ("latched_ns", "<i8"),
        ("x", "<f8", (37,)),  # the state at its latching, see `hil.estimation.fusion_kernels`
        # the interval that ends with it
        ("T", "<f8"),  # s
        ("dtwist", "<f8", (6,)),  # acceleration of the model, mean over the interval
        ("gradient", "<f8", (6, 6)),  # how that changes with dp, dtheta
        ("influence", "<f8", (6, 6)),  # M^-1 J^T, how forces along the legs change it; 0 on brakes
        ("length", "<f8", (6,)), ("rate", "<f8", (6,)),  # m, m/s
        ("used", "<i8", (6,)),  # 0 the leg is not used, 1 unless it alone contradicts the prediction, KEPT
        ("fade", "<f8"),  # factor on the process noise that the decision found necessary
        ("decided", "<i8"),  # 1 once legs and noise are decided
        ("tracker", "<i8"), ("tracker_at", "<f8"),  # 0 none, 1 used, -1 refused; instant as a share of T
        ("tracker_p", "<f8", (3,)), ("tracker_R", "<f8", (3, 3)),
        ("imu", "<i8"), ("imu_at", "<f8"),  # 0 or 1; instant as a share of T
        ("gyro", "<f8", (3,)), ("force", "<f8", (3,)),  # rad/s, m/s^2 in the platform frame
        ("innovation", "<f8", (6,)),  # measured less predicted length, m
        ("tracker_innovation", "<f8", (6,)),  # measured less predicted pose, m and rad
        ("tracker_std", "<f8", (6,)),  # its standard deviations
    ]
)  # fmt: skip
"""One tick: its state, the measurements since the tick before, and the decisions about them."""
FUSION = np.dtype(
    [
        ("base_joints", "<f8", (6, 3)), ("platform_joints", "<f8", (6, 3)), ("radius", "<f8"),  # m
        ("constants", "<i8"), ("code", "<i8"),  # of the model
        ("period_s", "<f8"), ("slip_m", "<f8"),
        ("patience", "<f8", (2,)),  # ticks in which tracker and IMU may be silent
        # variances of one sample, densities of what is white in time
        ("q_v", "<f8"), ("q_w", "<f8"), ("q_gyro_bias", "<f8"), ("q_force_bias", "<f8"),
        ("q_stamp", "<f8"), ("q_position", "<f8"), ("q_rotation", "<f8"),
        ("r_length", "<f8"), ("r_rate", "<f8"), ("r_position", "<f8"), ("r_rotation", "<f8"),
        ("r_gyro", "<f8"), ("r_force", "<f8"),
        ("latch", "<f8"), ("rate_skew", "<f8"),  # s^2, of the instants of a length and of a rate beside it
        ("rate_scale", "<f8"),  # of the share of a rate that is wrong
        ("leg_force", "<f8"), ("leg_force_s", "<f8"),  # N^2, and its correlation time
        ("gate", "<f8"),  # square of the allowed number of standard deviations
        ("gravity", "<f8", (3,)),
        ("reports_force", "<i8"),  # 0: the drives report no force, the commands count
        # limits
        ("may_lose", "<i8", (6,)), ("at_once", "<i8"),  # legs that may be lost, and how many
        ("gap_max_s", "<f8"), ("std_max_m", "<f8"),
        # rings: addresses of the steps and of their covariances (n, n), how many there are
        ("steps", "<i8"), ("covariances", "<i8"), ("size", "<i8"),
        ("errors", "<i8"), ("forces", "<i8"), ("offsets", "<i8"),  # n; where these begin in an error
        ("newest", "<i8"), ("count", "<i8"),  # place of the newest step; how many are filled
        # state
        ("driven", "<i8"), ("tau", "<f8", (6,)),  # 1: tau are the last forces
        ("left_out", "<i8", (6,)), ("against", "<i8", (6,)),  # ticks; contradictions in a row
        ("slipped", "<i8", (6,)),  # 1: the encoder has slipped
        ("heard", "<i8", (2,)),  # ticks in which tracker and IMU were last of use
        ("R", "<f8", (3, 3)),  # of the last estimate
        ("mean", "<f8", (6,)),  # of recent tracker innovations, in their standard deviations
        ("strays", "<i8"),  # 1: they are not random
        # what the last tick was judged by
        ("lost", "<i8"), ("contradicting", "<i8"),  # bits: legs that do not count; slipped, and may not
        ("missed", "<i8"),  # 1: a sensor is missed
        ("position_std_m", "<f8"),  # over all directions
        ("gap_s", "<f8"), ("alone_s", "<f8"),  # since the tracker was of use; while a leg is lost, else 0
    ]
)  # fmt: skip
"""The robot, error models of legs, sensors and motion, limits, and the state of the filter."""


class LegErrors(NamedTuple):
    """Standard deviations of a leg's length, rate and force errors, equal for all legs."""

    length_std_m: float
    rate_std_m_s: float
    rate_skew_std_s: float = 0.0
    """Standard deviation of the time skew between a rate and its length."""
    rate_scale_std: float = 0.0
    """Standard deviation of the relative error of a rate."""
    force_std_N: float = 0.0
    """Standard deviation of the force along a leg that model and drives do not know; 0: none."""
    force_time_s: float = 0.1
    """Correlation time of the unknown leg force."""
    reports_force: bool = True
    """False for drives whose feedback carries no force: the commands count."""
