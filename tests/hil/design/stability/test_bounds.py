"""Lyapunov functions, peak gains and reaching conditions of an axis, against SciPy, closed forms and brute force."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import minimize_scalar
from scipy.signal import impulse

from drivers.errors import ModelError
from hil.design.stability.error_dynamics import certificate, tightest_alpha
from hil.design.stability.reaching import redesign, sliding
from hil.design.stability.sampled_loop import Axis, analyse, gains

AXES = [(400.0, 40.0), (400.0, 20.0), (400.0, 8.0), (400.0, 100.0), (3.0, 0.4), (8464.0, 184.0)]
axes = pytest.mark.parametrize(("K_P", "K_D"), AXES)
B = np.array([[0.0], [1.0]])


def matrix(K_P, K_D):
    return np.array([[0.0, 1.0], [-K_P, -K_D]])


@axes
def test_chosen_decay_rate_alpha_gives_the_smallest_error_bound(K_P, K_D):
    def size(alpha):
        W = solve_continuous_lyapunov(matrix(K_P, K_D) + alpha * np.eye(2), -B @ B.T / (2 * alpha))
        return np.log(W[0, 0])

    slowest = -np.linalg.eigvals(matrix(K_P, K_D)).real.max()
    best = minimize_scalar(
        size, bounds=(1e-3 * slowest, 0.999 * slowest), method="bounded", options={"xatol": 1e-9}
    )
    assert tightest_alpha(K_P, K_D) == pytest.approx(best.x, rel=1e-4)
    assert np.log(np.linalg.inv(certificate(K_P, K_D).P[0])[0, 0]) <= best.fun + 1e-9


def test_error_bound_at_critical_damping_agrees_with_the_closed_form():
    found = certificate(20.0**2, 2 * 20.0)
    np.testing.assert_allclose(found.alpha, 5.0, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.inv(found.P)[:, 0, 0], 32 / 27 / 20.0**4, rtol=1e-11)


@axes
def test_lyapunov_function_decreases_as_certified_under_every_bounded_disturbance(K_P, K_D):
    """dV/dt + 2 alpha (V - d^2) is a quadratic form in e, de and d; its largest eigenvalue is zero."""
    found = certificate(K_P, K_D)
    A, P, alpha = matrix(K_P, K_D), found.P[0], found.alpha[0]
    form = np.block([[A.T @ P + P @ A + 2 * alpha * P, P @ B], [B.T @ P, np.array([[-2 * alpha]])]])
    scale = np.diag([1 / K_P, 1 / np.sqrt(K_P), 1.0])
    eigenvalues = np.linalg.eigvalsh(scale @ form @ scale)
    assert abs(eigenvalues.max()) <= 1e-9 * np.abs(eigenvalues).max(), "largest one is 0: the bound is tight"


def test_unstable_axis_has_no_lyapunov_certificate():
    with pytest.raises(ModelError, match="both above 0"):
        certificate(1.0, -1.0)


def test_the_worst_bang_bang_disturbance_attains_the_peak_gain():
    """Bang-bang: d(t) = sgn h(T - t) for a lightly damped axis, each period divided into forty parts."""
    period, parts = 5e-3, 40
    found = analyse(Axis(period), gains(400.0, 8.0, period))
    step = np.array([[1.0, period], [0.0, 1.0]])
    loop = step - np.array([[period**2 / 2], [period]]) @ np.array([[400.0, 8.0]])
    left = (np.arange(parts) + 0.5) * period / parts
    pulses = np.array([left, np.ones(parts)]) * period / parts
    total, A = 0.0, np.eye(2)
    for _ in range(1000):
        total += np.abs((A @ pulses)[0]).sum()
        A = loop @ A
    assert found.peak_gains()[0] == pytest.approx(total, rel=1e-3)


SLOPE, K = 30.0, 8.0
PHI = K / SLOPE
LINEAR = (SLOPE * K / PHI, SLOPE + K / PHI)


def largest(d, gamma=1.0):
    """Largest |s| of the linear loop without sampling, from the area under its impulse response."""
    t = np.linspace(0.0, 3.0, 30_001)
    _, h = impulse(([1.0, SLOPE], [1.0, gamma * LINEAR[1], gamma * LINEAR[0]]), T=t)
    return d * float(np.trapezoid(np.abs(h), t))


def test_sliding_mode_with_an_exact_model_needs_a_gain_above_the_disturbance():
    for d in (7.9, 8.1):
        found = sliding(SLOPE, K, PHI, gamma=1.0, alpha=0.0, d=d, inside=largest(d))
        assert found.covered is (d < K)
        assert found.inside == pytest.approx(PHI * d / K, rel=1e-4)
        assert found.room == np.inf


def test_reaching_time_of_sliding_mode_holds_for_a_disturbance_away_from_the_layer():
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


def test_sliding_mode_with_a_too_light_model_needs_more_gain():
    """gamma = 0.8 also weakens the linear part of the law: a disturbance below gamma k may leave the layer."""
    assert sliding(SLOPE, K, PHI, gamma=0.8, alpha=0.2, d=5.0, inside=largest(5.0, 0.8)).covered
    d = 0.8 * K - 1e-3
    close = sliding(SLOPE, K, PHI, gamma=0.8, alpha=0.2, d=d, inside=largest(d, 0.8))
    assert close.surplus > 0.0
    assert not close.covered


@pytest.mark.parametrize("gamma_matrix", [[[1.2, 0.2], [0.2, 1.2]], [[0.8, -0.1], [-0.1, 0.8]]])
def test_coupled_legs_at_the_error_limit_approach_the_sliding_layer_at_half_the_surplus(gamma_matrix):
    """Largest d|s|/dt of one of two coupled legs, over all signs of the other's correction, of rates and disturbance."""
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


def test_lyapunov_redesign_reaches_its_layer_with_rho_equal_to_the_disturbance():
    """The linear part remains as surplus: dy/dt = -wn y at the edge of the layer, at damping ratio 1."""
    w_n, rho, epsilon = 20.0, 5.0, 0.2
    inside = rho / (w_n + rho / epsilon)
    found = redesign(w_n**2, 2 * w_n, rho, epsilon, gamma=1.0, alpha=0.0, d=rho, inside=inside)
    assert found.surplus == pytest.approx(w_n * epsilon)
    assert found.room == np.inf
    assert found.covered
