"""The sampled axis and the loop around it: closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.linear_controller import LinearController
from hil.design.stability.sampled_loop import margins, sampled_axis, sampled_controller
from hil.mathematics.linear_system import LinearSystem, lag, static

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
    axis = sampled_axis(1e-3 * transport_ms, lag(1e-3 * lag_ms), T, gain=2.0)
    found = step_response(axis, 12)
    t, late = np.maximum(T * np.arange(12) - 1e-3 * transport_ms, 0.0), 1e-3 * lag_ms
    gone = np.exp(-t / late) if late else np.zeros(12)
    position = t * t - 2 * late * t + 2 * late * late * (1 - gone)
    np.testing.assert_allclose(found, np.column_stack([position, 2 * t - 2 * late * (1 - gone)]), atol=1e-15)


def test_the_margins_of_a_pd_are_those_of_its_continuous_loop_less_half_a_period():
    """At damping ratio 1: 2.0582 wn and 76.345 deg; a hold of 0.1 ms takes w_c T / 2."""
    period = 1e-4
    found = margins(PD._replace(period_s=period).after(sampled_axis(0.0, lag(0.0), period)))
    assert found.crossover_rad_s == pytest.approx(2.0582 * W_N, rel=1e-4)
    assert found.phase_deg == pytest.approx(76.345 - np.degrees(2.0582 * W_N * period / 2), abs=0.01)
    w = np.geomspace(1.0, 1e3, 4001)  # S = s^2 / (s + wn)^2, T = (2 wn s + wn^2) / (s + wn)^2
    assert found.peak_S == pytest.approx(1.0, abs=5e-3)
    assert found.peak_T == pytest.approx(np.abs((40j * w + 400) / (1j * w + 20) ** 2).max(), rel=3e-3)


@pytest.mark.parametrize("transport_s", [0.0, 0.4e-3, 0.026])
def test_a_delay_takes_its_share_of_the_margin(transport_s):
    """76.345 deg at 41.16 rad/s are 32.4 ms, half a period of hold included."""
    found = margins(PD.after(sampled_axis(transport_s, lag(0.0), T)))
    left = 76.345 - np.degrees(2.0582 * W_N * (transport_s + T / 2))
    assert found.phase_deg == pytest.approx(left, abs=0.1)
    assert found.delay_s == pytest.approx(np.radians(left) / (2.0582 * W_N), rel=3e-3)


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
