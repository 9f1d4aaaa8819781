"""Robust outer loops: sliding mode, Lyapunov redesign against SciPy's Lyapunov equation, and phase margins."""

from __future__ import annotations

import cmath
from math import inf, radians, sqrt

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.margin import cross_over, phase_margin_deg
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from hil.control.sliding_mode import SlidingModeSettings
from hil.control.uncertainty import UncertaintySettings
from tests.hil.control.legs import CONTEXT, NONE, answer

SLOPE, K, PHI = 50.0, 12.0, 0.2
W_N = [30.0, 35.0, 40.0, 45.0, 50.0, 60.0]
ZETA = 0.8
K_P = np.array(W_N) ** 2
K_D = 2 * ZETA * np.array(W_N)
RHO, EPSILON = np.sqrt(6) * 10.0, 0.3
A = np.block([[np.zeros((6, 6)), np.eye(6)], [-np.diag(K_P), -np.diag(K_D)]])
Q = np.diag(np.concatenate([K_D * K_P, K_D]))
P = solve_continuous_lyapunov(A.T, -Q)


def sliding(**changes):
    given = {
        "law": "sliding_mode",
        "lambda_rad_s": SLOPE,
        "uncertainty": {"disturbance_m_s2": 10.0},
        "reaching_m_s2": 2.0,
        "boundary_layer_m_s": PHI,
    }
    return SlidingModeSettings.model_validate(given | changes)


def robust(**changes):
    given = {
        "law": "robust_inverse_dynamics",
        "wn_rad_s": W_N,
        "damping_ratio": ZETA,
        "uncertainty": {"disturbance_m_s2": 10.0},
        "boundary_layer_m_s": EPSILON,
    }
    return RobustInverseDynamicsSettings.model_validate(given | changes)


def plain(wn, zeta):
    return InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=wn, damping_ratio=zeta).build(CONTEXT)


def errors(scale):
    random = np.random.default_rng(3)
    return [(random.normal(0, 1e-3 * scale, 6), random.normal(0, 0.05 * scale, 6)) for _ in range(20)]


def test_sliding_mode_inside_its_boundary_layer_is_linear_inverse_dynamics():
    """Natural frequency sqrt(lambda k / phi), damping (lambda + k / phi) / 2 wn: here 54.8 and 1.004."""
    w_n = (SLOPE * K / PHI) ** 0.5
    e = np.array([1e-3, -2e-3, 0.0, 3e-3, 0.5e-3, -1e-3])
    de = np.array([0.02, 0.05, -0.03, 0.0, 0.01, 0.04])
    assert (np.abs(de + SLOPE * e) < PHI).all()
    linear = plain(w_n, (SLOPE + K / PHI) / 2 / w_n)
    found = answer(sliding().build(CONTEXT), e, de)
    np.testing.assert_allclose(found, answer(linear, e, de), rtol=1e-9, atol=1e-8)
    dynamics = sliding().error_dynamics()
    assert (dynamics.K_P[0], dynamics.K_D[0]) == pytest.approx((w_n**2, SLOPE + K / PHI))


@pytest.mark.parametrize("phi", [0.0, PHI])
def test_sliding_mode_outside_its_boundary_layer_corrects_by_gain_k_for_any_error(phi):
    law = sliding(boundary_layer_m_s=phi).build(CONTEXT)
    e = np.array([10e-3, -10e-3, 20e-3, -0.1, PHI / SLOPE * (1 + 1e-9), -6e-3])
    np.testing.assert_allclose(answer(law, e, NONE), K * np.sign(e), rtol=1e-8)
    de = np.array([1.0, -1.0, 2.0, -3.0, 0.5, -0.4])
    np.testing.assert_allclose(answer(law, NONE, de), SLOPE * de + K * np.sign(de), rtol=1e-8)
    if phi == 0.0:
        tiny = 1e-6 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, 0.0])
        np.testing.assert_allclose(answer(law, tiny, NONE), K * np.sign(tiny), rtol=1e-7, atol=1e-7)


def test_default_switching_gain_and_boundary_layer_follow_from_the_uncertainty():
    """By hand: (13 + 0.1 12 + 1) / 0.9 = 16.889; a layer of k / lambda = 0.2111 at lambda = 80."""
    uncertainty = {"disturbance_m_s2": 13.0, "model_error": 0.1, "acceleration_m_s2": 12.0}
    s = sliding(lambda_rad_s=80.0, uncertainty=uncertainty, reaching_m_s2=1.0, boundary_layer_m_s=None)
    assert s.switching_gain == pytest.approx(16.8889, abs=1e-4)
    assert s.boundary_layer == pytest.approx(0.211111, abs=1e-6)
    dynamics = s.error_dynamics()
    assert (dynamics.K_P[5], dynamics.K_D[5]) == pytest.approx((6400.0, 160.0)), "two poles at lambda"


