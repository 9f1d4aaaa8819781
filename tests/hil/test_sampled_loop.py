"""The sampled axis and the loop around it: closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.linear_controller import LinearController
from hil.linear_system import LinearSystem, static
from hil.sampled_loop import margins, sampled_axis, sampled_controller

T = 1e-3
W_N = 20.0
PD = static(np.array([[W_N**2, 2 * W_N]]), T)


def step_response(axis, count):
    x, found = np.zeros(axis.order), []
    for _ in range(count):
        found.append(axis.C @ x)
        x = axis.A @ x + axis.B[:, 0]
    return np.array(found)


@pytest.mark.parametrize("transport_ms", [0.0, 0.3, 0.5, 1.0, 1.7, 3.0])
@pytest.mark.parametrize("lag_ms", [0.0, 0.8])
def test_the_axis_answers_a_step_as_its_differential_equation_does(transport_ms, lag_ms):
    """lag y''' + y'' = 2 from transport on: y = t^2 - 2 lag t + 2 lag^2 (1 - exp(-t / lag))."""
    axis = sampled_axis(1e-3 * transport_ms, 1e-3 * lag_ms, T, gain=2.0)
    found = step_response(axis, 12)
    t, lag = np.maximum(T * np.arange(12) - 1e-3 * transport_ms, 0.0), 1e-3 * lag_ms
    gone = np.exp(-t / lag) if lag else np.zeros(12)
    position = t * t - 2 * lag * t + 2 * lag * lag * (1 - gone)
    np.testing.assert_allclose(found, np.column_stack([position, 2 * t - 2 * lag * (1 - gone)]), atol=1e-15)


def test_the_margin_of_a_pd_is_that_of_its_continuous_loop_less_half_a_period():
    """At damping ratio 1: 2.0582 wn and 76.345 deg; a hold of 0.1 ms takes w_c T / 2."""
    period = 1e-4
    found = margins(PD._replace(period_s=period), sampled_axis(0.0, 0.0, period))
    assert found.cross_over_rad_s == pytest.approx(2.0582 * W_N, rel=1e-4)
    assert found.phase_deg == pytest.approx(76.345 - np.degrees(2.0582 * W_N * period / 2), abs=0.01)
    assert found.pole_radius < 1.0


@pytest.mark.parametrize(("transport_s", "stable"), [(0.026, True), (0.034, False)])
def test_a_delay_that_takes_the_whole_margin_makes_the_loop_unstable(transport_s, stable):
    """76.345 deg at 41.16 rad/s are 32.4 ms, half a period of hold included."""
    found = margins(PD, sampled_axis(transport_s, 0.0, T))
    assert (found.pole_radius < 1.0) == stable
    assert np.isfinite(found.sensitivity) == stable
    left = 76.345 - np.degrees(2.0582 * W_N * (transport_s + T / 2))
    assert found.phase_deg == pytest.approx(abs(left), abs=0.1)


def test_a_files_controller_is_told_error_and_rate_in_this_order():
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
