"""Lengths, J and its rate against physics engines; Newton's method against 40 known assemblies."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hil.contracts.records import referred
from hil.robot.geometry import Platform
from hil.robot.kinematics import (
    condition,
    continue_kinematics,
    forward_kinematics,
    jacobian,
    jacobian_rate,
    leg_lengths,
)
from hil.robot.kinematics_kernels import forward_kinematics_kernel, leg_lengths_kernel
from hil.trajectory.path import PoseSample
from tests.hil.test_dynamics import BOOK, CASES, HOME, PLATFORMS, relative, state_of

DATA = Path(__file__).parents[1] / "data"
DIETMAIER = json.loads((DATA / "dietmaier40.json").read_text())
LINUXCNC = json.loads((DATA / "forward_kinematics_iterations.json").read_text())["linuxcnc_genhexkins"]
PLATFORM = Platform.from_dict(BOOK["geometry"])
SMALL = st.lists(st.floats(-0.25, 0.25), min_size=6, max_size=6).map(np.array)


def rotation(r):
    return np.ascontiguousarray(Rotation.from_rotvec(r).as_matrix())


@pytest.mark.parametrize("case", CASES)
def test_lengths_jacobian_rates_and_accelerations_agree_with_rigid_body_engines(case):
    platform = PLATFORMS[case["geometry"]]
    p, R, twist, dtwist, *_ = state_of(case)
    e = case["expected"]
    J = jacobian(platform, p, R)
    assert relative(leg_lengths(platform, p, R), e["lengths"]) <= 1e-9
    assert relative(J, e["jacobian"]) <= 1e-9
    assert relative(J @ twist, e["rates"], 1.0) <= 1e-9
    ddq = J @ dtwist + jacobian_rate(platform, p, R, twist) @ twist
    assert relative(ddq, e["length_accels"], 1.0) <= 1e-9
    tick = referred(platform, PoseSample(p, R, twist, dtwist))
    assert relative(tick["q_d"], e["lengths"]) <= 1e-9
    assert relative(tick["dq_d"], e["rates"], 1.0) <= 1e-9
    assert relative(tick["ddq_d"], e["length_accels"], 1.0) <= 1e-9


@pytest.mark.parametrize("case", CASES)
def test_forward_kinematics_finds_the_pose_from_the_given_guess(case):
    s, e = case["state"], case["expected"]
    pose = forward_kinematics(PLATFORMS[case["geometry"]], e["lengths"], s["fk_guess_p"], s["fk_guess_R"])
    assert relative(pose.p, s["p"], 1.0) <= 1e-9
    assert relative(pose.R, s["R"]) <= 1e-9
    assert pose.residual <= 1e-12
    assert pose.iterations <= e["fk_newton_iterations"] + 1


def test_leg_lengths_and_condition_number_agree_with_the_textbook():
    for s in BOOK["states"]:
        R = rotation(s["rotvec"])
        assert relative(leg_lengths(PLATFORM, s["p"], R), s["length"]) <= 1e-9
        assert relative(jacobian(PLATFORM, s["p"], R) @ (s["v"] + s["omega"]), s["rate"], 1.0) <= 1e-9
        assert s["cond_J"] * (1 - 1e-9) <= condition(PLATFORM, s["p"], R) <= s["cond_J"] * 6 ** (1 / 8)


@pytest.mark.parametrize("number", range(40))
def test_newton_iteration_converges_to_each_nearby_assembly_mode_of_dietmaiers_platform(number):
    a, b = np.array(DIETMAIER["base"]), np.array(DIETMAIER["platform"])
    solution = DIETMAIER["solutions"][number]
    p, R = np.array(solution["p"]), np.array(solution["R"])
    rng = np.random.default_rng(number)
    for _ in range(5):
        u = rng.normal(size=6)
        u *= 1e-3 / np.linalg.norm(u)
        found = forward_kinematics_kernel(
            a, b, np.array(DIETMAIER["lengths"]), p + u[:3], rotation(u[3:]) @ R, 1e-12, 50
        )
        assert found[4] <= 1e-12
        assert np.abs(found[0] - p).max() <= 1e-7
        assert np.abs(found[1] - R).max() <= 1e-7


def study(a, b, home, tilt, count=300):
    """Mean and largest number of iterations to 1e-9, from starts 0.05 % and 0.1 degrees away."""
    rng = np.random.default_rng(1)
    size = np.abs(home).max()
    iterations = []
    for _ in range(count):
        p = home + rng.uniform(-0.1, 0.1, 3) * size
        r = np.radians(rng.uniform(-tilt, tilt, 3))
        q = leg_lengths_kernel(a, b, p, rotation(r))
        start = (p + rng.uniform(-1, 1, 3) * 5e-4 * size, rotation(r + np.radians(rng.uniform(-0.1, 0.1, 3))))
        found = forward_kinematics_kernel(a, b, q, *start, 1e-9, 30)
        assert found[4] <= 1e-9
        iterations.append(found[3])
    return np.mean(iterations), max(iterations)


def test_forward_kinematics_within_15_degrees_of_its_guess_takes_at_most_four_iterations():
    published = LINUXCNC["fk_iteration_study"]["linuxcnc_default_inch|tilt15|track(0.05%,0.1deg)"]
    a, b = np.array(LINUXCNC["base"], float), np.array(LINUXCNC["platform"], float)
    for x, y, home in (
        (a, b, np.array([0.0, 0.0, 40.0])),
        (PLATFORM.base_joints, PLATFORM.platform_joints, HOME[0]),
    ):
        mean, most = study(x, y, home, 15)
        assert most <= 4
        assert mean < published["words"]["it_mean"] / 2


@given(SMALL, SMALL)
@settings(max_examples=100)
def test_jacobian_is_the_derivative_of_the_leg_lengths(x, twist):
    """d/dt of |p + R b - a| by central differences, along p + t v, exp(t w) R."""
    p, R, h = HOME[0] + x[:3], rotation(x[3:]), 1e-5

    def moved(t):
        return p + t * twist[:3], rotation(t * twist[3:]) @ R

    ahead, behind = leg_lengths(PLATFORM, *moved(h)), leg_lengths(PLATFORM, *moved(-h))
    assert (ahead - behind) / (2 * h) == pytest.approx(jacobian(PLATFORM, p, R) @ twist, abs=1e-9)
    rate = (jacobian(PLATFORM, *moved(h)) - jacobian(PLATFORM, *moved(-h))) / (2 * h)
    assert rate == pytest.approx(jacobian_rate(PLATFORM, p, R, twist), abs=1e-8)


@given(SMALL, SMALL)
@settings(max_examples=100)
def test_forward_kinematics_inverts_inverse_kinematics(x, guess):
    p, R = HOME[0] + x[:3], rotation(x[3:])
    start = p + 0.1 * guess[:3], rotation(0.1 * guess[3:]) @ R
    pose = forward_kinematics(PLATFORM, leg_lengths(PLATFORM, p, R), *start)
    assert pose.p == pytest.approx(p, abs=1e-10)
    assert pytest.approx(R, abs=1e-10) == pose.R
    assert np.abs(pose.R.T @ pose.R - np.eye(3)).max() <= 1e-15


def test_rotation_stays_orthogonal_over_ten_thousand_ticks():
    p, R = HOME
    q = [leg_lengths(PLATFORM, HOME[0] + d, rotation([d, -d, d])) for d in (0.0, 0.01)]
    a, b = PLATFORM.base_joints, PLATFORM.platform_joints
    for k in range(10_000):
        p, R, *_ = forward_kinematics_kernel(a, b, q[k % 2], p, R, 1e-10, 12)
    assert np.abs(R.T @ R - np.eye(3)).max() <= 1e-15


def test_continued_kinematics_from_a_distant_start_agree_with_newton_in_small_steps():
    rng = np.random.default_rng(3)
    for _ in range(30):
        p, R = HOME[0] + rng.uniform(-0.2, 0.2, 3), rotation(np.radians(rng.uniform(-20, 20, 3)))
        q0, q = leg_lengths(PLATFORM, *HOME), leg_lengths(PLATFORM, p, R)
        small = HOME
        for k in range(1, 501):
            small = forward_kinematics(PLATFORM, q0 + (q - q0) * k / 500, *small)[:2]
        pose = continue_kinematics(PLATFORM, q, *HOME)
        assert pose.p == pytest.approx(small[0], abs=1e-9)
        assert pytest.approx(small[1], abs=1e-9) == pose.R
