"""The sampled loop against hand calculation, Jury's criterion, and roots found elsewhere."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from drivers.errors import ModelError
from hil.design.stability.sampled import Axis, _closed, analyse, disturbed_axis, gains
from hil.mathematics.linear_system import LinearSystem, static

T = 1e-3


def margins_of(axis, controller):
    margins = analyse(axis, controller).margins
    assert margins is not None
    return margins


def test_a_double_integrator_under_pd_has_the_eigenvalues_of_its_polynomial():
    """z^2 - (2 - K_D T - K_P T^2 / 2) z + 1 - K_D T + K_P T^2 / 2, from [1 T; 0 1] - [T^2/2; T] [K_P K_D]."""
    K_P, K_D = 400.0, 40.0
    found = analyse(Axis(T), gains(K_P, K_D, T))
    expected = np.roots([1, -(2 - K_D * T - K_P * T**2 / 2), 1 - K_D * T + K_P * T**2 / 2])
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(expected), atol=1e-9)
    assert found.stable


@pytest.mark.parametrize("K_D", [40.0, 400.0])
def test_jurys_criterion_tells_the_largest_gain(K_D):
    """|a_0| < 1 gives K_P < 2 K_D / T; 1 - a_1 + a_0 > 0 gives K_D < 2 / T: times the gain, the first is none."""
    K_P = K_D**2 / 4
    margins = margins_of(Axis(T), gains(K_P, K_D, T))
    assert margins.gain_up == pytest.approx(2 / (K_D * T), rel=1e-6)
    assert margins.gain_down == 0.0
    assert analyse(Axis(T, gain=0.999 * margins.gain_up), gains(K_P, K_D, T)).stable
    assert not analyse(Axis(T, gain=1.001 * margins.gain_up), gains(K_P, K_D, T)).stable


def test_the_delay_at_which_the_continuous_loop_turns_unstable_is_its_phase_margin_over_its_crossover():
    """A period of 10 us is continuous: wn 20, w_c = 2.058 wn, 76.35 deg."""
    margins = margins_of(Axis(1e-5), gains(400.0, 40.0, 1e-5))
    w_c = 20 * np.sqrt(2 + np.sqrt(5))
    assert margins.crossover_rad_s == pytest.approx(w_c, rel=1e-4)
    assert margins.phase_deg == pytest.approx(np.degrees(np.arctan(2 * w_c / 20)), abs=0.05)
    assert margins.delay_s == pytest.approx(np.arctan(2 * w_c / 20) / w_c, rel=1e-3)


@pytest.mark.parametrize(
    ("transport", "lag"), [(0.0, 0.0), (0.4e-3, 0.0), (0.5e-3, 1 / 1257), (2.3e-3, 0.8e-3)]
)
@pytest.mark.parametrize("w_n", [20.0, 90.0])
def test_the_delay_margin_is_where_the_eigenvalues_leave_the_circle(transport, lag, w_n):
    controller = gains(w_n**2, 2 * w_n, T)
    margin = margins_of(Axis(T, transport, lag), controller).delay_s

    def radius(further):
        loop = _closed(disturbed_axis(Axis(T, transport + further, lag)), controller)
        return np.abs(loop.poles()).max() - 1.0

    limit = brentq(radius, 0.0, 2.0 * margin, xtol=1e-3 * margin)
    assert limit == pytest.approx(margin, rel=4e-3), "a delay within a period is no pure phase to a hold"


def test_a_delay_within_a_period_is_exact():
    """One step of u from rest: the position of a lagging, late double integrator, integrated by scipy."""
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


def test_without_delay_the_peak_gain_is_the_compliance():
    assert analyse(Axis(T), gains(400.0, 40.0, T)).peak_gain == pytest.approx(1 / 400.0, rel=1e-3)


def test_delay_makes_the_same_disturbance_cost_more():
    late = analyse(Axis(T, 12e-3), gains(1600.0, 80.0, T)).peak_gain
    assert late > 1.05 / 1600.0


def test_a_lead_compensator_on_the_position_alone_is_a_controller_like_any():
    """u[k] = K (e - 0.9 e[k-1]) / (1 - 0.3 z^-1): with the characteristic polynomial written out by hand."""
    K, a, b = 2e4, 0.97, 0.5
    lead = LinearSystem(
        np.array([[b]]), np.array([[1.0, 0.0]]), np.array([[K * (b - a)]]), np.array([[K, 0.0]]), T
    )
    found = analyse(Axis(T), lead)
    open_numerator = np.polymul([K, -K * a], [T**2 / 2, T**2 / 2])
    polynomial = np.polyadd(np.polymul([1, -b], [1, -2, 1]), open_numerator)
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(np.roots(polynomial)), atol=1e-9)
    assert found.stable


def test_too_much_gain_is_unstable_and_has_no_margins():
    found = analyse(Axis(T, 0.5e-3, 1 / 1257), gains(500.0**2, 1000.0, T))
    assert not found.stable
    assert found.margins is None
    assert found.decay_rate < 0.0
    assert np.isinf(found.peak_gain)


def test_what_is_no_controller_of_an_error_and_its_rate_is_refused():
    with pytest.raises(ModelError, match=r"allowed: from \[e, de\] to u"):
        analyse(Axis(T), static(np.array([[1.0]]), T))
