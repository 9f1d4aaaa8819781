"""M, H, G, inverse and forward dynamics against MuJoCo and Pinocchio, energies, laws, and mutations."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ModelError
from hil.contracts.records import referred
from hil.mathematics.rotations import rotation_from_vector, rotation_motion_kernel
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import forward_dynamics_kernel, inverse_dynamics_kernel, joint_idc_kernel
from hil.robot.geometry import Platform
from hil.robot.kinematics import KinematicsError, jacobian, jacobian_rate
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel
from hil.trajectory.path import PoseSample
from tests.broad import broad

DATA = Path(__file__).parents[1] / "data"
TRUTH = json.loads((DATA / "rigid_body_cases.json").read_text())
BOOK = json.loads((DATA / "book_platform.json").read_text())
CLOSED_LOOP = json.loads((DATA / "book_closed_loop.json").read_text())["rows"]
PLATFORMS = {name: Platform.from_dict(d) for name, d in TRUTH["geometries"].items()}
CASES = [pytest.param(case, id=case["id"]) for case in TRUTH["cases"]]
HOME = (np.array([0.0, 0.0, 1.0]), np.eye(3))
NOTHING = np.zeros(6)


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


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("prefix", "spin"), [("", "none"), ("ujoint_", "universal")])
def test_a_state_agrees_with_the_rigid_body_engines(case, prefix, spin):
    p, R, twist, dtwist, wrench, f = state_of(case)
    e = case["expected"]
    model = Model(PLATFORMS[case["geometry"]], leg_spin=spin)
    weight = np.abs(e["G"]).max()
    assert relative(model.mass_matrix(p, R), e[prefix + "M"]) <= 1e-9
    assert relative(model.coriolis(p, R, twist), np.array(e[prefix + "H"]), weight) <= 1e-9
    assert relative(model.gravity(p, R), e["G"]) <= 1e-9
    assert relative(model.inverse_dynamics(p, R, twist, dtwist, wrench), e[prefix + "leg_forces"]) <= 1e-9
    acceleration = np.array(e[prefix + "fd_a"] + e[prefix + "fd_alpha"])
    assert relative(model.forward_dynamics(p, R, twist, f, wrench), acceleration, 1.0) <= 1e-9
    assert relative(model.kinetic_energy(p, R, twist), np.array(e[prefix + "kinetic"]), 1.0) <= 1e-9
    assert relative(model.potential_energy(p, R), np.array(e["potential"]), weight) <= 1e-9


@pytest.mark.parametrize("case", CASES)
def test_massless_legs_leave_the_platform_alone(case):
    p, R, twist, dtwist, wrench, _ = state_of(case)
    model = Model(PLATFORMS[case["geometry"]], "massless_legs")
    expected = case["expected"]["massless_leg_forces"]
    assert relative(model.inverse_dynamics(p, R, twist, dtwist, wrench), expected) <= 1e-9


def test_the_books_41_states():
    model = Model(Platform.from_dict(BOOK["geometry"]))
    for s in BOOK["states"]:
        R = rotation_from_vector(np.array(s["rotvec"]))
        tau = model.inverse_dynamics(s["p"], R, s["v"] + s["omega"], s["a"] + s["alpha"])
        assert relative(tau, s["force"]) <= 1e-9
    assert len(BOOK["states"]) == 41


@pytest.mark.parametrize("spin", ["none", "universal"])
@pytest.mark.parametrize("case", CASES[1::6])
def test_power_is_the_rate_of_energy(case, spin):
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
def test_joint_space_law_linearises_exactly(spin):
    """With ddq* = the engines' length accelerations the law gives the engines' leg forces."""
    for case in TRUTH["cases"]:
        p, R, twist, _, wrench, _ = state_of(case)
        platform = PLATFORMS[case["geometry"]]
        model = Model(platform, leg_spin=spin)
        ddq = np.array(case["expected"]["length_accels"])
        J = jacobian(platform, p, R)
        tau = joint_idc_kernel(model.constants, model.code, p, R, twist, J, ddq, wrench)
        prefix = "" if spin == "none" else "ujoint_"
        assert relative(tau, case["expected"][prefix + "leg_forces"]) <= 1e-9


def test_variants_differ_by_the_terms_they_leave_out():
    case = TRUTH["cases"][1]
    p, R, twist, dtwist, _, _ = state_of(case)
    e = case["expected"]
    platform = PLATFORMS[case["geometry"]]
    M, H, G, J = (np.array(e[key]) for key in ("M", "H", "G", "jacobian"))
    ddq = np.array(e["length_accels"])
    bend = jacobian_rate(platform, p, R, twist) @ twist

    def law(variant, **options):
        model = Model(platform, variant, **options)
        return joint_idc_kernel(model.constants, model.code, p, R, twist, J, ddq, NOTHING)

    without_H = np.linalg.solve(J.T, M @ np.linalg.solve(J, ddq - bend) + G)
    printed = np.linalg.solve(J.T, M @ np.linalg.solve(J, ddq) + G)
    assert relative(law("no_H"), without_H) <= 1e-9
    assert relative(law("printed"), printed) <= 1e-9
    assert relative(law("constant", frozen_at=(p, R)), printed) <= 1e-9
    assert relative(law("constant_MG", frozen_at=(p, R)), printed) <= 1e-9
    assert (
        relative(
            Model(platform, "no_H").inverse_dynamics(p, R, twist, dtwist),
            np.linalg.solve(J.T, M @ dtwist + G),
        )
        <= 1e-9
    )
    assert np.abs(H).max() > 1e-3 * np.abs(G).max()
    assert relative(law("full"), np.linalg.solve(J.T, M @ np.linalg.solve(J, ddq - bend) + H + G)) <= 1e-9


@pytest.mark.parametrize("variant", ["full", "no_H", "printed", "constant", "constant_MG", "massless_legs"])
def test_forward_dynamics_inverts_inverse_dynamics_of_every_variant(variant):
    for case in TRUTH["cases"][2::7]:
        p, R, twist, dtwist, wrench, _ = state_of(case)
        other = (p + 0.01, rotation_from_vector(np.array([0.02, 0.0, 0.01])) @ R)
        model = Model(PLATFORMS[case["geometry"]], variant, frozen_at=other)
        tau = model.inverse_dynamics(p, R, twist, dtwist, wrench)
        assert relative(model.forward_dynamics(p, R, twist, tau, wrench), dtwist, 1.0) <= 1e-9


def book_reference(t):
    """Cubic out and back between the book's two knots; orientation linear in the rotation vector."""
    s, sign = (t, 1.0) if t < 1.0 else (2.0 - t, -1.0)
    knot = BOOK["trajectory"]["knots"][1]
    step = np.array(knot["p"]) - HOME[0]
    r = np.radians(knot["rotvec_deg"])
    k, dk, ddk = 3 * s**2 - 2 * s**3, sign * (6 * s - 6 * s**2), 6 - 12 * s
    R, omega, alpha = rotation_motion_kernel(k * r, dk * r, ddk * r)
    return HOME[0] + k * step, R, np.concatenate([dk * step, omega]), np.concatenate([ddk * step, alpha])


