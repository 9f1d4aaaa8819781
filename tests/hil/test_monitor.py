"""Certificate monitor: its constants, and the motions that it allows."""

import math
from math import ceil
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from drivers.signals import DriveState, Mode, Warn
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.config.delay import DelayCompensation
from hil.config.limits import LimitSettings, MonitorSettings
from hil.contracts.records import record_of
from hil.control import LAWS
from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.law import LawSettings
from hil.control.pd import PDSettings
from hil.control.pose_inverse_dynamics import PoseInverseDynamicsSettings
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from hil.control.sliding_mode import SlidingModeSettings
from hil.control.uncertainty import UncertaintySettings
from hil.design.stability.monitor import build_watch, certified
from hil.mathematics.rotations import rotation_from_vector, rotation_vector
from hil.robot.kinematics import jacobian
from hil.safety import Safety
from hil.safety.certificate import NO_WATCH
from hil.safety.error_axes import error_axes

T = 1e-3
HOME = (np.array([0.0, 0.0, 1.0]), np.eye(3))
UNCERTAIN = UncertaintySettings(disturbance_m_s2=9.0)
SLIDING = SlidingModeSettings(law="sliding_mode", lambda_rad_s=50.0, uncertainty=UNCERTAIN, reaching_m_s2=1.0)
PLAIN = InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=20.0)


@pytest.fixture(scope="module")
def platform():
    return build_platform(load("virtual").platform)


def test_lyapunov_monitor_constants_of_a_critically_damped_law_agree_with_hand_calculation(platform):
    """alpha = wn / 4 = 5, V = 600 ((de + 5 e)^2 + 225 e^2)."""
    table, ticks = build_watch(MonitorSettings(action="fault"), PLAIN, platform, HOME, T)
    rows = {0: 400, 1: 40, 2: 150e3, 3: 3e3, 4: 600, 5: 8, 7: math.sqrt(600) * T, 8: math.exp(-0.01)}
    for row, value in rows.items():
        np.testing.assert_allclose(table[row], value, rtol=1e-9)
    np.testing.assert_allclose(table[6], math.sqrt(150e3) * 2e-6 + math.sqrt(600) * 1e-4)
    np.testing.assert_array_equal(table[9:11], 0.0)
    np.testing.assert_array_equal(table[11], [0, 0, 1, 2, 3, T])
    assert ticks == 2 + 3, "transport and hold, and 2.4 ms of the force loop"
    assert build_watch(MonitorSettings(), PLAIN, platform, HOME, 0.02).ticks == 2 + 1
    polled = build_watch(MonitorSettings(), PLAIN, platform, HOME, T, transport_ticks=2, lag_s=3.2e-3)
    assert polled.ticks == 3 + ceil(3 * 3.2)


def test_leg_noise_is_mapped_to_the_pose_by_the_jacobian(platform):
    settings = MonitorSettings(length_noise_m=1e-3, rate_noise_m_s=0.0, disturbance_rad_s2=3.0)
    law = PoseInverseDynamicsSettings(law="pose_inverse_dynamics", wn_rad_s=20.0)
    table, _ = build_watch(settings, law, platform, HOME, T)
    worst = 1e-3 * np.abs(np.linalg.inv(jacobian(platform, *HOME))).sum(axis=1)
    np.testing.assert_allclose(table[6], math.sqrt(150e3) * worst)
    np.testing.assert_array_equal(table[5], [8, 8, 8, 3, 3, 3])
    assert table[11, 0] == 1.0


def test_lyapunov_monitor_of_robust_laws_uses_the_gains_of_their_boundary_layers(platform):
    """k = 10 and phi = k / 50 = 0.2: two poles at 50 rad/s. rho / epsilon = 9 sqrt(6) / 0.5."""
    table, _ = build_watch(MonitorSettings(), SLIDING, platform, HOME, T)
    np.testing.assert_allclose(table[[0, 1, 9, 10], 3], [2500, 100, 50, 50])
    np.testing.assert_allclose(table[11, 1:3], [0, 0.2])
    robust = RobustInverseDynamicsSettings(
        law="robust_inverse_dynamics", wn_rad_s=60.0, uncertainty=UNCERTAIN, boundary_layer_m_s=0.5
    )
    table, _ = build_watch(MonitorSettings(), robust, platform, HOME, T)
    steep = 9 * math.sqrt(6) / 0.5
    np.testing.assert_allclose(table[[0, 1, 9, 10], 3], [3600 + 60 * steep, 120 + steep, 60, steep])
    np.testing.assert_allclose(table[11, 1:3], [1, 0.5])


