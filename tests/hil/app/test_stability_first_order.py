"""`hil stability` of springs and unequal axes, against calculated eigenvalues."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import root

from drivers.arrays import Array
from hil.app.configuration.configuration import Configuration, loads
from hil.app.stability.command import judge
from hil.app.stability.springs import law_forces
from hil.app.stability.subject import Stated, Subject
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.kinematics import jacobian, leg_lengths
from tests.hil.app.test_stability_command import LEGS, POSE, bench
from tests.hil.app.test_stability_conditions import held
from tests.hil.app.texts import edited

STILL = np.zeros(6)
WEIGHTLESS = {"platform": {"gravity_m_s2": [0, 0, 0]}}
AT = {"position_m": [0.05, -0.1, 1.1], "rotation_vector_deg": [3, -8, 5]}
FROZEN = "{variant: %s, frozen_at: {position_m: [0, 0, 1]}}"


def at(pose: dict[str, Any]) -> dict[str, Any]:
    """Change that makes a configuration rest at a pose."""
    return {"reference": {"pose": pose}}


def cartesian(ratio: float, *changes: dict[str, Any], more: str = "") -> Configuration:
    """A PD on the pose with a damping ratio for a body of 1150 kg and 450 kg m^2."""
    return held(
        f"  law: cartesian_pd\n  kp_position_N_m: 4e5\n  kv_position_N_s_m: {2 * ratio * np.sqrt(4e5 * 1150)}\n"
        f"  kp_rotation_N_m_rad: 2e5\n  kv_rotation_N_m_s_rad: {2 * ratio * np.sqrt(2e5 * 450)}\n{more}",
        *changes,
    )


def cross(x: Array) -> Array:
    """Matrix of the cross product with x."""
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def by_hand(c: Configuration, stiffness: Array) -> float:
    """Slowest eigenvalue of M x'' = -K_v x' - K x at the reference, 1/s."""
    subject = Subject(c, Stated())
    p, R = subject.path[0].p, subject.path[0].R
    M = subject.robot.mass_matrix(p, R)
    _, K_v = c.controller.gains()  # type: ignore[attr-defined]
    A = np.zeros((12, 12))
    A[:6, 6:] = np.eye(6)
    A[6:, :6], A[6:, 6:] = -np.linalg.solve(M, stiffness), -np.linalg.solve(M, np.diag(K_v))
    return float(np.linalg.eigvals(A).real.max())


VECTORS = "  rotation_error: vector_difference\n"


@pytest.mark.parametrize(
    ("degrees", "ratio", "status"),
    [(0, 0.1, "conditional"), (30, 0.05, "unstable"), (30, 0.5, "conditional"), (-30, 0.05, "unstable")],
)
def test_rotation_vector_difference_is_unstable_on_a_rotated_platform(degrees, ratio, status):
    """d(phi_d - phi) = -(1 - [phi]x / 2 + ...) dtheta: across phi a spring of 0.977 +- 0.262 i at 30 deg."""
    turned = at({"position_m": [0, 0, 1], "rotation_vector_deg": [0, degrees, 0]})
    c = cartesian(ratio, WEIGHTLESS, turned, more=VECTORS)
    phi = np.radians([0.0, degrees, 0.0])
    half = np.radians(abs(degrees)) / 2.0
    along = 0.0 if degrees == 0 else (1.0 - half / np.tan(half)) / (phi @ phi)
    K = np.zeros((6, 6))
    K[:3, :3] = 4e5 * np.eye(3)
    K[3:, 3:] = 2e5 * (np.eye(3) - cross(phi) / 2.0 + along * cross(phi) @ cross(phi))
    slowest = by_hand(c, K)
    found = judge(c)
    assert found.figures["slowest_eigenvalue_1_s"] == pytest.approx(slowest, rel=1e-5)
    assert found.status == status
    assert (slowest > 0.0) == (status == "unstable")
    assert (f"an eigenvalue grows as exp({slowest:.3g} t)" in found.claim) == (status == "unstable")


ON_A_POST = {
    "mass_kg": 300, "com_m": [0, 0, 1], "shape": {"type": "point"},
}  # fmt: skip


