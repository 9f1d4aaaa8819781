"""Lyapunov functions of the error dynamics against scipy's solver, closed forms and brute force."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import minimize_scalar

from drivers.errors import ModelError
from hil.design.stability.error_dynamics import certificate, decay_rate, lyapunov_matrix, tightest_alpha

AXES = [(400.0, 40.0), (400.0, 20.0), (400.0, 8.0), (400.0, 100.0), (3.0, 0.4), (8464.0, 184.0)]
axes = pytest.mark.parametrize(("K_P", "K_D"), AXES)
B = np.array([[0.0], [1.0]])


def matrix(K_P, K_D):
    return np.array([[0.0, 1.0], [-K_P, -K_D]])


@axes
def test_the_lyapunov_equation_is_solved(K_P, K_D):
    Q = np.array([[3.0, -0.7], [-0.7, 2.0]])
    expected = solve_continuous_lyapunov(matrix(K_P, K_D).T, -Q)
    np.testing.assert_allclose(lyapunov_matrix(K_P, K_D, Q), expected, rtol=1e-9)


def test_P_of_a_critically_damped_axis_by_hand():
    """wn = 2, Q = I: P_12 = 1 / 8, P_22 = (1/8 + 1/2) / 4, P_11 = 4 / 8 + 4 * 5 / 32."""
    np.testing.assert_array_equal(lyapunov_matrix(4.0, 4.0, np.eye(2)), [[9 / 8, 1 / 8], [1 / 8, 5 / 32]])


@axes
def test_the_certificate_is_the_inverse_of_what_the_equation_of_the_ellipsoid_gives(K_P, K_D):
    found = certificate(K_P, K_D)
    alpha = found.alpha[0]
    W = solve_continuous_lyapunov(matrix(K_P, K_D) + alpha * np.eye(2), -B @ B.T / (2 * alpha))
    np.testing.assert_allclose(found.P[0] @ W, np.eye(2), atol=1e-8)
    assert found.error_gain()[0] == pytest.approx(np.sqrt(W[0, 0]), rel=1e-9)
    assert found.rate_gain()[0] == pytest.approx(np.sqrt(W[1, 1]), rel=1e-9)


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


def test_dV_is_the_derivative_of_V_along_a_solution():
    K_P, K_D, d, x = 300.0, 25.0, 2.0, np.array([0.01, -0.2])
    found = certificate(K_P, K_D)
    generator = np.block([[matrix(K_P, K_D), d * B], [np.zeros((1, 3))]])

    def V(t):
        e, de, _ = expm(generator * t) @ [*x, 1.0]
        return found.V(np.full(6, e), np.full(6, de))[0]

    h = 1e-5
    slope = (V(h) - V(-h)) / (2 * h)
    assert found.dV(*(np.full(6, v) for v in (*x, d)))[0] == pytest.approx(slope, rel=1e-6)


@axes
def test_the_decay_rate_is_that_of_the_slowest_pole(K_P, K_D):
    assert decay_rate(K_P, K_D) == pytest.approx(-np.roots([1, K_D, K_P]).real.max(), rel=1e-7)


def test_axes_differ():
    K_P = np.arange(1, 7) ** 2 * 10.0
    found = certificate(K_P, 2 * np.sqrt(K_P))
    np.testing.assert_allclose(found.alpha, np.sqrt(K_P) / 4, rtol=1e-12)


@pytest.mark.parametrize(("K_P", "K_D"), [(0.0, 1.0), (1.0, 0.0), (-1.0, 1.0)])
def test_what_does_not_decay_is_refused(K_P, K_D):
    with pytest.raises(ModelError, match="both above 0"):
        certificate(np.full(6, K_P), np.full(6, K_D))


def test_a_decay_that_the_axis_does_not_have_is_refused():
    with pytest.raises(ModelError, match=r"below the decay rate 20 1/s"):
        certificate(np.full(6, 400.0), np.full(6, 40.0), alpha=20.0)
