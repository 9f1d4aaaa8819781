"""The estimator tracks, never raises, and never changes the assembly mode silently."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.contracts.records import record_of
from hil.estimation.pose import Estimator
from hil.robot.geometry import Platform
from hil.robot.kinematics import KinematicsError, jacobian, leg_lengths
from hil.robot.kinematics_kernels import forward_kinematics_kernel

DATA = Path(__file__).parents[1] / "data"
BOOK = json.loads((DATA / "book_platform.json").read_text())
DIETMAIER = json.loads((DATA / "dietmaier40.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
FORTY = Platform.from_dict(
    {**BOOK["geometry"], "base_joints": DIETMAIER["base"], "platform_joints": DIETMAIER["platform"]}
)
HOME = (np.array([0.0, 0.0, 1.0]), np.eye(3))


def rotation(r):
    return np.ascontiguousarray(Rotation.from_rotvec(r).as_matrix())


def updated(estimator, q, dq=0.0):
    """Record of a tick with the estimated lengths and rates."""
    tick = record_of(q=q, dq=dq)
    estimator.update(tick)
    return tick


def book_pose(t):
    """The book's cubic from home to its second knot, t in 0..1 s."""
    knot = BOOK["trajectory"]["knots"][1]
    k = 3 * t**2 - 2 * t**3
    return HOME[0] + k * (np.array(knot["p"]) - HOME[0]), rotation(k * np.radians(knot["rotvec_deg"]))


def test_textbook_trajectory_is_estimated_at_1_kHz_without_a_jump_of_the_pose():
    estimator = Estimator(PLATFORM, *HOME)
    worst = 0.0
    for k in range(1, 1001):
        p, R = book_pose(k / 1000)
        estimate = updated(estimator, leg_lengths(PLATFORM, p, R))
        assert estimate["p"] == pytest.approx(p, abs=1e-9)
        assert pytest.approx(R, abs=1e-9) == estimate["R"]
        worst = max(worst, estimate["hop"])
        assert estimate["fk_iterations"] <= 3
    assert worst < 0.05


def test_twist_and_condition_number_agree_with_the_books_states():
    for s in BOOK["states"]:
        R = rotation(s["rotvec"])
        estimator = Estimator(PLATFORM, s["p"], R)
        estimate = updated(estimator, s["length"], s["rate"])
        assert estimate["twist"] == pytest.approx(np.array(s["v"] + s["omega"]), abs=1e-9)
        assert s["cond_J"] * (1 - 1e-9) <= estimate["condition"] <= s["cond_J"] * 6 ** (1 / 8)


def continued(a, b, q0, q1, p, R, steps=400):
    """Pose reached in many small steps of the lengths, or None if the path ends."""
    for k in range(1, steps + 1):
        p, R, _, _, residual, _ = forward_kinematics_kernel(a, b, q0 + (q1 - q0) * k / steps, p, R, 1e-11, 20)
        if not np.isfinite(residual):
            return None
    return p, R


@pytest.mark.parametrize("size", [1e-3, 1e-2, 5e-2, 0.1, 0.2])
def test_a_change_of_assembly_mode_is_never_silent(size):
    """A pose other than the one reached by small steps of the lengths is reported and not adopted."""
    a, b, q0 = FORTY.base_joints, FORTY.platform_joints, np.array(DIETMAIER["lengths"])
    rng = np.random.default_rng(5)
    reported = kept = 0
    for solution in DIETMAIER["solutions"]:
        p, R = np.array(solution["p"]), np.array(solution["R"])
        for _ in range(4):
            q1 = q0 + size * rng.uniform(-1, 1, 6)
            estimator = Estimator(FORTY, p, R)
            estimate = updated(estimator, q1)
            if estimate["hop"] >= 1 or estimate["fk_residual"] == np.inf:
                reported += 1
                assert np.array_equal(estimator.p, p)
                continue
            kept += 1
            truth = continued(a, b, q0, q1, p, R)
            assert truth is not None
            assert estimate["p"] == pytest.approx(truth[0], abs=1e-6)
            assert pytest.approx(truth[1], abs=1e-6) == estimate["R"]
    assert kept + reported == 160
    assert reported > 0
    assert kept > 0


def test_a_cold_start_in_a_wrong_assembly_mode_is_reported():
    """Newton's method from home finds another assembly mode for one pose in eight at 30 degrees here."""
    rng = np.random.default_rng(2)
    wrong = 0
    for _ in range(300):
        p = HOME[0] + rng.uniform(-0.3, 0.3, 3) * [1, 1, 0.5]
        R = rotation(np.radians(rng.uniform(-30, 30, 3)))
        estimate = updated(Estimator(PLATFORM, *HOME), leg_lengths(PLATFORM, p, R))
        if np.abs(estimate["p"] - p).max() > 1e-6:
            wrong += 1
            assert estimate["hop"] >= 1 or estimate["fk_residual"] == np.inf
    assert wrong > 10


def test_pose_search_finds_a_distant_pose_and_reset_restores_the_start_pose():
    p, R = book_pose(0.9)
    q = leg_lengths(PLATFORM, p, R)
    estimator = Estimator(PLATFORM, *HOME)
    assert estimator.acquire(q)
    assert estimator.p == pytest.approx(p, abs=1e-9)
    assert pytest.approx(R, abs=1e-9) == estimator.R
    assert not estimator.acquire(np.array([1.0, 1.0, 1.0, 1.0, 1.0, 9.0]))
    assert estimator.p == pytest.approx(p, abs=1e-9)
    estimator.reset(*HOME)
    assert np.array_equal(estimator.p, HOME[0])
    with pytest.raises(KinematicsError):
        estimator.reset(HOME[0], np.zeros((3, 3)))


@pytest.mark.parametrize("bad", [np.nan, -5.0, 50.0])
def test_invalid_leg_lengths_leave_the_estimated_pose_unchanged(bad):
    estimator = Estimator(PLATFORM, *HOME)
    q = leg_lengths(PLATFORM, *HOME)
    q[3] = bad
    estimate = updated(estimator, q, 1.0)
    assert estimate["fk_residual"] == np.inf
    assert np.array_equal(estimate["p"], HOME[0])
    assert np.array_equal(estimator.R, HOME[1])
    assert jacobian(PLATFORM, *HOME) @ estimate["twist"] == pytest.approx(np.ones(6), abs=1e-12)
