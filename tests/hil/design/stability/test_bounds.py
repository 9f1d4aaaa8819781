"""Lyapunov functions, peak gains and reaching conditions of an axis, against scipy, closed forms and brute force."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import minimize_scalar

from drivers.errors import ModelError
from hil.design.stability.error_dynamics import certificate, tightest_alpha
from hil.design.stability.reachable import norm_bound, peak_gain
from hil.design.stability.reaching import Sector, redesign, sliding

AXES = [(400.0, 40.0), (400.0, 20.0), (400.0, 8.0), (400.0, 100.0), (3.0, 0.4), (8464.0, 184.0)]
axes = pytest.mark.parametrize(("K_P", "K_D"), AXES)
B = np.array([[0.0], [1.0]])


def matrix(K_P, K_D):
    return np.array([[0.0, 1.0], [-K_P, -K_D]])


@axes
def test_no_other_alpha_gives_a_smaller_bound(K_P, K_D):
    def size(alpha):
        W = solve_continuous_lyapunov(matrix(K_P, K_D) + alpha * np.eye(2), -B @ B.T / (2 * alpha))
        return np.log(W[0, 0])

    slowest = -np.linalg.eigvals(matrix(K_P, K_D)).real.max()
    best = minimize_scalar(
        size, bounds=(1e-3 * slowest, 0.999 * slowest), method="bounded", options={"xatol": 1e-9}
    )
    assert tightest_alpha(K_P, K_D) == pytest.approx(best.x, rel=1e-4)
    assert np.log(certificate(K_P, K_D).error_gain()[0] ** 2) <= best.fun + 1e-9


def test_the_bound_of_critical_damping_in_closed_form():
    found = certificate(20.0**2, 2 * 20.0)
    np.testing.assert_allclose(found.alpha, 5.0, rtol=1e-12)
    np.testing.assert_allclose(found.error_gain(), np.sqrt(32 / 27) / 20.0**2, rtol=1e-12)


@axes
def test_V_falls_as_the_certificate_says_whatever_the_disturbance(K_P, K_D):
    """dV/dt + 2 alpha (V - d^2) is a quadratic form in e, de and d: none of its eigenvalues is above zero."""
    found = certificate(K_P, K_D)
    basis = np.eye(3)
    scale = np.array([1 / K_P, 1 / np.sqrt(K_P), 1.0])

    def form(x):
        e, de, d = (np.full(6, v) for v in x * scale)
        return (found.dV(e, de, d) + 2 * found.alpha * (found.V(e, de) - d**2))[0]

    matrix = [[(form(a + b) - form(a - b)) / 4 for b in basis] for a in basis]
    eigenvalues = np.linalg.eigvalsh(matrix)
    assert eigenvalues.max() <= 1e-9 * np.abs(eigenvalues).max()
    assert abs(eigenvalues.max()) <= 1e-9 * np.abs(eigenvalues).max(), (
        "and one is zero: nothing is given away"
    )


@pytest.mark.parametrize(("K_P", "K_D", "alpha"), [(0.0, 1.0, None), (1.0, -1.0, None), (400.0, 40.0, 20.0)])
def test_a_decay_that_no_axis_has_is_refused(K_P, K_D, alpha):
    with pytest.raises(ModelError, match=r"both above 0|below the decay rate"):
        certificate(np.full(6, K_P), np.full(6, K_D), alpha=alpha)


OUTPUTS = [(1.0, 0.0), (0.0, 1.0), (92.0, 1.0), (400.0, 40.0), (-5.0, 1.0), (20.0, 1.0)]


@pytest.mark.parametrize(("K_P", "K_D"), AXES)
@pytest.mark.parametrize(("c_e", "c_de"), OUTPUTS)
def test_the_peak_gain_is_the_area_under_the_impulse_response(K_P, K_D, c_e, c_de):
    doublings = 14
    period = 25 / -np.roots([1, K_D, K_P]).real.max() / 2**doublings
    A = np.array([[0.0, 1.0], [-K_P, -K_D]])
    x = np.array([[0.0], [1.0]])
    Phi = expm(A * period)
    for _ in range(doublings):
        x, Phi = np.hstack([x, Phi @ x]), Phi @ Phi
    h = np.array([c_e, c_de]) @ x
    assert peak_gain(K_P, K_D, c_e, c_de) == pytest.approx(np.trapezoid(np.abs(h)) * period, rel=5e-4)


@pytest.mark.parametrize(("K_P", "K_D"), AXES)
def test_the_ellipsoid_lies_between_what_is_attained_and_twice_that(K_P, K_D):
    assert peak_gain(K_P, K_D) <= certificate(K_P, K_D).error_gain()[0] <= 2.0 * peak_gain(K_P, K_D)
    assert peak_gain(K_P, K_D, 0, 1) <= certificate(K_P, K_D).rate_gain()[0]


def test_the_textbooks_norm_bound_is_hundreds_of_times_too_loose():
    """By hand for wn = 5, Q = I: P = [1.5 0.02; 0.02 0.052], of which only the eigenvalues count."""
    for w_n in (5.0, 10.0, 20.0):
        least = peak_gain(w_n**2, 2 * w_n)
        assert certificate(w_n**2, 2 * w_n).error_gain()[0] / least == pytest.approx(
            np.sqrt(32 / 27), rel=1e-9
        )
        assert norm_bound(w_n**2, 2 * w_n) / least > 200.0
    least, largest = np.linalg.eigvalsh([[1.5, 0.02], [0.02, 0.052]])
    assert norm_bound(25.0, 10.0) == pytest.approx(2 * largest * np.sqrt(largest / least), rel=1e-9)


def test_a_disturbance_by_the_impulse_response_attains_the_peak_gain():
    """Bang-bang: d(t) = sgn h(T - t), here of a lightly damped axis."""
    K_P, K_D, end, n = 400.0, 8.0, 2.5, 5000
    t = (np.arange(n) + 0.5) * end / n
    w = np.sqrt(K_P - K_D**2 / 4)
    d = np.sign(np.sin(w * (end - t)))
    step = expm(np.array([[0, 1, 0], [-K_P, -K_D, 1], [0, 0, 0]]) * end / n)
    x = np.zeros(2)
    for k in range(n):
        x = step[:2, :2] @ x + step[:2, 2] * d[k]
    assert x[0] == pytest.approx(peak_gain(K_P, K_D), rel=1e-3)
    assert x[0] <= certificate(K_P, K_D).error_gain()[0]


SLOPE, K = 30.0, 8.0
PHI = K / SLOPE
LINEAR = (SLOPE * K / PHI, SLOPE + K / PHI)


def largest(d, gamma=1.0, linear=LINEAR, slope=SLOPE):
    """The largest |s| of the linear loop without sampling."""
    return d * peak_gain(gamma * linear[0], gamma * linear[1], slope, 1.0)


def test_with_an_exact_model_the_gain_has_to_exceed_the_disturbance():
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


def test_the_redesign_reaches_its_layer_with_the_disturbance_as_correction():
    """Its linear part is what is left: dy/dt = -wn y at the edge, at damping ratio 1."""
    w_n, rho, epsilon = 20.0, 5.0, 0.2
    linear = (w_n**2 + rho / epsilon * w_n, 2 * w_n + rho / epsilon)
    found = redesign(
        w_n**2, 2 * w_n, rho, epsilon, gamma=1.0, alpha=0.0, d=rho, inside=largest(rho, 1.0, linear, w_n)
    )
    assert found.surplus == pytest.approx(w_n * epsilon)
    assert found.room == np.inf
    assert found.covered


@pytest.mark.parametrize("c", [1.1, 1.5, 2.0, 3.0])
def test_a_layer_is_a_weaker_gain_and_a_rest_as_far_as_the_sector_reaches(c):
    sector = Sector.of(K, PHI, c)
    s = np.linspace(-sector.reach, sector.reach, 100_001)
    rest = K * np.clip(s / PHI, -1.0, 1.0) - sector.gain * s
    assert np.abs(rest).max() == pytest.approx(sector.rest, rel=1e-6)
    beyond = 1.01 * sector.reach
    assert abs(K - sector.gain * beyond) > sector.rest