def test_every_law_has_a_lyapunov_certificate_or_a_reason_why_not(platform):
    pd = PDSettings(law="pd", kp_N_m=1e6, kv_N_s_m=1e4)
    assert build_watch(MonitorSettings(), pd, platform, HOME, T) is NO_WATCH
    assert "switches" in str(certified(SLIDING.model_copy(update={"boundary_layer_m_s": 0.0})))
    watched = {name for name, law in LAWS.items() if law.uncertified == LawSettings.uncertified}
    assert watched == {
        *("inverse_dynamics", "partial_linearisation", "pose_inverse_dynamics"),
        *("sliding_mode", "robust_inverse_dynamics"),
    }


def test_pose_error_rate_agrees_with_finite_differences():
    """Platform that rotates 0.3 rad off its reference; differences over a microsecond."""

    def poses(t):
        R_d = rotation_from_vector(np.array([0.2, -0.1, 0.4])) @ rotation_from_vector(t * w_d)
        R = rotation_from_vector(np.array([0.0, 0.1, 0.2])) @ rotation_from_vector(t * w)
        return R_d, R

    w_d, w = np.array([0.5, -0.3, 0.8]), np.array([-0.2, 0.7, 0.1])  # platform frame
    (R_d, R), h = poses(0.0), 1e-6
    (a_d, a), (b_d, b) = poses(-h), poses(h)
    slope = (rotation_vector(b_d @ b.T) - rotation_vector(a_d @ a.T)) / (2 * h)
    out = [np.empty(6) for _ in range(4)]
    p, p_d, v, v_d = np.arange(12.0).reshape(4, 3) ** 2
    twist, twist_d, dtwist_d = np.hstack([v, R @ w]), np.hstack([v_d, R_d @ w_d]), np.arange(6.0)
    tick = SimpleNamespace(p=p, R=R, twist=twist, p_d=p_d, R_d=R_d, twist_d=twist_d, dtwist_d=dtwist_d)
    error_axes(True, tick, *out)
    np.testing.assert_allclose(out[0], np.hstack([p_d - p, rotation_vector(R_d @ R.T)]))
    np.testing.assert_allclose(out[1], np.hstack([v_d - v, slope]), atol=1e-8)
    np.testing.assert_array_equal(out[2:], [twist_d, dtwist_d])


LIMITS = LimitSettings(
    force_N=1.0, force_step_N=1.0, force_window_N=1.0, speed_m_s=9.0, deceleration_m_s2=9.0,
    following_error_m=9.0,
)  # fmt: skip


class Axes:
    """Six axes of wn 20 under disturbances d, with a force loop's lag and one period of transport."""

    def __init__(self, watch):
        self.safety = Safety(LIMITS, 0.0, 9.0, 1 / T, 1.0, watch=watch)
        A = np.array([[0, 1, 0, 0], [0, 0, 1, 1], [0, 0, -1 / 0.8e-3, 0], [0, 0, 0, 0]], float)
        B = np.array([[0], [0], [1 / 0.8e-3], [0]], float)
        self.rates = np.block([[A, B], [np.zeros((1, 5))]])
        self.step = expm(self.rates * T)
        self.x = np.zeros((6, 5))  # e, de, acceleration that acts, disturbance, command
        self.command = np.zeros(6)

    def tick(self, d, *, late_ns=0, off=0.0, **columns):
        """Figures of the watch and its alarm; then one period under d.

        late_ns: delay of the encoder sample; off: additional apparent error of leg 0.
        """
        self.x[:, 3] = d
        self.x[:, 4] = self.command
        e, de = (self.x @ expm(self.rates * 1e-9 * late_ns).T)[:, :2].T
        e[0] += off
        tick = record_of(
            mode=Mode.TRACKING, lateness_ns=late_ns, recorder_alive=1, drive_state=DriveState.RUN,
            length=1.0, q=1.0 - e, dq=-de, R=np.eye(3), J=np.eye(6), condition=1.0, R_d=np.eye(3), q_d=1.0,
            **{"age": 0, **columns},
        )  # fmt: skip
        verdict = self.safety.judge(tick)
        self.command = -400.0 * e - 40.0 * de
        self.x = self.x @ self.step.T
        figures = [float(tick[f"lyapunov{name}"]) for name in ("", "_rate", "_bound", "_share")]
        return figures, bool(verdict.warnings & Warn.CERTIFICATE)


