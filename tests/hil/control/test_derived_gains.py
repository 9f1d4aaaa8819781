"""Default gains give the loop that is asked for, and the bandwidth of gains per leg is that of the largest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hil.control import LAWS
from hil.control.law import DesiredLoop

LOOP = DesiredLoop(wn=40.0, zeta=0.7, leg_mass=300.0, mass=1200.0, inertia=500.0, force_limit=9000.0)
INERTIAS = {
    "pd": {"kp_N_m": 300.0},
    "pid": {"kp_N_m": 300.0},
    "cartesian_pd": {"kp_position_N_m": 1200.0, "kp_rotation_N_m_rad": 500.0},
}
"""What each stiffness has to accelerate, kg and kg m^2; its damping has the same name with kv."""
DAMPING = {
    "kp_N_m": "kv_N_s_m",
    "kp_position_N_m": "kv_position_N_s_m",
    "kp_rotation_N_m_rad": "kv_rotation_N_m_s_rad",
}


def derived(law: str) -> dict[str, Any]:
    return LAWS[law].derived(LOOP)


@pytest.mark.parametrize("law", INERTIAS)
def test_each_motion_has_the_frequency_and_the_damping_that_are_asked_for(law):
    """The roots of m s^2 + K_v s + K_p."""
    gains = derived(law)
    for stiffness, inertia in INERTIAS[law].items():
        roots = np.roots([inertia, gains[DAMPING[stiffness]], gains[stiffness]])
        np.testing.assert_allclose(np.abs(roots), LOOP.wn, rtol=1e-9)
        np.testing.assert_allclose(-roots.real, LOOP.zeta * LOOP.wn, rtol=1e-9)


def test_the_integral_is_a_tenth_of_what_makes_the_loop_oscillate():
    """m s^3 + K_v s^2 + K_p s + 10 K_i has roots on the imaginary axis, at the loop's own frequency."""
    gains = derived("pid")
    assert gains["integral_limit_N"] == LOOP.force_limit
    roots = np.roots([LOOP.leg_mass, gains["kv_N_s_m"], gains["kp_N_m"], 10.0 * gains["ki_N_m_s"]])
    swinging = roots[np.abs(roots.imag) > 1.0]
    assert len(swinging) == 2
    np.testing.assert_allclose(swinging.real, 0.0, atol=1e-6 * LOOP.wn)
    np.testing.assert_allclose(np.abs(swinging), LOOP.wn, rtol=1e-9)


@pytest.mark.parametrize("law", INERTIAS)
def test_default_gains_have_the_bandwidth_that_they_were_made_for(law):
    settings = LAWS[law].model_validate({"law": law} | derived(law))
    assert settings.bandwidth(LOOP.leg_mass, LOOP.mass) == pytest.approx((LOOP.wn, LOOP.zeta))


@pytest.mark.parametrize("largest", range(6))
@pytest.mark.parametrize("law", ["pd", "pid", "pd_gravity", "feedforward_pd"])
def test_of_gains_per_leg_the_largest_make_the_bandwidth(law, largest):
    one = {"law": law, "kp_N_m": 2e6, "kv_N_s_m": 5e4}
    if law == "pid":
        one |= {"ki_N_m_s": 1e7, "integral_limit_N": 60.0}
    shares = np.linspace(0.2, 0.7, 6)
    shares[largest] = 1.0
    six = {name: (one[name] * shares).tolist() for name in ("kp_N_m", "kv_N_s_m")}
    found = LAWS[law].model_validate(one | six).bandwidth(300.0, 1200.0)
    assert found == pytest.approx(LAWS[law].model_validate(one).bandwidth(300.0, 1200.0))
    assert found == pytest.approx((81.64965809, 1.0206207))