@pytest.mark.parametrize("stiffness", ["[1e3, 1e3, 1.001e3]", "[1e3, 1e3, 1e3]"])
@pytest.mark.parametrize("error", ["", VECTORS])
def test_pd_too_soft_to_balance_a_payload_on_a_post_is_not_reported_as_stable(stiffness, error):
    """300 kg on a post of 1 m have 2943 N m/rad."""
    pose = POSE.replace("kp_rotation_N_m_rad: 2e5", f"kp_rotation_N_m_rad: {stiffness}").partition("  model")[
        0
    ]
    c = held(f"  law: cartesian_pd\n{pose}{error}", {"platform": {"platform": {"payload": [ON_A_POST]}}})
    found = judge(c)
    assert found.status in {"unstable", "not proven"}
    assert "die out" not in found.claim


def sag_mm(c: Configuration) -> float:
    """Largest error of a leg length at the pose where the law's forces balance the weight."""
    subject = Subject(c, Stated())
    start, tau = subject.path[0], law_forces(subject, c.controller)  # type: ignore[arg-type]

    def pose(x: Array) -> tuple[Array, Array]:
        return start.p + x[:3], rotation_from_vector(x[3:]) @ start.R

    def left(x: Array) -> Array:
        p, R = pose(x)
        return jacobian(subject.platform, p, R).T @ tau(p, R, STILL) - subject.robot.gravity(p, R)

    x = root(left, STILL, tol=1e-13).x
    assert np.abs(left(x)).max() < 1e-4
    off = leg_lengths(subject.platform, *pose(x)) - leg_lengths(subject.platform, start.p, start.R)
    return 1e3 * float(np.abs(off).max())


@pytest.mark.parametrize("variant", ["constant", "constant_MG"])
@pytest.mark.parametrize(
    "law",
    [
        f"  law: pd_gravity\n{LEGS}",
        f"  law: feedforward_pd\n{LEGS}",
        f"  law: cartesian_pd\n{POSE.partition('  model')[0]}",
    ],
)
def test_frozen_model_makes_the_platform_sag_to_its_force_balance(law, variant):
    """Model frozen 0.15 m and 10 deg away."""
    c = held(f"{law}  model: {FROZEN % variant}\n", at(AT))
    deepest = sag_mm(c)
    assert deepest > 0.05
    found = judge(c)
    assert found.status == "conditional"
    sag = found.figures.get("energy", found.figures)["sag_mm"]
    assert sag == pytest.approx(deepest, rel=1e-4)
    assert f"a pose {deepest:.3g} mm of leg length off the set-point" in found.claim
    without = "has no potential" in found.claim
    assert without == any(one == "errors are small" for one in found.conditions)


def changed(law, *changes):
    """The bench holding a pose under a law, with parts of its text replaced."""
    return loads(edited(*changes, base=bench(law, rest=True).text), "my.yaml", Path())


@pytest.mark.parametrize(
    ("law", "soft_end"),
    [
        ("  law: pd\n  kp_N_m: 4e4\n  kv_N_s_m: 4e3\n", ("length_min_m: 0.75", "length_min_m: 1.52")),
        (
            "  law: pd_gravity\n  kp_N_m: 4e4\n  kv_N_s_m: 4e3\n  model: {inertia_scale: 2}\n",
            ("length_max_m: 2.2", "length_max_m: 1.66"),
        ),
    ],
)
def test_law_whose_rest_pose_lies_beyond_a_soft_end_is_not_proven_stable(law, soft_end):
    """Home is inside. Springs of 40 kN/m balance the weight, or its overcompensation, 0.09 m from it."""
    inside = judge(changed(law))
    assert inside.status == "conditional"
    assert inside.figures["energy"]["sag_mm"] > 60.0
    found = judge(changed(law, soft_end))
    assert found.status == "not proven"
    assert "it comes to rest outside its limits: leg" in found.claim


@pytest.mark.parametrize("down", [-9.81, 9.81])
def test_pid_is_proven_only_if_its_integral_limit_holds_the_weight_in_push_and_pull(down):
    """3.66 kN a leg: 102 % of the one limit and 99 % of the other; with gravity upwards the legs pull."""
    gravity = "gravity_m_s2: [0, 0, -9.81]", f"gravity_m_s2: [0, 0, {down}]"
    for limit, status in ((3500.0, "not proven"), (3800.0, "conditional")):
        law = f"  law: pid\n{LEGS}  ki_N_m_s: 4e5\n  integral_limit_N: {limit}\n"
        assert judge(changed(law, gravity)).status == status


@pytest.mark.parametrize("leg", [0, 5])
def test_one_unstable_axis_makes_the_stability_result_unstable(leg):
    wn = [600.0 if k == leg else 2.0 for k in range(6)]
    found = judge(bench(f"  law: inverse_dynamics\n  wn_rad_s: {wn}\n", rest=True))
    assert found.status == "unstable"
