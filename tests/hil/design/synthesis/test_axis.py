"""The axis: its rational model and the exact sampled one."""

from __future__ import annotations

from math import atan, degrees, sqrt

import numpy as np
import pytest

from hil.config.design import DesignAxis
from hil.design.stability.sampled_loop import margins
from hil.design.synthesis.axis import actuator, four_block, lumped, pade
from hil.design.synthesis.sampled import loop_gain, sampled_axis
from hil.mathematics.linear_system import LinearSystem, static

INPUTS = ["error", "rate_error"]


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_pade_delays_and_does_not_amplify(order):
    T = 2e-3
    omega = np.array([0.0, 10.0, 400.0])
    found = pade(T, order).response(omega)[:, 0, 0]
    np.testing.assert_allclose(np.abs(found), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.angle(found), -omega * T, atol=0.05)
    assert np.angle(found[1]) == pytest.approx(-10.0 * T, abs=1e-6)


def test_the_path_of_the_bus_has_the_delay_of_transport_hold_and_lag():
    axis = DesignAxis(transport_ms=0.5, lag_ms=0.796)
    for found in (actuator(axis, 1000.0, 1), actuator(lumped(axis), 1000.0, 1)):
        slow = np.array([1.0])
        assert -np.angle(found.response(slow)[0, 0, 0]) == pytest.approx(1.796e-3, rel=1e-4)


def test_the_four_blocks_are_those_of_the_drawing():
    """e = -(d + a) / s^2, y = [e, e'] + n, at one frequency by hand."""
    path = actuator(DesignAxis(gain=0.9, transport_ms=0.5, lag_ms=0.796), 1000.0, 2)
    s = 1j * 50.0
    a = path.response(np.array([50.0]))[0, 0, 0]
    e_d, e_u = -1.0 / s**2, -a / s**2
    expected = [[e_d, 0, 0, e_u], [0, 0, 0, 1], [e_d, 1, 0, e_u], [s * e_d, 0, 1, s * e_u]]
    found = four_block(path, INPUTS).response(np.array([50.0]))[0]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("transport_ms", [0.0, 0.5, 1.0, 1.3, 2.0])
@pytest.mark.parametrize("lag_ms", [0.0, 0.8])
def test_the_sampled_axis_answers_a_step_at_every_tick_as_the_closed_form(transport_ms, lag_ms):
    h, T, L = 1e-3, 1e-3 * transport_ms, 1e-3 * lag_ms
    axis = sampled_axis(DesignAxis(gain=2.0, transport_ms=transport_ms, lag_ms=lag_ms), 1.0 / h, INPUTS)
    x = np.zeros(axis.order)
    for k in range(12):
        t = max(k * h - T, 0.0)
        fade = np.exp(-t / L) if L else 0.0
        position, rate = t * t / 2 - L * t + L * L * (1.0 - fade), t - L * (1.0 - fade)
        np.testing.assert_allclose(axis.C @ x, [-2.0 * position, -2.0 * position, -2.0 * rate], atol=1e-17)
        x = axis.A @ x + axis.B[:, 1]


def test_a_held_disturbance_acts_at_once():
    axis = sampled_axis(DesignAxis(transport_ms=1.3, lag_ms=0.8), 1000.0, INPUTS)
    x = axis.B[:, 0]
    np.testing.assert_allclose(axis.C @ x, [-0.5e-6, -0.5e-6, -1e-3])


def test_the_margins_of_critically_damped_pd_are_those_of_the_closed_form_less_the_delay():
    wn = 20.0
    axis = sampled_axis(DesignAxis(transport_ms=0.5, lag_ms=0.796), 1000.0, INPUTS)
    K = LinearSystem(*static(np.array([[wn**2, 2.0 * wn]]))[:4], 1e-3)
    found = margins(loop_gain(K, axis))
    w_c = wn * sqrt(2.0 + sqrt(5.0))
    phase = degrees(atan(2.0 * w_c / wn)) - degrees(w_c * 1.796e-3)
    assert found.crossover_rad_s == pytest.approx(w_c, rel=1e-3)
    assert found.phase_deg == pytest.approx(phase, abs=0.05)
    assert 1e3 * found.delay_s == pytest.approx(1e3 * np.deg2rad(phase) / w_c, rel=1e-3)
    assert found.gain_down == 0.0


def test_the_gain_margin_is_where_the_sampled_loop_loses_stability():
    axis = sampled_axis(DesignAxis(transport_ms=0.5, lag_ms=0.796), 1000.0, INPUTS)
    K = LinearSystem(*static(np.array([[1e4, 200.0]]))[:4], 1e-3)
    up = margins(loop_gain(K, axis)).gain_up
    stable = [axis.closed_with(K._replace(D=f * up * K.D)).is_stable() for f in (0.999, 1.001)]
    assert stable == [True, False]
