"""What drives add to the model: reflected mass and friction, by closed forms over the engines' numbers.

With leg rates dq and accelerations ddq from the engines, the leg forces grow by m_r ddq + b dq + c sgn(dq).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import ModelError
from hil.config.model import ModelSettings
from hil.contracts.records import arrived, asked
from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.law import LawContext
from hil.robot.dynamics import Model, Variant
from hil.robot.dynamics_kernels import joint_idc_kernel
from hil.robot.geometry import Platform
from hil.robot.kinematics import KinematicsError
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.path import PoseSample

DATA = Path(__file__).parents[1] / "data"
TRUTH = json.loads((DATA / "rigid_body_cases.json").read_text())
PLATFORMS = {name: Platform.from_dict(d) for name, d in TRUTH["geometries"].items()}
CASES = [pytest.param(case, id=case["id"]) for case in TRUTH["cases"]]
FEW = CASES[1::6]
SPINS = pytest.mark.parametrize(("spin", "prefix"), [("none", ""), ("universal", "ujoint_")])

REFLECTED = np.array([500.0, 400.0, 300.0, 200.0, 100.0, 50.0])
VISCOUS = np.array([2000.0, 1800.0, 1600.0, 1400.0, 1200.0, 1000.0])
COULOMB = np.array([150.0, 140.0, 130.0, 120.0, 110.0, 100.0])
DRIVES: dict[str, Any] = {
    "reflected_mass": REFLECTED,
    "viscous": VISCOUS,
    "coulomb": COULOMB,
    "sliding_speed": 0.0,
}


def relative(value, expected, floor=0.0):
    return np.abs(np.asarray(value) - expected).max() / max(np.abs(expected).max(), floor)


def state_of(case):
    s = case["state"]
    twist, dtwist = np.array(s["v"] + s["omega"]), np.array(s["a"] + s["alpha"])
    return np.array(s["p"]), np.array(s["R"]), twist, dtwist, np.array(s["wrench"])


def drive_force(case):
    e = case["expected"]
    dq, ddq = np.array(e["rates"]), np.array(e["length_accels"])
    return REFLECTED * ddq + VISCOUS * dq + COULOMB * np.sign(dq)


@SPINS
@pytest.mark.parametrize("case", CASES)
def test_leg_forces_grow_by_the_closed_form_and_forward_dynamics_undoes_it(case, spin, prefix):
    p, R, twist, dtwist, wrench = state_of(case)
    tau = np.array(case["expected"][prefix + "leg_forces"]) + drive_force(case)
    model = Model(PLATFORMS[case["geometry"]], leg_spin=spin, **DRIVES)
    assert relative(model.inverse_dynamics(p, R, twist, dtwist, wrench), tau) <= 1e-9
    assert relative(model.forward_dynamics(p, R, twist, tau, wrench), dtwist, 1.0) <= 1e-9


@SPINS
@pytest.mark.parametrize("case", CASES)
def test_the_joint_space_law_feeds_the_drives(case, spin, prefix):
    p, R, twist, _, wrench = state_of(case)
    e = case["expected"]
    model = Model(PLATFORMS[case["geometry"]], leg_spin=spin, **DRIVES)
    J, ddq = np.array(e["jacobian"]), np.array(e["length_accels"])
    tau = joint_idc_kernel(model.constants, model.code, p, R, twist, J, ddq, wrench)
    assert relative(tau, np.array(e[prefix + "leg_forces"]) + drive_force(case)) <= 1e-9


@pytest.mark.parametrize("case", CASES)
def test_reflected_mass_is_in_M_in_H_and_in_the_energy_and_weighs_nothing(case):
    p, R, twist, dtwist, _ = state_of(case)
    e = case["expected"]
    model = Model(PLATFORMS[case["geometry"]], **DRIVES)
    J, dq, ddq = (np.array(e[key]) for key in ("jacobian", "rates", "length_accels"))
    M = np.array(e["M"]) + J.T @ np.diag(REFLECTED) @ J
    H = np.array(e["H"]) + J.T @ (REFLECTED * (ddq - J @ dtwist))  # ddq - J dtwist = (dJ/dt) twist
    weight = np.abs(e["G"]).max()
    assert relative(model.mass_matrix(p, R), M) <= 1e-9
    assert relative(model.coriolis(p, R, twist), H, weight) <= 1e-9
    assert relative(model.gravity(p, R), e["G"]) <= 1e-9
    kinetic = np.array(e["kinetic"] + 0.5 * (REFLECTED * dq**2).sum())
    assert relative(model.kinetic_energy(p, R, twist), kinetic, 1.0) <= 1e-9
    assert relative(model.potential_energy(p, R), np.array(e["potential"]), weight) <= 1e-9


@pytest.mark.parametrize("spin", ["none", "universal"])
@pytest.mark.parametrize("case", FEW)
def test_H_is_passive_with_the_rate_of_M(case, spin):
    """twist.(dM/dt/2) twist = twist.H, dM/dt by central differences along p + t v, exp(t w) R."""
    p, R, twist, _, _ = state_of(case)
    model = Model(PLATFORMS[case["geometry"]], leg_spin=spin, reflected_mass=REFLECTED)
    h = 1e-5

    def M(t):
        turned = np.ascontiguousarray(Rotation.from_rotvec(t * twist[3:]).as_matrix() @ R)
        return model.mass_matrix(p + t * twist[:3], turned)

    rate = (M(h) - M(-h)) / (2 * h)
    power = 0.5 * twist @ rate @ twist
    scale = np.abs(twist) @ np.abs(rate) @ np.abs(twist)
    assert abs(power - twist @ model.coriolis(p, R, twist)) <= 1e-7 * scale


@pytest.mark.parametrize("case", CASES)
def test_the_power_of_friction_is_what_the_motion_loses(case):
    """Coasting, twist.(M dtwist + H + G) = -dq.(viscous dq + coulomb sgn dq)."""
    p, R, twist, _, _ = state_of(case)
    dq = np.array(case["expected"]["rates"])
    model = Model(PLATFORMS[case["geometry"]], **DRIVES)
    dtwist = model.forward_dynamics(p, R, twist, np.zeros(6))
    terms = (model.mass_matrix(p, R) @ dtwist, model.coriolis(p, R, twist), model.gravity(p, R))
    loss = -dq @ (VISCOUS * dq + COULOMB * np.sign(dq))
    assert loss < 0 or not dq.any()
    scale = max(abs(loss), *(np.abs(twist) @ np.abs(term) for term in terms))
    assert abs(twist @ sum(terms) - loss) <= 1e-9 * scale
    assert -dq @ model.friction(dq) == pytest.approx(loss, rel=1e-12)


def test_coulomb_friction_is_the_sign_or_a_slope_up_to_the_sliding_speed():
    platform = PLATFORMS[TRUTH["cases"][0]["geometry"]]
    dq = np.array([0.0, 1e-4, -1e-4, 1e-3, -0.5, 0.5])
    exact = Model(platform, coulomb=100.0, sliding_speed=0.0)
    assert exact.friction(dq).tolist() == [0.0, 100.0, -100.0, 100.0, -100.0, 100.0]
    sloped = Model(platform, coulomb=100.0, viscous=10.0)
    assert sloped.friction(dq) == pytest.approx(
        np.array([0.0, 10.001, -10.001, 100.01, -105.0, 105.0]), abs=1e-12
    )


@pytest.mark.parametrize("case", FEW)
def test_variants_leave_out_what_they_say_and_keep_the_drives(case):
    p, R, twist, dtwist, wrench = state_of(case)
    platform, e = PLATFORMS[case["geometry"]], case["expected"]
    M, G, J, dq, ddq = (np.array(e[key]) for key in ("M", "G", "jacobian", "rates", "length_accels"))
    friction = VISCOUS * dq + COULOMB * np.sign(dq)

    massless = Model(platform, "massless_legs", **DRIVES).inverse_dynamics(p, R, twist, dtwist, wrench)
    assert relative(massless, np.array(e["massless_leg_forces"]) + drive_force(case)) <= 1e-9

    without_H = np.linalg.solve(J.T, M @ dtwist + G - wrench) + REFLECTED * (J @ dtwist) + friction
    variants: tuple[Variant, ...] = ("printed", "constant", "constant_MG")
    for variant in ("no_H", *variants):
        model = Model(platform, variant, frozen_at=(p, R), **DRIVES)
        assert relative(model.inverse_dynamics(p, R, twist, dtwist, wrench), without_H) <= 1e-9

    without_bend = np.linalg.solve(J.T, M @ np.linalg.solve(J, ddq) + G) + REFLECTED * ddq + friction
    for variant in variants:
        model = Model(platform, variant, frozen_at=(p, R), **DRIVES)
        law = joint_idc_kernel(model.constants, model.code, p, R, twist, J, ddq, np.zeros(6))
        assert relative(law, without_bend) <= 1e-9


@pytest.mark.parametrize("variant", ["full", "no_H", "printed", "constant", "constant_MG", "massless_legs"])
@pytest.mark.parametrize("sliding_speed", [0.0, 1e-3, 10.0])
def test_forward_dynamics_inverts_inverse_dynamics_of_every_variant(variant, sliding_speed):
    for case in TRUTH["cases"][2::7]:
        p, R, twist, dtwist, wrench = state_of(case)
        other = (p + 0.01, np.ascontiguousarray(Rotation.from_rotvec([0.02, 0.0, 0.01]).as_matrix() @ R))
        options = DRIVES | {"sliding_speed": sliding_speed, "frozen_at": other}
        model = Model(PLATFORMS[case["geometry"]], variant, **options)
        tau = model.inverse_dynamics(p, R, twist, dtwist, wrench)
        assert relative(model.forward_dynamics(p, R, twist, tau, wrench), dtwist, 1.0) <= 1e-9


def test_inertia_scale_scales_every_mass_and_no_friction():
    case = TRUTH["cases"][0]
    p, R, twist, _, _ = state_of(case)
    platform, dq = PLATFORMS[case["geometry"]], np.array(case["expected"]["rates"])
    model = Model(platform, inertia_scale=0.9, **DRIVES)
    bare = Model(platform, inertia_scale=0.9)
    extra = model.kinetic_energy(p, R, twist) - bare.kinetic_energy(p, R, twist)
    assert extra == pytest.approx(0.9 * 0.5 * (REFLECTED * dq**2).sum(), rel=1e-9)
    assert model.friction(dq) == pytest.approx(VISCOUS * dq + COULOMB * np.sign(dq), rel=1e-12)


def test_inertia_scale_leaves_the_legs_own_centres_of_mass():
    """Scaling masses, inertias and the platform's com by hand, and nothing else, gives the same model."""
    for d in TRUTH["geometries"].values():
        half = {
            name: {key: value if key == "com" else (value or 0.0) * 0.9 for key, value in d[name].items()}
            for name in ("cylinder", "rod")
        }
        body = {key: (0.9 * np.array(value)).tolist() for key, value in d["platform"].items()}
        case = next(
            c for c in TRUTH["cases"] if PLATFORMS[c["geometry"]].to_dict() == Platform.from_dict(d).to_dict()
        )
        state = state_of(case)
        scaled = Model(Platform.from_dict(d), inertia_scale=0.9).inverse_dynamics(*state)
        by_hand = Model(Platform.from_dict({**d, **half, "platform": body})).inverse_dynamics(*state)
        assert relative(scaled, by_hand) <= 1e-12


