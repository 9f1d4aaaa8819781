"""The sampled loop of one axis and of six coupled ones, against hand calculation and independent root finding."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from hil.config.linear_controller import LinearController
from hil.design.stability.sampled_loop import (
    Axis,
    _closed,
    analyse,
    disturbed_axis,
    gains,
    predicting,
    sampled_controller,
)
from hil.design.stability.springs import Springs
from hil.mathematics.linear_system import LinearSystem

T = 1e-3


def margins_of(axis, controller):
    margins = analyse(axis, controller).margins
    assert margins is not None
    return margins


def test_double_integrator_under_sampled_pd_has_the_roots_of_its_polynomial():
    """z^2 - (2 - K_D T - K_P T^2 / 2) z + 1 - K_D T + K_P T^2 / 2, from [1 T; 0 1] - [T^2/2; T] [K_P K_D]."""
    K_P, K_D = 400.0, 40.0
    found = analyse(Axis(T), gains(K_P, K_D, T))
    expected = np.roots([1, -(2 - K_D * T - K_P * T**2 / 2), 1 - K_D * T + K_P * T**2 / 2])
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(expected), atol=1e-9)
    assert found.stable


@pytest.mark.parametrize("K_D", [40.0, 400.0])
def test_the_upper_gain_margin_matches_jurys_criterion(K_D):
    """|a_0| < 1 gives K_P < 2 K_D / T, for every gain; 1 - a_1 + a_0 > 0 gives K_D < 2 / T, which limits the gain."""
    K_P = K_D**2 / 4
    margins = margins_of(Axis(T), gains(K_P, K_D, T))
    assert margins.gain_up == pytest.approx(2 / (K_D * T), rel=1e-6)
    assert margins.gain_down == 0.0
    assert analyse(Axis(T, gain=0.999 * margins.gain_up), gains(K_P, K_D, T)).stable
    assert not analyse(Axis(T, gain=1.001 * margins.gain_up), gains(K_P, K_D, T)).stable


@pytest.mark.parametrize(
    ("transport", "lag"), [(0.0, 0.0), (0.4e-3, 0.0), (0.5e-3, 1 / 1257), (2.3e-3, 0.8e-3)]
)
@pytest.mark.parametrize("w_n", [20.0, 90.0])
def test_delay_equal_to_the_delay_margin_puts_eigenvalues_on_the_unit_circle(transport, lag, w_n):
    controller = gains(w_n**2, 2 * w_n, T)
    margin = margins_of(Axis(T, transport, lag), controller).delay_s

    def radius(further):
        loop = _closed(disturbed_axis(Axis(T, transport + further, lag)), controller)
        return np.abs(loop.poles()).max() - 1.0

    limit = brentq(radius, 0.0, 2.0 * margin, xtol=1e-3 * margin)
    assert limit == pytest.approx(margin, rel=4e-3), "a delay within a period is no pure phase to a hold"


def test_response_of_a_sampled_axis_with_a_fractional_delay_is_exact():
    """Response to one period of u from rest: position of a delayed double integrator with lag, by SciPy."""
    axis = Axis(T, 1.3e-3, 0.8e-3, 0.9)
    system = disturbed_axis(axis)
    x, found = np.zeros((system.order, 1)), []
    for k in range(5):
        found.append((system.C @ x)[:, 0])
        x = system.A @ x + system.B[:, :1] * (1.0 if k == 0 else 0.0)

    def rate(t, x):
        u = 0.9 if 1.3e-3 <= t < 2.3e-3 else 0.0
        return [x[1], x[2], (u - x[2]) / 0.8e-3]

    times = np.arange(5) * T
    solution = solve_ivp(rate, (0, 4 * T), [0.0, 0, 0], t_eval=times, max_step=1e-6, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(np.array(found), solution.y[:2].T, atol=2e-9)


def test_sampled_loop_with_too_much_gain_is_unstable_and_has_no_margins():
    found = analyse(Axis(T, 0.5e-3, 1 / 1257), gains(500.0**2, 1000.0, T))
    assert not found.stable
    assert found.margins is None
    assert found.decay_rate < 0.0
    assert np.isinf(found.peak_gains()[0])


def test_peak_gain_of_pd_is_its_compliance_and_grows_with_the_delay():
    assert analyse(Axis(T), gains(400.0, 40.0, T)).peak_gains()[0] == pytest.approx(1 / 400.0, rel=1e-3)
    assert analyse(Axis(T, 12e-3), gains(1600.0, 80.0, T)).peak_gains()[0] > 1.05 / 1600.0


def test_inputs_of_a_controller_file_are_reordered_to_error_and_rate():
    given = LinearController(
        kind="linear-controller",
        method="mu",
        axes="pose",
        rate_Hz=500.0,
        inputs=["rate_error", "error"],
        A=[[0.5]],
        B=[[1.0, 2.0]],
        C=[[3.0]],
        D=[[4.0, 5.0]],
        anti_windup=[0.0],
        design={},
    )
    expected = LinearSystem(
        np.array([[0.5]]), np.array([[2.0, 1.0]]), np.array([[3.0]]), np.array([[5.0, 4.0]]), 2e-3
    )
    for mine, theirs in zip(sampled_controller(given), expected, strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("lag", [0.0, 0.8e-3])
@pytest.mark.parametrize("bus", [0.0, 0.5e-3, 1e-3, 2.3e-3])
def test_an_exact_prediction_leaves_the_slow_poles_of_the_loop_without_delay(bus, lag):
    """Critically damped, wn 20: a double continuous pole at -20."""
    controller = predicting(400.0, 40.0, T, bus_s=bus, lag_s=lag, hold_s=0.5e-3)
    found = analyse(Axis(T, bus, lag), controller)
    slow = np.log(found.poles[np.argsort(-np.abs(found.poles))][:2]) / T
    assert found.stable
    np.testing.assert_allclose(np.mean(slow), -20.0, rtol=0.01)


AXIS = Axis(T, 0.5e-3, 0.8e-3)
MASSES = np.array([100.0, 150.0, 200.0, 300.0, 400.0, 800.0])
Q = np.linalg.qr(np.random.default_rng(3).standard_normal((6, 6)))[0]
MOBILITY = Q @ np.diag(1 / MASSES) @ Q.T


def springs(mobility, K_p, K_v, own=0.0, K_i=0.0):
    law, damping, own, integral = (np.broadcast_to(gain, 6) * np.eye(6) for gain in (K_p, K_v, own, K_i))
    return Springs(mobility, law, damping, own, integral)


def test_growth_of_coupled_legs_with_equal_pd_gains_is_that_of_their_worst_mode():
    modes = [np.abs(analyse(AXIS, gains(1e6 / m, 2e4 / m, T)).poles).max() for m in MASSES]
    assert springs(MOBILITY, 1e6, 2e4).growth(AXIS) == pytest.approx(max(modes), abs=1e-9)


def test_margins_of_coupled_legs_are_the_smallest_over_their_modes():
    found = [analyse(AXIS, gains(1e6 / m, 2e4 / m, T)).margins for m in MASSES]
    coupled = springs(MOBILITY, 1e6, 2e4)
    assert coupled.margins(AXIS)[0] == pytest.approx(min(m.delay_s for m in found if m), rel=0.01)
    assert coupled.margins(AXIS)[2] == pytest.approx(min(m.phase_deg for m in found if m), rel=0.01)
    assert coupled.gain_up(AXIS) == pytest.approx(min(m.gain_up for m in found if m), rel=1e-4)


@pytest.mark.parametrize("K_v", [4e3, 2e4])
def test_error_of_equal_legs_by_a_force_is_that_of_a_single_leg(K_v):
    found = springs(np.eye(6) / 200.0, 1e5, K_v).per_force(AXIS, np.eye(6))
    single = analyse(AXIS, gains(1e5 / 200.0, K_v / 200.0, T)).peak_gains()[0] / 200.0
    assert found == pytest.approx(single, rel=0.01)


def test_the_integral_gain_limit_is_that_of_routh_and_hurwitz():
    """m s^3 + K_v s^2 + K_p s + K_i: stable for K_i < K_p K_v / m; a period of 0.1 ms is nearly continuous."""
    m, K_p, K_v, fine = 200.0, 1e5, 1e4, Axis(1e-4)
    for share, stable in ((0.97, True), (1.03, False)):
        found = springs(np.eye(6) / m, K_p, K_v, K_i=share * K_p * K_v / m)
        assert (found.growth(fine) < 1.0) is stable
        assert (found.slowest() < 0.0) is stable


def test_axis_springs_act_without_delay_and_the_law_with_delay():
    """m p'' = -k p + u, u one period old: exact solution with sine and cosine."""
    m, K_p, K_v = 20.0, 1e4, 1e3
    for k in (0.0, 1e5, 1e7, 1e8):
        w = np.sqrt(k / m)
        c, s = np.cos(w * T), np.sin(w * T)
        turn = np.array([[c, s / w], [-w * s, c]]) if k else np.array([[1.0, T], [0.0, 1.0]])
        push = [(1.0 - c) / k, s / (m * w)] if k else [T * T / (2.0 * m), T / m]
        A = np.block([[turn, np.transpose([push])], [np.array([[-K_p, -K_v, 0.0]])]])
        expected = np.abs(np.linalg.eigvals(A)).max()
        assert springs(np.eye(6) / m, K_p, K_v, k).growth(Axis(T, T)) == pytest.approx(expected, abs=1e-6), k
