"""Straight paths to the first pose and back to the path: judged before they are followed, and reported."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode, Refusal
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.loop.operating import APART_M, Inspection, Operating
from hil.signals import Operator, Order
from hil.trajectory.move import GeodesicMove
from tests.hil.cycle_bench import VIRTUAL
from tests.hil.test_operating import EYE, HERE, HOLD, PARK, START, made, no_jogging

PLATFORM = build_platform(VIRTUAL.platform)
P, R = pose_arrays(VIRTUAL.platform.home)


def way_of(metres, seconds=4.0):
    return GeodesicMove(HERE, EYE, np.array([metres, 0.0, 0.0]), EYE, seconds)


@pytest.mark.parametrize(
    ("way_m", "poses"),
    [(1e-3, 17), (0.075, 17), (0.0831, 18), (0.1, 21), (0.4999, 101), (40.0, 1001)],
)
def test_straight_path_is_checked_every_5_mm_at_17_to_1001_poses_before_it_is_followed(way_m, poses):
    seen: list[float] = []
    inspection = Inspection(PLATFORM, lambda s: seen.append(s.p[0]) or 0, "park", way_of(way_m))  # type: ignore[func-returns-value]
    ticks = 1
    while not inspection.step():
        ticks += 1
    assert not inspection.refusal
    assert len(seen) == poses
    assert ticks == -(-poses // 2)
    assert (seen[0], seen[-1]) == (0.0, way_m)
    if way_m < 1.0:
        assert np.diff(seen).max() < 1.875 * APART_M * 1.01, "evenly in time, fastest in the middle"
    assert inspection.step()
    assert len(seen) == poses, "no pose may be checked twice"


def test_joints_move_little_between_checked_poses_of_a_rotating_path():
    """One joint is closer to the origin of the platform than the others, one is farther out."""
    joints = PLATFORM.platform_joints * np.array([[0.2], *[[1.0]] * 4, [1.5]])
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    seen: list[Any] = []

    def good(sample):
        seen.append(sample.p + joints @ sample.R.T)
        return 0

    move = GeodesicMove(P, R, P, turn @ R, 4.0)
    inspection = Inspection(replace(PLATFORM, platform_joints=joints), good, "park", move)
    while not inspection.step():
        pass
    apart = np.linalg.norm(np.diff(seen, axis=0), axis=2)
    assert 0.9 * 1.875 * APART_M < apart.max() < 1.875 * APART_M * 1.01


@pytest.mark.parametrize(("bad", "at"), [(0, 0), (1, 6), (8, 50), (16, 100)])
def test_check_of_a_straight_path_ends_at_the_first_refused_pose_and_reports_its_share(bad, at):
    seen: list[int] = []

    def judge(_sample):
        seen.append(len(seen))
        return int(Refusal.STROKE) if len(seen) == bad + 1 else 0

    inspection = Inspection(PLATFORM, judge, "park", way_of(0.01))
    ticks = 1
    while not inspection.step():
        assert inspection.refusal == ""
        ticks += 1
    assert ticks == bad // 2 + 1
    assert inspection.refusal.startswith(f"park: refused, since at {at} % of it ")
    assert inspection.step()
    assert len(seen) == bad + 1


# -- the operator's word


def refusing(name, move):
    return Inspection(PLATFORM, lambda s: int(Refusal.STROKE) if s.p[0] < 0.03 else 0, name, move)


def judging(judged):
    """Operating state with this judge of paths, and a motion."""
    operating, motion = made()
    return Operating(operating.settings, 1000.0, 0.5, no_jogging(1000.0), judged), motion


def parked(judged):
    """State after a park command at 0.1 m along x of the path."""
    operating, motion = judging(judged)
    motion.start(GeodesicMove(np.array([0.1, 0.0, 0.0]), EYE, np.array([0.2, 0.0, 0.0]), EYE, 60.0), 0)
    first, moves = motion.sample(0)._replace(p=HERE), []
    for tick in range(1500):
        operating.step([PARK] if tick == 10 else (), tick, Mode.TRACKING, motion)
        if operating.parks and operating.go and motion.resting:
            moves.append(operating.way("park", tick, motion, first))
            if moves[-1] is not None:
                break
    return operating, motion, moves


def test_refused_path_to_the_first_pose_leaves_the_platform_on_hold_with_a_reason():
    operating, motion, moves = parked(refusing)
    assert moves
    assert all(move is None for move in moves)
    assert (operating.go, operating.parks, motion.resting) == (False, False, True)
    assert operating.trouble.startswith("park: refused, since ")
    operating.step([Order(Operator.KEY), Order(Operator.SPEED, (0.5,))], 1501, Mode.TRACKING, motion)
    assert operating.trouble, "neither the key nor a new speed may clear the message"
    operating.step([START], 1502, Mode.TRACKING, motion)
    assert operating.go
    assert not operating.trouble


def test_an_allowed_path_is_followed_from_its_start():
    _, motion, moves = parked(lambda name, move: Inspection(PLATFORM, lambda _: 0, name, move))
    assert all(move is None for move in moves[:-1])
    np.testing.assert_array_equal(moves[-1].sample(0.0).p, motion.sample(1500).p)
    np.testing.assert_allclose(moves[-1].sample(moves[-1].duration_s).p, HERE, atol=1e-15)


def test_path_to_the_first_pose_is_checked_again_after_a_command_or_a_new_motion():
    judged: list[Any] = []

    def noted(name, move):
        judged.append(move)
        return Inspection(PLATFORM, lambda _: 0, name, move)

    operating, motion = judging(noted)
    there = motion.sample(0)._replace(p=np.array([0.05, 0.0, 0.0]))
    found = []
    for tick, before in enumerate((None, None, "order", "motion")):
        if before == "order":
            operating.step([HOLD], tick, Mode.TRACKING, motion)
        if before == "motion":
            operating.engage(tick, motion)
        operating.way("park", tick, motion, there)
        found.append(len(judged))
    assert found == [1, 1, 2, 3]
