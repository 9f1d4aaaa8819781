"""Six coupled axes against one: modes of equal gains are axes of their own."""

import numpy as np
import pytest

from hil.design.stability.coupled import delay_margin_s, growth, integrating, proportional
from hil.design.stability.sampled import Axis, analyse, gains

T = 1e-3
AXIS = Axis(T, 0.5e-3, 0.8e-3)
MASSES = np.array([100.0, 150.0, 200.0, 300.0, 400.0, 800.0])
Q = np.linalg.qr(np.random.default_rng(3).standard_normal((6, 6)))[0]
MOBILITY = Q @ np.diag(1 / MASSES) @ Q.T


def test_equal_gains_fall_into_the_modes_of_the_inertia():
    controller = proportional(np.full(6, 1e6), np.full(6, 2e4), T)
    modes = [np.abs(analyse(AXIS, gains(1e6 / m, 2e4 / m, T)).poles).max() for m in MASSES]
    assert growth(AXIS, controller, MOBILITY) == pytest.approx(max(modes), abs=1e-9)


def test_the_delay_margin_is_the_least_of_the_modes():
    controller = proportional(np.full(6, 1e6), np.full(6, 2e4), T)
    found = [analyse(AXIS, gains(1e6 / m, 2e4 / m, T)).margins for m in MASSES]
    least = min(m.delay_s for m in found if m is not None)
    assert delay_margin_s(AXIS, controller, MOBILITY) == pytest.approx(least, rel=0.01)


def test_an_integral_has_the_limit_of_routh_and_hurwitz():
    """m s^3 + K_v s^2 + K_p s + K_i: stable for K_i < K_p K_v / m; a period of 0.1 ms is nearly continuous."""
    m, K_p, K_v, fine = 200.0, 1e5, 1e4, Axis(1e-4)
    limit = K_p * K_v / m
    for share, stable in ((0.97, True), (1.03, False)):
        controller = integrating(np.full(6, K_p), np.full(6, K_v), np.full(6, share * limit), 1e-4)
        assert (growth(fine, controller, np.eye(6) / m) < 1.0) is stable


def test_what_the_axes_springs_do_at_once_is_in_the_loop_beside_what_the_law_does_late():
    """m p'' = -k p + u of one period before: exact by sine and cosine."""
    m, K_p, K_v = 20.0, 1e4, 1e3
    for k in (0.0, 1e5, 1e7, 1e8):
        w = np.sqrt(k / m)
        c, s = np.cos(w * T), np.sin(w * T)
        turn = np.array([[c, s / w], [-w * s, c]]) if k else np.array([[1.0, T], [0.0, 1.0]])
        push = [(1.0 - c) / k, s / (m * w)] if k else [T * T / (2.0 * m), T / m]
        A = np.block([[turn, np.transpose([push])], [np.array([[-K_p, -K_v, 0.0]])]])
        expected = np.abs(np.linalg.eigvals(A)).max()
        controller = proportional(np.full(6, K_p), np.full(6, K_v), T)
        found = growth(Axis(T, T), controller, np.eye(6) / m, k * np.eye(6))
        assert found == pytest.approx(expected, abs=1e-6), k


@pytest.mark.parametrize("lag_s", [0.0, 0.8e-3])
def test_springs_turned_by_any_coordinates_grow_alike_and_the_margin_is_where_they_do(lag_s):
    """A loop that a spring of its own takes from 13 to 1.4 ms of further delay."""
    controller = proportional(np.full(6, 1e5), np.full(6, 1e4), T)
    springs = Q @ np.diag(np.full(6, 2e7)) @ Q.T
    assert growth(Axis(T, 0.5e-3, lag_s), controller, MOBILITY, springs) < 1.0
    margin = delay_margin_s(Axis(T, 0.5e-3, lag_s), controller, MOBILITY, springs)
    assert margin < 0.7 * delay_margin_s(Axis(T, 0.5e-3, lag_s), controller, MOBILITY)
    for share, stable in ((0.97, True), (1.03, False)):
        late = Axis(T, 0.5e-3 + share * margin, lag_s)
        assert (growth(late, controller, MOBILITY, springs) < 1.0) is stable