@pytest.fixture(scope="module")
def exact(platform):
    """Watch without noise allowance that alarms at the first violation."""
    settings = MonitorSettings(action="warn", confirm_ticks=1, length_noise_m=0.0, rate_noise_m_s=0.0)
    return build_watch(settings, PLAIN, platform, HOME, T)


@pytest.mark.parametrize("kind", ["worst", "steps", "noise"])
def test_no_disturbance_within_its_bound_breaks_the_lyapunov_certificate(exact, kind):
    """Any disturbance of the six axes within 8 m/s^2, also one that always pushes outwards."""
    random = np.random.default_rng(7)
    axes = Axes(exact)
    largest = 0.0
    for k in range(1500):
        if kind == "worst":
            d = 8.0 * np.where(axes.x[:, 1] + 5.0 * axes.x[:, 0] >= 0.0, 1.0, -1.0)
        elif kind == "noise":
            d = random.uniform(-8.0, 8.0, 6)
        elif k % 40 == 0:
            d = random.choice([-8.0, 0.0, 8.0], 6)
        figures, alarm = axes.tick(d)
        assert not alarm, k
        if k > 1:
            largest = max(largest, figures[3])
    assert largest > (0.5 if kind == "noise" else 0.95), "the bound must be tight"


def test_late_ticks_do_not_break_the_lyapunov_certificate(exact):
    """A disturbance that pushes outwards from rest has a fifth more time until a late tick."""
    axes = Axes(exact)
    axes.tick(0.0)
    axes.tick(0.0)
    assert not any(axes.tick(8.0, late_ns=190_000 * (k % 3 > 0))[1] for k in range(200))


def test_estimated_leg_length_does_not_break_the_lyapunov_certificate(exact):
    """An extrapolated or estimated length may be wrong, and jumps when the encoder reports again."""
    one_old = {"age": [1, 0, 0, 0, 0, 0], "counted_age": [1, 0, 0, 0, 0, 0]}
    for unseen in (one_old, {"legs_used": 0b111110, "legs_lost": 1, "unseen": 1}):
        axes = Axes(exact)
        for _ in range(5):
            axes.tick(0.0)
        ticks = [axes.tick(0.0, off=1e-3 * k, **unseen) for k in range(3)]
        ticks.append(axes.tick(0.0, off=-2e-3))
        assert not any(alarm for _, alarm in ticks)
        assert np.isnan([figures[3] for figures, _ in ticks]).all()
        assert axes.tick(0.0)[0][3] < 1.0
    seen = Axes(exact)
    for _ in range(5):
        seen.tick(0.0, legs_used=0b111111)
    assert seen.tick(0.0, off=1e-3, legs_used=0b111111)[1], "the same error, measured, breaks it"


def test_disturbance_of_a_predicting_law_grows_with_its_horizon(platform):
    """Over h = 1.8 ms, 8 m/s^2 change de by 8 h and e by 8 h^2 / 2; the gains respond that much later."""
    delay = DelayCompensation(bus_ms=0.5, drive_lag_ms=0.8, hold_ms=0.5)
    law = InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=90.0, delay_compensation=delay)
    table, _ = build_watch(MonitorSettings(), law, platform, HOME, T)
    np.testing.assert_allclose(table[5], 8.0 + 180.0 * 8.0 * 1.8e-3 + 8100.0 * 4.0 * 1.8e-3**2)


@pytest.mark.parametrize("excess", [1.25, 2.0, 4.0])
def test_disturbance_beyond_its_bound_breaks_the_lyapunov_certificate_at_once(exact, excess):
    axes = Axes(exact)
    for _ in range(5):
        axes.tick(0.0)
    alarms = [axes.tick(np.array([0, 0, excess * 8.0, 0, 0, 0]))[1] for _ in range(5)]
    assert not alarms[0]
    assert any(alarms)
