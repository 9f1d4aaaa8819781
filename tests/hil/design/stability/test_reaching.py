"""Reaching conditions against integrated worst cases."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.design.stability.reachable import peak_gain
from hil.design.stability.reaching import Sector, redesign, sliding

SLOPE, K = 30.0, 8.0
PHI = K / SLOPE
LINEAR = (SLOPE * K / PHI, SLOPE + K / PHI)


def largest(d, gamma=1.0, linear=LINEAR, slope=SLOPE):
    """Return the largest |s| of the linear loop without sampling."""
    return d * peak_gain(gamma * linear[0], gamma * linear[1], slope, 1.0)


def test_with_an_exact_model_the_gain_has_to_exceed_the_disturbance_and_nothing_else():
    for d in (7.9, 8.1):
        found = sliding(SLOPE, K, PHI, gamma=1.0, alpha=0.0, d=d, inside=largest(d))
        assert found.covered is (d < K)
        assert found.inside == pytest.approx(PHI * d / K, rel=1e-9)
        assert found.room == np.inf


def test_the_reaching_time_is_that_of_a_disturbance_that_pushes_out():
    d, s0 = 6.0, 2.0
    found = sliding(SLOPE, K, PHI, gamma=1.0, alpha=0.0, d=d, inside=largest(d))

    def rate(t, x):
        s = x[1] + SLOPE * x[0]
        return [x[1], -SLOPE * x[1] - K * np.clip(s / PHI, -1, 1) + d]

    def inside(t, x):
        return x[1] + SLOPE * x[0] - PHI

    inside.terminal = True  # type: ignore[attr-defined]
    solution = solve_ivp(rate, (0, 5), [0.0, s0], events=inside, max_step=1e-2, rtol=1e-8)
    assert solution.t[-1] == pytest.approx(found.time_s(s0), rel=1e-4)
    assert found.time_s(0.5 * PHI) == 0.0


def test_a_model_that_is_too_light_needs_more_gain():
    """gamma = 0.8: the linear part of the law is short, too; a disturbance below gamma k may leave the layer."""
    assert sliding(SLOPE, K, PHI, gamma=0.8, alpha=0.2, d=5.0, inside=largest(5.0, 0.8)).covered
    d = 0.8 * K - 1e-3
    close = sliding(SLOPE, K, PHI, gamma=0.8, alpha=0.2, d=d, inside=largest(d, 0.8))
    assert close.surplus > 0.0
    assert not close.covered


@pytest.mark.parametrize("gamma_matrix", [[[1.2, 0.2], [0.2, 1.2]], [[0.8, -0.1], [-0.1, 0.8]]])
def test_legs_as_fast_as_is_allowed_still_reach_the_layer_at_half_the_rate(gamma_matrix):
    """d|s|/dt of the first of two coupled legs, over all signs of the other's correction, of rates and disturbance."""
    G, d = np.array(gamma_matrix), 2.0
    rest = abs(G[0, 1])
    gamma, alpha = G[0, 0] - rest, abs(G[0, 0] - 1.0) + rest
    found = sliding(SLOPE, K, PHI, gamma=gamma, alpha=alpha, d=d, inside=0.0)
    assert 0.0 < found.room < np.inf
    worst = max(
        G[0] @ (-SLOPE * found.room * np.array([a, b]) - K * np.array([1.0, c]))
        + SLOPE * found.room * a
        + d * e
        for a, b, c, e in itertools.product([-1.0, 1.0], repeat=4)
    )
    assert worst == pytest.approx(-0.5 * found.surplus)


def test_inside_is_what_the_worst_disturbance_does():
    """Bang-bang by the sign of the impulse response, by brute integration of gamma = 0.8."""
    gamma, d, n, end = 0.8, 5.0, 20_000, 1.0
    K_P, K_D = (gamma * gain for gain in LINEAR)
    h = end / n
    x, response = np.array([0.0, 1.0]), np.empty(n)
    step = np.array([[0.0, 1.0], [-K_P, -K_D]])
    for i in range(n):
        middle = x + h / 2 * step @ x
        response[i] = SLOPE * middle[0] + middle[1]
        x = x + h * step @ middle
    found = sliding(SLOPE, K, PHI, gamma=gamma, alpha=abs(1.0 - gamma), d=d, inside=largest(d, gamma))
    assert found.inside == pytest.approx(d * h * np.abs(response).sum(), rel=1e-3)


def test_without_a_layer_there_is_nothing_to_leave():
    found = sliding(SLOPE, K, 0.0, gamma=1.0, alpha=0.0, d=5.0, inside=np.inf)
    assert found.covered
    assert not sliding(SLOPE, K, 0.0, gamma=1.0, alpha=0.0, d=9.0, inside=np.inf).covered
    assert sliding(SLOPE, K, 0.0, gamma=1.0, alpha=0.0, d=9.0, inside=np.inf).time_s(1.0) == np.inf


def test_the_redesign_reaches_its_layer_with_a_correction_no_larger_than_the_disturbance():
    """Its linear part is what is left: dy/dt = -wn y at the edge, at damping ratio 1."""
    w_n, rho, epsilon = 20.0, 5.0, 0.2
    linear = (w_n**2 + rho / epsilon * w_n, 2 * w_n + rho / epsilon)
    found = redesign(
        w_n**2, 2 * w_n, rho, epsilon, gamma=1.0, alpha=0.0, d=rho, inside=largest(rho, 1.0, linear, w_n)
    )
    assert found.surplus == pytest.approx(w_n * epsilon)
    assert found.room == np.inf
    assert found.covered


def test_the_redesign_bears_less_error_the_worse_its_model_is():
    """dy/dt of gamma = 0.8 by hand from e'' = -gamma (K_D de + K_P e + w) - d, at y = epsilon."""
    w_n, rho, epsilon, gamma, d = 20.0, 5.0, 0.2, 0.8, 3.0
    linear = (w_n**2 + rho / epsilon * w_n, 2 * w_n + rho / epsilon)
    found = redesign(
        w_n**2,
        2 * w_n,
        rho,
        epsilon,
        gamma=gamma,
        alpha=abs(1.0 - gamma),
        d=d,
        inside=largest(d, gamma, linear, w_n),
    )
    e = -found.room
    de = epsilon - w_n * e
    dy = -gamma * (2 * w_n * de + w_n**2 * e + rho) + d + w_n * de
    assert dy == pytest.approx(-0.5 * found.surplus)
    assert found.time_s(epsilon - dy) == pytest.approx(1.0)


def test_legs_may_be_as_fast_as_what_is_left_of_the_gain_stops():
    """gamma k - d = 3.5 m/s^2, half of which is (1 - gamma) lambda de at 0.35 m/s: the other half is sure."""
    found = sliding(50.0, 5.0, 0.1, gamma=0.9, alpha=0.1, d=1.0, inside=0.02)
    assert found.surplus == pytest.approx(3.5)
    assert found.room == pytest.approx(0.35)
    assert found.time_s(0.1 + 1.75) == pytest.approx(1.0)


@pytest.mark.parametrize("c", [1.1, 1.5, 2.0, 3.0])
def test_a_layer_is_a_weaker_gain_and_a_rest_as_far_as_the_sector_reaches(c):
    sector = Sector.of(K, PHI, c)
    s = np.linspace(-sector.reach, sector.reach, 100_001)
    rest = K * np.clip(s / PHI, -1.0, 1.0) - sector.gain * s
    assert np.abs(rest).max() == pytest.approx(sector.rest, rel=1e-6)
    beyond = 1.01 * sector.reach
    assert abs(K - sector.gain * beyond) > sector.rest