@pytest.mark.parametrize("per_leg", [False, True])
def test_the_configured_law_believes_in_the_configured_drives(per_leg):
    """On the reference the law is pure feed-forward: the engines' forces and the closed form."""
    case = TRUTH["cases"][3]
    p, R, twist, dtwist, wrench = state_of(case)
    e = case["expected"]
    m, b, c = (x if per_leg else np.full(6, x[0]) for x in (REFLECTED, VISCOUS, COULOMB))
    given = [x.tolist() if per_leg else float(x[0]) for x in (m, b, c)]
    believed = ModelSettings(
        reflected_mass_kg=given[0],
        viscous_friction_N_s_m=given[1],
        coulomb_friction_N=given[2],
        sliding_speed_m_s=0.0,
    )
    settings = InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=20.0, model=believed)
    platform, J = PLATFORMS[case["geometry"]], np.array(e["jacobian"])
    tick = arrived(platform, PoseSample(p, R, twist, dtwist), J=J)
    dq, ddq = np.array(e["rates"]), np.array(e["length_accels"])
    legs = np.array(e["leg_forces"]) + np.linalg.solve(J.T, wrench)  # the state has no wrench
    expected = legs + m * ddq + b * dq + c * np.sign(dq)
    context = LawContext(platform, "none", 1e-3, HoldTrajectory(p, R))
    assert relative(asked(settings.build(context), tick), expected) <= 1e-9


@pytest.mark.parametrize("name", ["reflected_mass", "viscous", "coulomb", "sliding_speed"])
@pytest.mark.parametrize(
    "bad", [-1.0, float("nan"), float("inf"), [1.0] * 5, "much", [1.0, 1.0, -1.0, 1.0, 1.0, 1.0]]
)
def test_what_no_drive_has_is_refused_with_name_and_value(name, bad):
    with pytest.raises(ModelError, match=f"^{name}: got ") as caught:
        Model(PLATFORMS[TRUTH["cases"][0]["geometry"]], **{name: bad})
    assert str(bad) in str(caught.value)


def test_friction_of_rates_that_are_no_numbers_is_refused():
    with pytest.raises(KinematicsError, match="dq"):
        Model(PLATFORMS[TRUTH["cases"][0]["geometry"]]).friction([np.nan] * 6)
