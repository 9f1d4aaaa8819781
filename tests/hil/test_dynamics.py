"""M, H, G, inverse and forward dynamics against MuJoCo and Pinocchio, with and without drives; energy balances."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.model import ModelSettings
from hil.contracts.records import arrived, asked
from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.law import LawContext
from hil.mathematics.rotations import rotation_from_vector, rotation_motion_kernel
from hil.robot.dynamics import Model, Variant
from hil.robot.dynamics_kernels import joint_idc_kernel
from hil.robot.geometry import Platform
from hil.trajectory.path import PoseSample

DATA = Path(__file__).parents[1] / "data"
TRUTH = json.loads((DATA / "rigid_body_cases.json").read_text())
BOOK = json.loads((DATA / "book_platform.json").read_text())
PLATFORMS = {name: Platform.from_dict(d) for name, d in TRUTH["geometries"].items()}
CASES = [pytest.param(case, id=case["id"]) for case in TRUTH["cases"]]
HOME = (np.array([0.0, 0.0, 1.0]), np.eye(3))
NOTHING = np.zeros(6)
REFLECTED = np.array([500.0, 400.0, 300.0, 200.0, 100.0, 50.0])
VISCOUS = np.array([2000.0, 1800.0, 1600.0, 1400.0, 1200.0, 1000.0])
COULOMB = np.array([150.0, 140.0, 130.0, 120.0, 110.0, 100.0])
DRIVES: dict[str, Any] = {
    "reflected_mass": REFLECTED,
    "viscous": VISCOUS,
    "coulomb": COULOMB,
    "sliding_speed": 0.0,
}
SPINS = pytest.mark.parametrize(("spin", "prefix"), [("none", ""), ("universal", "ujoint_")])
BARE_AND_DRIVEN = pytest.mark.parametrize("drives", [{}, DRIVES], ids=["bare", "driven"])
VARIANTS = ["full", "no_H", "printed", "constant", "constant_MG", "massless_legs"]


def relative(value, expected, floor=0.0):
    return np.abs(np.asarray(value) - expected).max() / max(np.abs(expected).max(), floor)


def state_of(case):
    s = case["state"]
    return (
        np.array(s["p"]),
        np.array(s["R"]),
        np.array(s["v"] + s["omega"]),
        np.array(s["a"] + s["alpha"]),
        np.array(s["wrench"]),
        np.array(s["f"]),
    )


def of_legs(case):
    """J, dq, ddq from the engines; friction and force of DRIVES in closed form, m ddq + b dq + c sgn(dq)."""
    J, dq, ddq = (np.array(case["expected"][key]) for key in ("jacobian", "rates", "length_accels"))
    friction = VISCOUS * dq + COULOMB * np.sign(dq)
    return J, dq, ddq, friction, REFLECTED * ddq + friction


@SPINS
@BARE_AND_DRIVEN
@pytest.mark.parametrize("case", CASES)
def test_dynamics_agree_with_the_rigid_body_engines(case, drives, spin, prefix):
    p, R, twist, dtwist, wrench, f = state_of(case)
    e = case["expected"]
    J, dq, ddq, friction, force = of_legs(case)
    M, H, legs, kinetic = (np.array(e[prefix + key]) for key in ("M", "H", "leg_forces", "kinetic"))
    if drives:
        M = M + J.T @ np.diag(REFLECTED) @ J
        H = H + J.T @ (REFLECTED * (ddq - J @ dtwist))  # ddq - J dtwist = (dJ/dt) twist
        legs, kinetic = legs + force, kinetic + 0.5 * (REFLECTED * dq**2).sum()
    model = Model(PLATFORMS[case["geometry"]], leg_spin=spin, **drives)
    weight = np.abs(e["G"]).max()
    assert relative(model.mass_matrix(p, R), M) <= 1e-9
    assert relative(model.coriolis(p, R, twist), H, weight) <= 1e-9
    assert relative(model.gravity(p, R), e["G"]) <= 1e-9
    assert relative(model.inverse_dynamics(p, R, twist, dtwist, wrench), legs) <= 1e-9
    assert relative(model.forward_dynamics(p, R, twist, legs, wrench), dtwist, 1.0) <= 1e-9
    assert relative(model.kinetic_energy(p, R, twist), kinetic, 1.0) <= 1e-9
    assert relative(model.potential_energy(p, R), np.array(e["potential"]), weight) <= 1e-9
    assert relative(model.friction(dq), friction if drives else NOTHING, 1.0) <= 1e-12
    if not drives:
        acceleration = np.array(e[prefix + "fd_a"] + e[prefix + "fd_alpha"])
        assert relative(model.forward_dynamics(p, R, twist, f, wrench), acceleration, 1.0) <= 1e-9


@BARE_AND_DRIVEN
@pytest.mark.parametrize("case", CASES)
def test_with_massless_legs_only_platform_and_drives_have_inertia(case, drives):
    p, R, twist, dtwist, wrench, _ = state_of(case)
    model = Model(PLATFORMS[case["geometry"]], "massless_legs", **drives)
    expected = case["expected"]["massless_leg_forces"] + (of_legs(case)[-1] if drives else NOTHING)
    assert relative(model.inverse_dynamics(p, R, twist, dtwist, wrench), expected) <= 1e-9


def test_dynamics_agree_with_41_published_textbook_states():
    model = Model(Platform.from_dict(BOOK["geometry"]))
    for s in BOOK["states"]:
        R = rotation_from_vector(np.array(s["rotvec"]))
        tau = model.inverse_dynamics(s["p"], R, s["v"] + s["omega"], s["a"] + s["alpha"])
        assert relative(tau, s["force"]) <= 1e-9
    assert len(BOOK["states"]) == 41


@pytest.mark.parametrize("spin", ["none", "universal"])
@pytest.mark.parametrize("case", CASES[1::6])
def test_power_equals_the_rate_of_energy(case, spin):
    """d/dt kinetic = twist.(M dtwist + H), d/dt potential = twist.G along a motion (central differences)."""
    p, R, twist, dtwist, _, _ = state_of(case)
    model = Model(PLATFORMS[case["geometry"]], leg_spin=spin)
    force = model.mass_matrix(p, R) @ dtwist + model.coriolis(p, R, twist)
    h = 1e-5

    def along(t):
        turn, _, _ = rotation_motion_kernel(t * twist[3:] + t * t / 2 * dtwist[3:], np.zeros(3), np.zeros(3))
        return p + t * twist[:3] + t * t / 2 * dtwist[:3], turn @ R, twist + t * dtwist

    kinetic = (model.kinetic_energy(*along(h)) - model.kinetic_energy(*along(-h))) / (2 * h)
    potential = (model.potential_energy(*along(h)[:2]) - model.potential_energy(*along(-h)[:2])) / (2 * h)
    scale = np.abs(twist) @ np.abs(force)
    assert abs(kinetic - twist @ force) <= 1e-7 * max(scale, 1.0)
    assert abs(potential - twist @ model.gravity(p, R)) <= 1e-7 * max(
        np.abs(twist) @ np.abs(model.gravity(p, R)), 1.0
    )


@pytest.mark.parametrize("spin", ["none", "universal"])
@pytest.mark.parametrize("case", CASES[1::6])
def test_power_of_coriolis_forces_equals_half_twist_times_inertia_rate_times_twist(case, spin):
    """twist.(dM/dt/2) twist = twist.H, dM/dt by central differences along p + t v, exp(t w) R."""
    p, R, twist, *_ = state_of(case)
    model = Model(PLATFORMS[case["geometry"]], leg_spin=spin, reflected_mass=REFLECTED)
    h = 1e-5

    def M(t):
        turned = np.ascontiguousarray(Rotation.from_rotvec(t * twist[3:]).as_matrix() @ R)
        return model.mass_matrix(p + t * twist[:3], turned)

    rate = (M(h) - M(-h)) / (2 * h)
    power = 0.5 * twist @ rate @ twist
    scale = np.abs(twist) @ np.abs(rate) @ np.abs(twist)
    assert abs(power - twist @ model.coriolis(p, R, twist)) <= 1e-7 * scale


@SPINS
@BARE_AND_DRIVEN
def test_the_joint_space_law_linearises_exactly(drives, spin, prefix):
    """With the engines' length accelerations as ddq*, the law gives the engines' and drives' leg forces."""
    for case in TRUTH["cases"]:
        p, R, twist, _, wrench, _ = state_of(case)
        model = Model(PLATFORMS[case["geometry"]], leg_spin=spin, **drives)
        J, _, ddq, _, force = of_legs(case)
        tau = joint_idc_kernel(model.constants, model.code, p, R, twist, J, ddq, wrench)
        legs = case["expected"][prefix + "leg_forces"] + (force if drives else NOTHING)
        assert relative(tau, legs) <= 1e-9


