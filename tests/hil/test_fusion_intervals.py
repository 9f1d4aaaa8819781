"""One interval of the filter: its covariance goes where its state goes, and the gyro counts at its instant."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.arrays import Array
from drivers.compiled.pointed import context_of, data_at
from drivers.config import ImuSettings, TrackerSettings
from drivers.tick_columns import Record
from hil.config.estimation import FusionSettings
from hil.estimation.fusion import FusedEstimator
from hil.estimation.fusion_kernels import rerun_kernel
from hil.estimation.fusion_layout import FUSION, STEP, LegErrors
from hil.robot.dynamics import Model
from tests.hil.test_fusion import PLATFORM, A, B, T

TILT = Rotation.from_rotvec([0.3, -0.4, 0.5])
TWIST = np.array([0.3, -0.2, 0.1, 0.5, -0.4, 0.8])
TURN = np.array([20.0, -10.0, 15.0])
rerun = rerun_kernel
SURE, UNSURE = 1e-9, 1e12
"""Variances of what counts alone, and of what does not count."""


def noise(*, force: float, gyro: float) -> Record:
    """Return a filter of two steps with the variances of an IMU and its biases; legs count for nothing."""
    robot = {"base_joints": A, "platform_joints": B, "gravity": (0.0, 0.0, -9.81)}
    variances = {"q_v": 1e-6, "q_w": 1e-9, "r_length": 1.0, "r_rate": 1.0, "gate": 1e6}
    rings = {"size": 2, "newest": 1, "errors": 18, "forces": 18}
    return context_of(FUSION, r_force=force, r_gyro=gyro, **robot, **variances, **rings)


def begun() -> Array:
    x = np.zeros(30)
    x[:3], x[3:12], x[12:18] = (0.05, -0.1, 1.1), TILT.as_matrix().ravel(), TWIST
    x[18:24] = 0.01, -0.02, 0.03, 0.1, -0.2, 0.3
    return x


def ended(c: Record, u: Record, x0: Array, P0: Array) -> tuple[Array, Array]:
    """Return state and covariance after the interval u."""
    steps, covariances = np.zeros(2, STEP), np.zeros((2, *P0.shape))
    steps[1], covariances[0] = u, P0
    steps[0]["x"] = x0
    c["steps"], c["covariances"] = data_at(steps), data_at(covariances)
    rerun(c, 1)
    return steps[1]["x"], covariances[1]


def sampled(share: float, gyro: Array, force: Array) -> Record:
    """Return an interval in which the platform turns faster and faster, with a sample of an IMU."""
    dtwist = (1.0, 2.0, -3.0, *TURN)
    return context_of(STEP, T=T, fade=1.0, imu=1, imu_at=share, dtwist=dtwist, gyro=gyro, force=force)


def off(x: Array, error: Array) -> Array:
    """Return a state that is off by an error (18,): pose, twist, biases."""
    there = x.copy()
    there[:3] += error[:3]
    there[3:12] = (
        (Rotation.from_rotvec(error[3:6]) * Rotation.from_matrix(x[3:12].reshape(3, 3))).as_matrix().ravel()
    )
    there[12:24] += error[6:18]
    return there


def between(x: Array, y: Array) -> Array:
    """Return the error (18,) by which y is off x."""
    turned = Rotation.from_matrix(y[3:12].reshape(3, 3)) * Rotation.from_matrix(x[3:12].reshape(3, 3)).inv()
    return np.concatenate((y[:3] - x[:3], turned.as_rotvec(), y[12:24] - x[12:24]))


@pytest.mark.parametrize("force", [SURE, UNSURE], ids=["by the IMU", "by the model"])
@pytest.mark.parametrize("j", range(18))
def test_an_error_is_carried_on_as_the_state_is(j, force):
    """Central differences, an accelerometer that counts for everything or for nothing on a tilted platform."""
    c, x0, h = noise(force=force, gyro=UNSURE), begun(), 1e-5
    u = sampled(0.5, np.zeros(3), np.array([3.0, -2.0, 11.0]))
    e = np.eye(18)[j]
    ahead, back = (ended(c, u, off(x0, sign * h * e), np.zeros((18, 18)))[0] for sign in (1.0, -1.0))
    column = between(back, ahead) / (2.0 * h)
    P = ended(c, u, x0, np.outer(e, e))[1]
    np.testing.assert_allclose(P[j] / np.sqrt(P[j, j]), column, rtol=0, atol=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_a_rate_that_was_measured_within_an_interval_in_which_it_grows_is_taken_at_its_instant(share):
    t = share * T
    R = Rotation.from_rotvec(TWIST[3:] * t + TURN * t * t / 2.0) * TILT
    x0 = begun()
    gyro = R.inv().apply(TWIST[3:] + t * TURN) + x0[18:21]
    P0 = np.diag(np.repeat([SURE, SURE, SURE, 1.0, SURE, SURE], 3))
    x, P = ended(noise(force=UNSURE, gyro=SURE), sampled(share, gyro, np.zeros(3)), x0, P0)
    assert P[9:12, 9:12].diagonal().max() < 1e-6, "it counts"
    np.testing.assert_allclose(x[15:18], TWIST[3:] + T * TURN, rtol=0, atol=2e-4)


def test_each_setting_makes_its_own_constant():
    settings = FusionSettings(
        acceleration_noise_m_s2_sqrtHz=2.0,
        angular_acceleration_noise_rad_s2_sqrtHz=3.0,
        gyro_bias_walk_rad_s_sqrts=5.0,
        accelerometer_bias_walk_m_s2_sqrts=7.0,
        latch_std_us=11.0,
        gate_std=13.0,
    )
    legs = LegErrors(17.0, 19.0, 23.0, 29.0, 31.0, 37.0)
    tracker = TrackerSettings(position_std_m=0.041, orientation_std_deg=0.43)
    imu = ImuSettings(rate_Hz=500.0, angular_rate_std_rad_s=0.047, specific_force_std_m_s2=0.53)
    c = FusedEstimator(PLATFORM, Model(PLATFORM), settings, legs, tracker, imu, T).record
    expected = {
        "q_v": 4.0, "q_w": 9.0, "q_gyro_bias": 25.0, "q_force_bias": 49.0, "latch": 121e-12, "gate": 169.0,
        "r_length": 289.0, "r_rate": 361.0, "rate_skew": 529.0, "rate_scale": 841.0,
        "leg_force": 961.0, "leg_force_s": 37.0, "r_position": 0.001681,
        "r_rotation": (0.43 * np.pi / 180.0) ** 2, "r_gyro": 0.002209, "r_force": 0.2809,
        "forces": 18, "errors": 24,
    }  # fmt: skip
    assert {name: float(c[name]) for name in expected} == pytest.approx(expected)
    assert c["gravity"].tolist() == PLATFORM.gravity.tolist()