def closed_loop(law, dt=1e-3, hold=0):
    """Integrate the full model for 2 s, RK4 on SE(3); return the peak leg error in mm. hold: steps per sample."""
    platform = Platform.from_dict(BOOK["geometry"])
    a, b = platform.base_joints, platform.platform_joints
    plant = Model(platform).constants
    p, R, twist = HOME[0].copy(), np.eye(3), np.zeros(6)
    peak = 0.0
    tau = NOTHING

    def control(t, p, R, twist):
        pose = book_reference(t)
        tick = referred(platform, PoseSample(*pose))
        q, dq, ddq = tick["q_d"], tick["dq_d"], tick["ddq_d"]
        J = jacobian_kernel(a, b, p, R)
        return law(pose, q, dq, ddq, p, R, twist, J, q - leg_lengths_kernel(a, b, p, R), dq - J @ twist)

    def turned(w):
        return np.ascontiguousarray(rotation_from_vector(w) @ R)

    def back(u, w):
        uw = np.cross(u, w)
        return w - uw / 2 + np.cross(u, uw) / 12

    for step in range(round(2.0 / dt)):
        t = step * dt
        if hold and step % hold == 0:
            tau = control(t, p, R, twist)

        def slope(t, p, R, twist, tau=tau):
            force = tau if hold else control(t, p, R, twist)
            return forward_dynamics_kernel(plant, 0, p, R, twist, force, NOTHING)

        k1, u1 = slope(t, p, R, twist), twist[3:]
        x2 = twist + dt / 2 * k1
        k2, u2 = slope(t + dt / 2, p + dt / 2 * twist[:3], turned(dt / 2 * u1), x2), back(dt / 2 * u1, x2[3:])
        x3 = twist + dt / 2 * k2
        k3, u3 = slope(t + dt / 2, p + dt / 2 * x2[:3], turned(dt / 2 * u2), x3), back(dt / 2 * u2, x3[3:])
        x4 = twist + dt * k3
        k4, u4 = slope(t + dt, p + dt * x3[:3], turned(dt * u3), x4), back(dt * u3, x4[3:])
        p = p + dt / 6 * (twist + 2 * x2 + 2 * x3 + x4)[:3]
        R = turned(dt / 6 * (u1 + 2 * u2 + 2 * u3 + u4))
        twist = twist + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        pose = book_reference(t + dt)
        peak = max(peak, np.abs(leg_lengths_kernel(a, b, p, R) - leg_lengths_kernel(a, b, *pose[:2])).max())
    return 1e3 * peak