@BARE_AND_DRIVEN
@pytest.mark.parametrize("case", CASES[1::6])
def test_model_variants_differ_by_their_omitted_terms(case, drives):
    p, R, twist, dtwist, wrench, _ = state_of(case)
    platform, e = PLATFORMS[case["geometry"]], case["expected"]
    M, G = (np.array(e[key]) for key in ("M", "G"))
    J, _, ddq, friction, force = of_legs(case)
    no_bend, with_bend = (REFLECTED * (J @ dtwist) + friction, force) if drives else (NOTHING, NOTHING)

    without_H = np.linalg.solve(J.T, M @ dtwist + G - wrench) + no_bend
    printed = np.linalg.solve(J.T, M @ np.linalg.solve(J, ddq) + G) + with_bend
    variants: tuple[Variant, ...] = ("no_H", "printed", "constant", "constant_MG")
    for variant in variants:
        model = Model(platform, variant, frozen_at=(p, R), **drives)
        assert relative(model.inverse_dynamics(p, R, twist, dtwist, wrench), without_H) <= 1e-9
        law = joint_idc_kernel(model.constants, model.code, p, R, twist, J, ddq, NOTHING)
        bent = np.linalg.solve(J.T, M @ dtwist + G) + no_bend
        assert relative(law, bent if variant == "no_H" else printed) <= 1e-9


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("sliding_speed", [0.0, 1e-3, 10.0])
def test_forward_dynamics_inverts_inverse_dynamics_of_every_variant(variant, sliding_speed):
    for case in TRUTH["cases"][2::7]:
        p, R, twist, dtwist, wrench, _ = state_of(case)
        other = (p + 0.01, rotation_from_vector(np.array([0.02, 0.0, 0.01])) @ R)
        options = DRIVES | {"sliding_speed": sliding_speed, "frozen_at": other}
        model = Model(PLATFORMS[case["geometry"]], variant, **options)
        tau = model.inverse_dynamics(p, R, twist, dtwist, wrench)
        assert relative(model.forward_dynamics(p, R, twist, tau, wrench), dtwist, 1.0) <= 1e-9


