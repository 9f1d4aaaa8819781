"""What a high gear does to the legs: the platform's changing inertia drowns in the motors' own.

The gear: 0.019 kg m^2 of motor and screw at 5 mm lead, 30 t along each leg. Law: PD with the acceleration of each
leg fed forward, tau = Kp e + Kv de + m ddq_d, critically damped at wn = 20 rad/s for m = reflected mass + 1 t,
which is about a leg's mean share of the platform on the book's path.
"""

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

W_N = 20.0
SHARE_kg = 1000.0
GEAR_kg = 0.019 * (2 * pi / 0.005) ** 2
WIDE = 1_000_000
"""Newton: 148 kN accelerate 30 t."""


def geared(reflected_kg):
    """The ideal bench with geared legs, its force limits ten times as wide."""
    m = reflected_kg + SHARE_kg
    law = {"law": "pd", "kp_N_m": W_N**2 * m, "kv_N_s_m": 2 * W_N * m, "feedforward_mass_kg": m}
    return changed(
        "ideal",
        controller=law,
        plant={"model": {"reflected_mass_kg": reflected_kg}},
        limits=dict.fromkeys(("force_N", "force_step_N", "force_window_N"), WIDE),
        drives={"force_limit_N": WIDE},
    )


def path():
    c = load("ideal")
    return build_platform(c.platform), build_trajectory(c.reference, c.platform.home, None)


def slowest_and_fastest(reflected_kg):
    """Extremes along the book's path of sqrt(Kp / m), m the eigenvalues of the leg-space inertia, Kp fixed."""
    platform, trajectory = path()
    model = Model(platform, reflected_mass=reflected_kg)
    found = []
    for t in np.linspace(0.0, 2.0, 201):
        s = trajectory.sample(float(t))
        inverse = np.linalg.inv(jacobian(platform, s.p, s.R))
        found.append(np.linalg.eigvalsh(inverse.T @ model.mass_matrix(s.p, s.R) @ inverse))
    Kp = W_N**2 * (reflected_kg + SHARE_kg)
    return sqrt(Kp / np.max(found)), sqrt(Kp / np.min(found))


def test_a_gear_holds_the_natural_frequency_that_varies_five_fold_without():
    assert pytest.approx(30e3, rel=1e-3) == GEAR_kg
    slowest, fastest = slowest_and_fastest(0.0)
    assert fastest / slowest == pytest.approx(5.5, rel=0.02)
    slowest, fastest = slowest_and_fastest(GEAR_kg)
    assert fastest / slowest < 1.10
    assert slowest < W_N < fastest


def test_the_error_of_a_decentralised_law_falls_as_the_inertia_of_the_motors_rises():
    factors = np.array([0.5, 1.0, 2.0])
    peaks = [
        succeeded(geared(factor * GEAR_kg)).summary["tracking"]["peak_leg_error_mm"] for factor in factors
    ]
    assert peaks[1] == pytest.approx(1.32, rel=0.10)
    products = factors * peaks
    assert products == pytest.approx(products.mean(), rel=0.03)


def test_without_a_gear_safety_stops_before_the_platform_falls_through_a_singularity():
    """Legs 37 mm short of the far point have no pose on this side of it."""
    summary = run(geared(0.0)).summary
    assert summary["faults"] == ["CONDITION"]
    assert 30.0 < summary["tracking"]["peak_leg_error_mm"] < 50.9
