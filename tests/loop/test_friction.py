"""Friction and reflected mass of the drives in the controller's model, and the effect of a high gear ratio."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.build import build_trajectory
from tests.loop.bench import changed, run, succeeded

BOTH = {"viscous_friction_N_s_m": 2000, "reflected_mass_kg": 500}
DRY = {"coulomb_friction_N": 200}


@pytest.mark.parametrize(
    ("model", "plant", "least_mm", "most_mm"),
    [
        (BOTH, BOTH, 0.015, 0.035),  # 0.026: sampling, as without either (0.032)
        ({}, BOTH, 20.0, 25.0),  # 22.7
        (DRY, DRY, 0.03, 0.1),  # 0.073: the reversals
        (DRY | {"sliding_speed_m_s": 0}, DRY, 0.3, 0.4),  # 0.34: legs stick
        ({}, DRY, 1.5, 2.0),  # 1.79
    ],
)
def test_tracking_error_with_modelled_friction_and_inertia_is_that_of_sampling(
    model, plant, least_mm, most_mm
):
    """The plant's friction code is independent of the controller's."""
    ran = succeeded(changed("ideal", controller={"model": model}, plant={"model": plant}))
    assert least_mm < ran.summary["tracking"]["peak_leg_error_mm"] < most_mm


W_N, SHARE_kg = 20.0, 1000.0
GEAR_kg = 0.019 * (2 * pi / 0.005) ** 2
"""0.019 kg m^2 of motor and screw at 5 mm lead: 30 t along each leg, compared with 1 t of the platform's
share."""
WIDE = 1_000_000
"""Force that accelerates 30 t: 148 kN."""


def geared(reflected_kg):
    """The ideal bench with geared legs under PD with feed-forward of each leg's acceleration."""
    m = reflected_kg + SHARE_kg
    law = {"law": "pd", "kp_N_m": W_N**2 * m, "kv_N_s_m": 2 * W_N * m, "feedforward_mass_kg": m}
    return changed(
        "ideal",
        controller=law,
        plant={"model": {"reflected_mass_kg": reflected_kg}},
        limits=dict.fromkeys(("force_N", "force_step_N", "force_window_N"), WIDE),
        drives={"force_limit_N": WIDE},
    )


def slowest_and_fastest(reflected_kg):
    """Extremes along the book's path of sqrt(Kp / m), m the eigenvalues of the leg-space inertia, Kp fixed."""
    c = load("ideal")
    platform, trajectory = build_platform(c.platform), build_trajectory(c.reference, c.platform.home, None)
    model, found = Model(platform, reflected_mass=reflected_kg), []
    for t in np.linspace(0.0, 2.0, 201):
        s = trajectory.sample(float(t))
        inverse = np.linalg.inv(jacobian(platform, s.p, s.R))
        found.append(np.linalg.eigvalsh(inverse.T @ model.mass_matrix(s.p, s.R) @ inverse))
    Kp = W_N**2 * (reflected_kg + SHARE_kg)
    return sqrt(Kp / np.max(found)), sqrt(Kp / np.min(found))


def test_high_gear_ratio_keeps_the_natural_frequency_nearly_constant_along_a_path():
    slowest, fastest = slowest_and_fastest(0.0)
    assert fastest / slowest == pytest.approx(5.5, rel=0.02)
    slowest, fastest = slowest_and_fastest(GEAR_kg)
    assert fastest / slowest < 1.10
    assert slowest < W_N < fastest


def test_tracking_error_of_a_decentralised_law_decreases_with_motor_inertia():
    """The motors' inertia dominates the platform's changing inertia."""
    factors = np.array([0.5, 1.0, 2.0])
    peaks = [succeeded(geared(by * GEAR_kg)).summary["tracking"]["peak_leg_error_mm"] for by in factors]
    assert peaks[1] == pytest.approx(1.32, rel=0.10)
    assert factors * peaks == pytest.approx((factors * peaks).mean(), rel=0.03)


def test_run_without_gears_is_stopped_by_safety_before_a_singularity():
    """With legs 37 mm short of the far point there is no pose on this side of the singularity."""
    summary = run(geared(0.0)).summary
    assert summary["faults"] == ["CONDITION"]
    assert 30.0 < summary["tracking"]["peak_leg_error_mm"] < 50.9