def test_uncertainty_bound_covers_the_model_error_of_the_law_itself():
    """A law with gain k can cancel every d = alpha (a + k) + disturbance: equality at k = d."""
    bound = UncertaintySettings(disturbance_m_s2=4.0, model_error=0.25, acceleration_m_s2=10.0).bound()
    assert bound == pytest.approx(0.25 * (10.0 + bound) + 4.0)


@pytest.mark.parametrize("scale", [0.3, 3.0, 30.0])
def test_robust_correction_points_along_BT_P_x_and_is_at_most_rho(scale):
    law = robust().build(CONTEXT)
    for e, de in errors(scale):
        y = (P @ np.concatenate([e, de]))[6:]
        w = RHO * y / max(np.linalg.norm(y), EPSILON)
        np.testing.assert_allclose(answer(law, e, de), K_P * e + K_D * de + w, rtol=1e-7, atol=1e-7)
    without_layer = answer(robust(boundary_layer_m_s=0.0).build(CONTEXT), NONE, np.full(6, 1e-6))
    assert np.linalg.norm(without_layer) == pytest.approx(RHO, rel=1e-4)


def test_lyapunov_function_decreases_outside_the_layer_for_every_bounded_uncertainty():
    """dV/dt = 2 x^T P dx/dt <= -x^T Q x for the worst d, which points along -y."""
    law = robust().build(CONTEXT)
    outside = 0
    for e, de in errors(6.0):
        x = np.concatenate([e, de])
        y = (P @ x)[6:]
        if np.linalg.norm(y) < EPSILON:
            continue
        outside += 1
        d = -RHO * y / np.linalg.norm(y)
        dx = np.concatenate([de, -answer(law, e, de) - d])
        assert 2 * x @ P @ dx <= -(x @ Q @ x) * (1 - 1e-6)
    assert outside > 10


def test_robust_law_inside_its_boundary_layer_is_linear_inverse_dynamics():
    """Additional stiffness rho / epsilon K_D / 2, additional damping rho / epsilon; both 0 without uncertainty."""
    K_P1, K_D1 = K_P + RHO / EPSILON * K_D / 2, K_D + RHO / EPSILON
    e, de = errors(0.3)[0]
    np.testing.assert_allclose(
        answer(robust().build(CONTEXT), e, de), K_P1 * e + K_D1 * de, rtol=1e-7, atol=1e-7
    )
    dynamics = robust().error_dynamics()
    np.testing.assert_allclose((dynamics.K_P, dynamics.K_D), (K_P1, K_D1), rtol=1e-9)
    hardly = robust(uncertainty={"disturbance_m_s2": 1e-12}).build(CONTEXT)
    np.testing.assert_allclose(answer(hardly, e, de), answer(plain(W_N, ZETA), e, de), rtol=1e-9)


GAINS = [(20.0**2, 40.0), (92.0**2, 184.0), (8000.0, 210.0), (100.0, 300.0), (2500.0, 10.0)]


@pytest.mark.parametrize(("K_P", "K_D"), GAINS)
def test_delay_equal_to_the_phase_margin_puts_a_root_on_the_imaginary_axis(K_P, K_D):
    """s^2 + (K_D s + K_P) exp(-s T) = 0 at s = j w_c: with more delay the loop is unstable."""
    w = cross_over(K_P, K_D)
    T = radians(phase_margin_deg(K_P, K_D)) / w
    assert phase_margin_deg(K_P, K_D, T) == pytest.approx(0.0, abs=1e-9)
    s = 1j * w
    assert abs(s * s + (K_D * s + K_P) * cmath.exp(-s * T)) < 1e-9 * w * w


def test_crossover_and_phase_margin_at_critical_damping_agree_with_the_closed_form():
    """Crossover at 2.06 wn with a margin of 76 degrees; 30 degrees at wn T = 0.39; none for a switching law."""
    assert cross_over(400.0, 40.0) == pytest.approx(20.0 * sqrt(2.0 + sqrt(5.0)), rel=1e-12)
    assert phase_margin_deg(400.0, 40.0) == pytest.approx(76.345, abs=1e-3)
    assert phase_margin_deg(1.0, 2.0, 0.393) == pytest.approx(30.0, abs=0.1)
    assert phase_margin_deg(1.0, 2.0, 1 / 3) == pytest.approx(37.0, abs=0.1)
    assert cross_over(inf, inf) == inf
    assert phase_margin_deg(inf, inf, 1e-9) == -inf
    assert phase_margin_deg(inf, inf) == 90.0
