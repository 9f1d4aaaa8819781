"""One interval of the filter: its covariance goes where its state goes, and the gyro counts at its instant."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.arrays import Array
from drivers.config import ImuSettings, TrackerSettings
from hil.config.estimation import FusionSettings
from hil.estimation import fusion_layout as k
from hil.estimation.fusion_kernels import rerun_kernel
from hil.estimation.fusion_layout import LegErrors, pack_noise
from tests.hil.test_fusion import A, B, T

TILT = Rotation.from_rotvec([0.3, -0.4, 0.5])
TWIST = np.array([0.3, -0.2, 0.1, 0.5, -0.4, 0.8])
TURN = np.array([20.0, -10.0, 15.0])
SURE, UNSURE = 1e-9, 1e12
"""Variances of what counts alone, and of what does not count."""


def noise(*, force: float, gyro: float) -> Array:
    """Return constants with the variances of an IMU; legs count for nothing."""
    c = np.zeros(k.NOISE)
    c[[k.Q_V, k.Q_W, k.R_LENGTH, k.R_RATE, k.GATE, k.BIASED]] = 1e-6, 1e-9, 1.0, 1.0, 1e6, 1.0
    c[k.R_FORCE], c[k.R_GYRO] = force, gyro
    c[k.GRAVITY : k.GRAVITY + 3] = 0.0, 0.0, -9.81
    return c


def begun() -> Array:
    x = np.zeros(k.STATE)
    x[:3], x[3:12], x[12:18] = (0.05, -0.1, 1.1), TILT.as_matrix().ravel(), TWIST
    x[18:24] = 0.01, -0.02, 0.03, 0.1, -0.2, 0.3
    return x


def ended(c: Array, u: Array, x0: Array, P0: Array) -> tuple[Array, Array]:
    """Return state and covariance after the interval u."""
    intervals, states = np.zeros((2, k.INTERVAL)), np.zeros((2, k.STATE))
    covariances = np.zeros((2, *P0.shape))
    intervals[1], states[0], covariances[0] = u, x0, P0
    rerun_kernel(A, B, c, intervals, states, covariances, 1, 1)
    return states[1], covariances[1]


def sampled(share: float, gyro: Array, force: Array) -> Array:
    """Return an interval in which the platform turns faster and faster, with a sample of an IMU."""
    u = np.zeros(k.INTERVAL)
    u[k.T], u[k.FADE], u[k.IMU], u[k.IMU_AT] = T, 1.0, 1.0, share
    u[k.DTWIST : k.DTWIST + 6] = 1.0, 2.0, -3.0, *TURN
    u[k.GYRO : k.GYRO + 3], u[k.FORCE : k.FORCE + 3] = gyro, force
    return u


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
    c = pack_noise(settings, legs, tracker, imu, np.array([59.0, 61.0, 67.0]))
    expected = {
        k.Q_V: 4.0, k.Q_W: 9.0, k.Q_GYRO_BIAS: 25.0, k.Q_FORCE_BIAS: 49.0, k.LATCH: 121e-12, k.GATE: 169.0,
        k.R_LENGTH: 289.0, k.R_RATE: 361.0, k.RATE_SKEW: 529.0, k.RATE_SCALE: 841.0,
        k.LEG_FORCE_VARIANCE: 961.0, k.LEG_FORCE_TIME: 37.0, k.R_POSITION: 0.001681,
        k.R_ROTATION: (0.43 * np.pi / 180.0) ** 2, k.R_GYRO: 0.002209, k.R_FORCE: 0.2809, k.BIASED: 1.0,
        k.GRAVITY: 59.0, k.GRAVITY + 1: 61.0, k.GRAVITY + 2: 67.0,
    }  # fmt: skip
    assert {at: c[at] for at in expected} == pytest.approx(expected)
