"""Sliding mode: where its gain comes from, and what it adds to inverse dynamics inside and outside the layer."""

import numpy as np
import pytest
from pydantic import ValidationError

from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.sliding_mode import SlidingModeSettings
from hil.control.uncertainty import UncertaintySettings
from tests.hil.control.legs import CONTEXT, NONE, answer

SLOPE, K, PHI = 50.0, 12.0, 0.2


def settings(**changes):
    given = {
        "law": "sliding_mode",
        "lambda_rad_s": SLOPE,
        "uncertainty": {"disturbance_m_s2": 10.0},
        "reaching_m_s2": 2.0,
        "boundary_layer_m_s": PHI,
    }
    return SlidingModeSettings.model_validate(given | changes)


def test_inside_the_layer_it_is_inverse_dynamics_with_these_gains():
    """Natural frequency sqrt(lambda k / phi), damping (lambda + k / phi) / 2 wn: here 54.8 and 1.004."""
    w_n = (SLOPE * K / PHI) ** 0.5
    linear = InverseDynamicsSettings(
        law="inverse_dynamics", wn_rad_s=w_n, damping_ratio=(SLOPE + K / PHI) / 2 / w_n
    )
    e = np.array([1e-3, -2e-3, 0.0, 3e-3, 0.5e-3, -1e-3])
    de = np.array([0.02, 0.05, -0.03, 0.0, 0.01, 0.04])
    assert (np.abs(de + SLOPE * e) < PHI).all()
    found = answer(settings().build(CONTEXT), e, de)
    np.testing.assert_allclose(found, answer(linear.build(CONTEXT), e, de), rtol=1e-9, atol=1e-8)
    dynamics = settings().error_dynamics()
    assert (dynamics.K_P[0], dynamics.K_D[0]) == pytest.approx((w_n**2, SLOPE + K / PHI))


@pytest.mark.parametrize("phi", [0.0, PHI])
def test_outside_the_layer_the_correction_is_k_whatever_the_error(phi):
    law = settings(boundary_layer_m_s=phi).build(CONTEXT)
    e = np.array([10e-3, -10e-3, 20e-3, -0.1, 5e-3, -6e-3])
    np.testing.assert_allclose(answer(law, e, NONE), K * np.sign(e), rtol=1e-8)
    de = np.array([1.0, -1.0, 2.0, -3.0, 0.5, -0.4])
    np.testing.assert_allclose(answer(law, NONE, de), SLOPE * de + K * np.sign(de), rtol=1e-8)


def test_without_a_layer_a_micrometre_gets_all_of_k():
    law = settings(boundary_layer_m_s=0.0).build(CONTEXT)
    e = 1e-6 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, 0.0])
    np.testing.assert_allclose(answer(law, e, NONE), K * np.sign(e), rtol=1e-7, atol=1e-7)


def test_the_layer_is_continuous_at_its_edge():
    law = settings().build(CONTEXT)
    edge = np.full(6, PHI / SLOPE)
    inner, outer = answer(law, edge * (1 - 1e-9), NONE), answer(law, edge * (1 + 1e-9), NONE)
    np.testing.assert_allclose(inner, outer, rtol=1e-6)


def test_the_gain_follows_from_the_bound():
    """By hand: (13 + 0.1 12 + 1) / 0.9 = 16.889; a layer of k / lambda = 0.2111 at lambda = 80."""
    uncertainty = {"disturbance_m_s2": 13.0, "model_error": 0.1, "acceleration_m_s2": 12.0}
    s = settings(lambda_rad_s=80.0, uncertainty=uncertainty, reaching_m_s2=1.0, boundary_layer_m_s=None)
    assert s.switching_gain == pytest.approx(16.8889, abs=1e-4)
    assert s.boundary_layer == pytest.approx(0.211111, abs=1e-6)
    dynamics = s.error_dynamics()
    assert (dynamics.K_P[5], dynamics.K_D[5]) == pytest.approx((6400.0, 160.0)), "two poles at lambda"


def test_the_bound_covers_a_model_that_is_wrong_by_its_share():
    """A law with this much to give can cancel every d = alpha (a + k) + disturbance: k = d at equality."""
    bound = UncertaintySettings(disturbance_m_s2=4.0, model_error=0.25, acceleration_m_s2=10.0).bound()
    assert bound == pytest.approx(0.25 * (10.0 + bound) + 4.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lambda_rad_s": 0.0}, "lambda_rad_s"),
        ({"reaching_m_s2": 0.0}, "reaching_m_s2"),
        ({"boundary_layer_m_s": -0.1}, "boundary_layer_m_s"),
        (
            {"uncertainty": {"disturbance_m_s2": 1.0, "model_error": 1.0, "acceleration_m_s2": 1.0}},
            "model_error",
        ),
        ({"uncertainty": {"disturbance_m_s2": 1.0, "model_error": 0.1}}, "acceleration_m_s2 is missing"),
        ({"uncertainty": {"disturbance_m_s2": 0.0}}, "nothing is uncertain"),
    ],
)
def test_settings_without_meaning_are_refused(changes, message):
    with pytest.raises(ValidationError, match=message):
        settings(**changes)