def idc(model, wn=20.0):
    def law(_pose, _q, _dq, ddq, p, R, twist, J, e, de):
        return joint_idc_kernel(
            model.constants, model.code, p, R, twist, J, ddq + 2 * wn * de + wn**2 * e, NOTHING
        )

    return law


def feedforward_pd(model):
    def law(pose, _q, _dq, _ddq, _p, _R, _twist, _J, e, de):
        p, R, twist, dtwist = pose
        tau = inverse_dynamics_kernel(model.constants, model.code, p, R, twist, dtwist, NOTHING)
        return tau + BOOK["gains"]["ch6_joint_PD"]["KP"] * e + BOOK["gains"]["ch6_joint_PD"]["KV"] * de

    return law


@pytest.mark.parametrize(
    ("row", "make", "options", "hold", "rel"),
    broad(
        [
            ("joint_IDC_partial(noH,noJdot)_wn20", idc, {"variant": "printed"}, 0, 1e-3),
            ("joint_FF_PD_masses_90pct", feedforward_pd, {"inertia_scale": 0.9}, 0, 1e-6),
            ("joint_IDC_const_home_dynamics_wn20", idc, {"variant": "constant", "frozen_at": HOME}, 0, 1e-3),
            ("joint_IDC_exact_wn20_1kHz_ZOH", idc, {}, 2, 1e-3),
        ],
        quick=2,
    ),
)
def test_laws_on_the_books_trajectory_err_as_published_figures_say(row, make, options, hold, rel):
    model = Model(Platform.from_dict(BOOK["geometry"]), **options)
    peak = closed_loop(make(model), dt=5e-4 if hold else 1e-3, hold=hold)
    assert peak == pytest.approx(CLOSED_LOOP[row]["peak_leg_err_mm"], rel=rel)


def test_mutations_of_the_equations_are_caught():
    """Each classical mistake, put into the source, breaks the agreement to 1e-9 a thousandfold."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    script = Path(__file__).with_name("dynamics_mutants.py")
    run = subprocess.run(
        [sys.executable, "-W", "ignore", str(script), str(DATA / "rigid_body_cases.json")],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    worst = json.loads(run.stdout)
    assert worst.pop("unchanged") <= 1e-9
    assert len(worst) >= 30
    assert {name: error for name, error in worst.items() if not error > 1e-6} == {}


def test_constants_and_arguments_are_checked():
    book = Platform.from_dict(BOOK["geometry"])
    with pytest.raises(ModelError, match="variant"):
        Model(book, "exact")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="frozen_at"):
        Model(book, "constant")
    with pytest.raises(ModelError, match="leg_spin"):
        Model(book, leg_spin="some")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="universal_joint_base_axes"):
        Model(book, leg_spin="universal")
    with pytest.raises(ModelError, match="inertia_scale"):
        Model(book, inertia_scale=float("nan"))
    with pytest.raises(ValueError, match="read-only"):
        Model(book).constants[0] = 1.0


def test_a_singular_pose_is_named_with_its_values():
    """A platform turned by 90 degrees about z over a similar base is singular (Fichter 1986)."""
    angles = np.radians([0, 60, 120, 180, 240, 300])
    hexagon = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    d = {**BOOK["geometry"], "base_joints": 2 * hexagon, "platform_joints": hexagon}
    model = Model(Platform.from_dict(d))
    turned = rotation_from_vector(np.array([0.0, 0.0, np.pi / 2]))
    with pytest.raises(KinematicsError, match="singular") as caught:
        model.inverse_dynamics(HOME[0], turned, NOTHING, NOTHING)
    bound = caught.value.values["condition"]
    assert isinstance(bound, float)
    assert bound > 1e12


@pytest.mark.parametrize("bad", [np.full(6, np.nan), np.zeros(5), ["x"] * 6])
def test_arguments_that_are_no_six_numbers_are_refused(bad):
    model = Model(Platform.from_dict(BOOK["geometry"]))
    with pytest.raises(KinematicsError, match="twist"):
        model.inverse_dynamics(*HOME, bad, NOTHING)
    with pytest.raises(KinematicsError, match="tau"):
        model.forward_dynamics(*HOME, NOTHING, bad)
    with pytest.raises(KinematicsError, match="wrench"):
        model.inverse_dynamics(*HOME, NOTHING, NOTHING, bad)