def test_coulomb_friction_is_a_sign_or_a_ramp_up_to_the_sliding_speed():
    platform = PLATFORMS[TRUTH["cases"][0]["geometry"]]
    dq = np.array([0.0, 1e-4, -1e-4, 1e-3, -0.5, 0.5])
    exact = Model(platform, coulomb=100.0, sliding_speed=0.0)
    assert exact.friction(dq).tolist() == [0.0, 100.0, -100.0, 100.0, -100.0, 100.0]
    sloped = Model(platform, coulomb=100.0, viscous=10.0)
    assert sloped.friction(dq) == pytest.approx(
        np.array([0.0, 10.001, -10.001, 100.01, -105.0, 105.0]), abs=1e-12
    )


def test_inertia_scale_scales_masses_and_inertias_but_not_friction():
    """The centres of mass of the legs stay unchanged."""
    for name, d in TRUTH["geometries"].items():
        half = {
            part: {key: value if key == "com" else (value or 0.0) * 0.9 for key, value in d[part].items()}
            for part in ("cylinder", "rod")
        }
        body = {key: (0.9 * np.array(value)).tolist() for key, value in d["platform"].items()}
        by_hand = Platform.from_dict({**d, **half, "platform": body})
        state = state_of(next(c for c in TRUTH["cases"] if c["geometry"] == name))[:5]
        scaled = Model(PLATFORMS[name], inertia_scale=0.9, **DRIVES)
        expected = Model(by_hand, **DRIVES | {"reflected_mass": 0.9 * REFLECTED})
        assert relative(scaled.inverse_dynamics(*state), expected.inverse_dynamics(*state)) <= 1e-12


@pytest.mark.parametrize("per_leg", [False, True])
def test_the_configured_law_models_the_configured_drives(per_leg):
    """On the reference the law is pure feed-forward: the engines' forces plus the closed form."""
    case = TRUTH["cases"][3]
    p, R, twist, dtwist, wrench, _ = state_of(case)
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
    context = LawContext(platform, "none", 1e-3)
    assert relative(asked(settings.build(context), tick), expected) <= 1e-9
