"""The integral of the PID: its growth, its anti-windup, and the remaining error at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load, loads
from hil.contracts.records import asked, record_of
from hil.control.pd import JointPD
from hil.control.pid import JointPID
from tests.loop import bench

NONE = np.zeros(6)
PERIOD = 1e-3
K_P, K_V, K_I = 2e6, 5e4, 1e7
T_T = np.sqrt(K_V / K_I)


def pid(limit=1e9, **options):
    pd = JointPD(np.full(6, K_P), np.full(6, K_V), NONE)
    return JointPID(pd, np.full(6, K_I), np.full(6, limit), PERIOD, **options)


def error(e):
    """A tick at rest with q_d - q = e."""
    return record_of(q_d=e, R=np.eye(3), R_d=np.eye(3), J=np.eye(6))


def test_integral_of_pid_sums_errors_times_period_up_to_its_limit():
    law, limited = pid(), pid(limit=300.0)
    errors = np.random.default_rng(3).normal(0.0, 1e-3, (50, 6))
    for e in errors:
        tau = asked(law, error(e))
    np.testing.assert_allclose(tau, K_P * errors[-1] + K_I * PERIOD * errors.sum(axis=0), rtol=1e-12)
    for sign in (1.0, -1.0):
        for _ in range(1000):
            tau = asked(limited, error(sign * 1e-3))
        assert (tau == sign * (K_P * 1e-3 + 300.0)).all()


def held_at(law, e, limit, calls):
    """Apply a constant error while the force is limited to `limit` N; return the last force requested."""
    shortfall = NONE
    for _ in range(calls):
        tau = asked(law, error(e), shortfall=shortfall)
        shortfall = np.clip(tau, -limit, limit) - tau
    return tau


@pytest.mark.parametrize("e", [2e-3, -2e-3])
def test_integral_of_pid_settles_under_a_force_limit_by_back_calculation(e):
    """K_i e + (limit - tau) / T_t = 0: the request settles at T_t K_i e above the limit, after any number of calls."""
    law = pid()
    expected = np.sign(e) * 1000.0 + T_T * K_I * e
    for calls in (2_000, 20_000):
        law.reset()
        np.testing.assert_allclose(held_at(law, e, 1000.0, calls), expected, rtol=1e-9)


def test_force_of_pid_leaves_its_limit_as_soon_as_the_error_changes_sign():
    """After 20 s at the limit: at once with back-calculation; the stored force takes 20 s more without it."""
    law = pid()
    held_at(law, 2e-3, 1000.0, 20_000)
    assert asked(law, error(-1e-4)).max() < 1000.0
    blind = pid()
    for _ in range(20_000):
        asked(blind, error(2e-3))
    assert asked(blind, error(-1e-4)).min() > 100_000.0


def test_anti_windup_of_pid_uses_the_given_tracking_time_but_at_least_one_period():
    for T_t, share in ((0.25, 0.004), (1e-9, 1.0)):
        law = pid(T_t=T_t)
        asked(law, error(0.0), shortfall=-100.0)
        np.testing.assert_allclose(law.xi, -100.0 * share, rtol=1e-12)


@pytest.fixture(scope="module")
def held():
    """2.5 s at home under PID on the virtual bus, with the brakes engaged at both ends."""
    text = load("virtual").text
    law = "law: pid\n  kp_N_m: 2.0e+6\n  kv_N_s_m: 5.0e+4\n  ki_N_m_s: 2.0e+7\n  integral_limit_N: 8000\n\n"
    for first, last, new in (
        ("controller:", "engage:", f"controller:\n  {law}"),
        ("reference:", "limits:", "reference:\n  type: hold\n  duration_s: 1.5\n\n"),
    ):
        a, b = text.index("\n" + first) + 1, text.index("\n" + last) + 1
        text = text[:a] + new + text[b:]
    ran = bench.run(loads(text, "pid.yaml", Path()))
    assert ran.ending.success, ran.ending
    return ran.rows


def test_pid_removes_the_steady_error_under_gravity(held):
    """The book's static force is 3618.6 N in each leg: the PD alone sags by 1.81 mm."""
    tracking = held[held["mode"] == Mode.TRACKING]
    assert np.abs(tracking["tau"][-1] - 3618.6).max() < 5.0
    assert np.abs(tracking["q_d"] - tracking["q"])[-1].max() < 5e-6


def test_integral_of_pid_takes_over_the_holding_force_without_a_jump(held):
    """The offset F fades as a quintic within 0.5 s: the error stays below max|dF/dt| / K_i."""
    moving = held[(held["mode"] >= Mode.RELEASING) & (held["mode"] <= Mode.TRACKING)]
    assert np.abs(np.diff(moving["tau"], axis=0)).max() < 20.0
    bound = 1.875 * 3618.6 / 0.5 / 2e7
    assert 0.7 * bound < np.abs(moving["q_d"] - moving["q"]).max() < bound
