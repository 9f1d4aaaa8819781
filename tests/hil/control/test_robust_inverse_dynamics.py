"""The robust outer loop against the Lyapunov equation as scipy solves it."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.linalg import solve_continuous_lyapunov

from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from tests.hil.control.legs import CONTEXT, NONE, answer

W_N = [30.0, 35.0, 40.0, 45.0, 50.0, 60.0]
ZETA = 0.8
K_P = np.array(W_N) ** 2
K_D = 2 * ZETA * np.array(W_N)
RHO, EPSILON = np.sqrt(6) * 10.0, 0.3
A = np.block([[np.zeros((6, 6)), np.eye(6)], [-np.diag(K_P), -np.diag(K_D)]])
Q = np.diag(np.concatenate([K_D * K_P, K_D]))


def settings(**changes):
    given = {
        "law": "robust_inverse_dynamics",
        "wn_rad_s": W_N,
        "damping_ratio": ZETA,
        "uncertainty": {"disturbance_m_s2": 10.0},
        "boundary_layer_m_s": EPSILON,
    }
    return RobustInverseDynamicsSettings.model_validate(given | changes)


def errors(scale):
    random = np.random.default_rng(3)
    return [(random.normal(0, 1e-3 * scale, 6), random.normal(0, 0.05 * scale, 6)) for _ in range(20)]


@pytest.mark.parametrize("scale", [0.3, 3.0, 30.0])
def test_the_correction_points_along_b_p_x_and_never_exceeds_rho(scale):
    law = settings().build(CONTEXT)
    P = solve_continuous_lyapunov(A.T, -Q)
    for e, de in errors(scale):
        y = (P @ np.concatenate([e, de]))[6:]
        w = RHO * y / max(np.linalg.norm(y), EPSILON)
        np.testing.assert_allclose(answer(law, e, de), K_P * e + K_D * de + w, rtol=1e-7, atol=1e-7)


def test_outside_the_layer_no_uncertainty_within_the_bound_keeps_v_from_falling():
    """dV/dt = 2 x^T P dx/dt <= -x^T Q x for the worst d, which points along -y."""
    law = settings().build(CONTEXT)
    P = solve_continuous_lyapunov(A.T, -Q)
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


def test_inside_the_layer_it_is_inverse_dynamics_with_these_gains():
    """rho / epsilon K_D / 2 more stiffness, rho / epsilon more damping."""
    K_P1, K_D1 = K_P + RHO / EPSILON * K_D / 2, K_D + RHO / EPSILON
    e, de = errors(0.3)[0]
    np.testing.assert_allclose(
        answer(settings().build(CONTEXT), e, de), K_P1 * e + K_D1 * de, rtol=1e-7, atol=1e-7
    )
    dynamics = settings().error_dynamics()
    np.testing.assert_allclose((dynamics.K_P, dynamics.K_D), (K_P1, K_D1), rtol=1e-9)


def test_hardly_uncertain_it_is_plain_inverse_dynamics():
    s = settings(uncertainty={"disturbance_m_s2": 1e-12})
    plain = InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=W_N, damping_ratio=ZETA)
    e, de = errors(3.0)[1]
    np.testing.assert_allclose(
        answer(s.build(CONTEXT), e, de), answer(plain.build(CONTEXT), e, de), rtol=1e-9
    )


def test_without_a_layer_the_correction_is_all_of_rho():
    law = settings(boundary_layer_m_s=0.0).build(CONTEXT)
    w = answer(law, NONE, np.full(6, 1e-6))
    assert np.linalg.norm(w) == pytest.approx(RHO, rel=1e-4)


@pytest.mark.parametrize("key", ["wn_rad_s", "damping_ratio", "boundary_layer_m_s"])
def test_settings_without_meaning_are_refused(key):
    with pytest.raises(ValidationError, match=key):
        settings(**{key: -1.0})
