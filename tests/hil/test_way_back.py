"""The straight ways to the first pose and back to the path: judged before they are followed, and what is said."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode, Refusal
from hil.app.compose import build_admission, build_cycle
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.loop.console import waits_for
from hil.loop.operating import Operating
from hil.loop.run_end import Course
from hil.loop.setup_moves import APART_M, Inspection
from hil.signals import Operator, Order
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.move import GeodesicMove
from tests.hil.test_operating import EYE, HERE, HOLD, PARK, START, made, no_jogging

VIRTUAL = load("virtual")
PLATFORM = build_platform(VIRTUAL.platform)
P, R = pose_arrays(VIRTUAL.platform.home)
UP = np.array([0.0, 0.0, 1.0])


def lengths(p):
    """Of the legs without a turn, by the geometry alone."""
    return np.linalg.norm(p + PLATFORM.platform_joints - PLATFORM.base_joints, axis=1)


def against(move, t, **limits):
    c = VIRTUAL.model_copy(update={"limits": VIRTUAL.limits.model_copy(update=limits)})
    return build_admission(c, PLATFORM).on_the_way(move.sample(t))


def test_a_way_may_lead_to_the_soft_ends_and_no_farther():
    high = VIRTUAL.platform.length_max_m - VIRTUAL.limits.stroke_margin_m
    room = next(z for z in np.linspace(0.0, 2.0, 2001) if lengths(P + z * UP).max() > high)
    inside, outside = (GeodesicMove(P, R, P + z * UP, R, 60.0) for z in (room - 2e-3, room + 1e-3))
    assert against(inside, 60.0) == 0
    assert against(outside, 60.0) == Refusal.STROKE


def test_a_way_breaks_no_limit_on_force_rate_braking_and_condition():
    move = GeodesicMove(P, R, P + 0.2 * UP, R, 2.0)
    rate = np.abs((lengths(move.sample(1.001).p) - lengths(move.sample(0.999).p)) / 2e-3).max()
    assert against(move, 1.0) == 0
    assert against(move, 1.0, speed_m_s=1.01 * rate) == 0
    assert against(move, 1.0, speed_m_s=0.99 * rate) == Refusal.SPEED
    left = VIRTUAL.platform.length_max_m - VIRTUAL.limits.stroke_margin_m - lengths(move.sample(1.0).p).max()
    assert against(move, 1.0, deceleration_m_s2=1.2 * rate**2 / (2.0 * left)) == 0
    assert against(move, 1.0, deceleration_m_s2=0.8 * rate**2 / (2.0 * left)) == Refusal.SPEED
    assert against(move, 1.0, force_N=100.0) == Refusal.FORCE
    assert against(move, 1.0, condition=1.5) == Refusal.CONDITION


def test_every_pose_of_a_way_is_judged_a_few_a_tick_and_none_far_from_the_next():
    seen: list[float] = []

    def good(sample):
        seen.append(sample.p[0])
        return 0

    move = GeodesicMove(HERE, EYE, np.array([0.1, 0.0, 0.0]), EYE, 4.0)
    inspection = Inspection(PLATFORM, good, "park", move)
    ticks = 1
    while not inspection.step():
        ticks += 1
    assert not inspection.refusal
    np.testing.assert_allclose((seen[0], seen[-1]), (0.0, 0.1), atol=1e-12)
    assert np.diff(seen).max() < 1.875 * APART_M * 1.01, "evenly in time, fastest in the middle"
    assert ticks == -(-len(seen) // 2), "two a tick"


UNEVEN = replace(PLATFORM, platform_joints=PLATFORM.platform_joints * np.array([[0.2], *[[1.0]] * 4, [1.5]]))
"""One joint nearer to the origin of the platform than the others, one farther out."""
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("platform", [PLATFORM, UNEVEN], ids=["even", "uneven"])
def test_no_joint_moves_far_between_two_poses_that_are_judged_of_a_way_that_turns(platform):
    seen: list[Any] = []

    def good(sample):
        seen.append(sample.p + platform.platform_joints @ sample.R.T)
        return 0

    inspection = Inspection(platform, good, "park", GeodesicMove(P, R, P, QUARTER_TURN @ R, 4.0))
    while not inspection.step():
        pass
    apart = np.linalg.norm(np.diff(seen, axis=0), axis=2)
    assert 0.9 * 1.875 * APART_M < apart.max() < 1.875 * APART_M * 1.01, (
        "evenly in time, as on a straight way"
    )


def refusing(name, move):
    return Inspection(PLATFORM, lambda s: int(Refusal.STROKE) if s.p[0] < 0.03 else 0, name, move)


@pytest.mark.parametrize(("refused", "at"), [(0, "0 %"), (7, "35 %"), (16, "80 %"), (20, "100 %")])
def test_a_refusal_says_how_far_along_the_way_the_first_pose_is_that_cannot_be_taken(refused, at):
    judged: list[float] = []

    def judge(sample):
        judged.append(float(sample.p[0]))
        return int(Refusal.STROKE) if len(judged) > refused else 0

    there = np.array([19.9 * APART_M, 0.0, 0.0])
    inspection = Inspection(PLATFORM, judge, "park", GeodesicMove(HERE, EYE, there, EYE, 3.0))
    for _ in range(20):
        if inspection.step():
            break
    assert inspection.refusal.startswith(f"park: not followed, since {at} along it ")
    assert len(judged) == refused + 1
    u = refused / 20
    assert judged[-1] == pytest.approx(there[0] * u**3 * (10.0 - 15.0 * u + 6.0 * u * u), abs=1e-12)


def parked(judged):
    """On the path at 0.1 m along x, asked to park; what it is after a while."""
    operating, motion = made()
    operating = Operating(operating.settings, 1000.0, 0.5, no_jogging(1000.0), judged)
    motion.start(GeodesicMove(np.array([0.1, 0.0, 0.0]), EYE, np.array([0.2, 0.0, 0.0]), EYE, 60.0), 0)
    first, moves = motion.sample(0)._replace(p=HERE), []
    for tick in range(1500):
        operating.step([PARK] if tick == 10 else (), tick, Mode.TRACKING, motion)
        if operating.parks and operating.go and motion.resting:
            moves.append(operating.way("park", tick, motion, first))
            if moves[-1] is not None:
                break
    return operating, motion, moves


def test_a_way_that_cannot_be_followed_leaves_the_platform_on_hold_and_says_why():
    operating, motion, moves = parked(refusing)
    assert moves
    assert all(move is None for move in moves)
    assert (operating.go, operating.parks, motion.resting) == (False, False, True)
    assert operating.trouble.startswith("park: not followed, since ")
    assert operating.trouble.endswith("% along it a leg would be outside the soft ends of its stroke")
    operating.step([Order(Operator.KEY), Order(Operator.SPEED, (0.5,))], 1501, Mode.TRACKING, motion)
    assert operating.trouble, "neither leads elsewhere"
    operating.step([START], 1502, Mode.TRACKING, motion)
    assert operating.go
    assert not operating.trouble


def test_a_way_that_is_free_is_followed_from_the_start():
    _, motion, moves = parked(lambda name, move: Inspection(PLATFORM, lambda _: 0, name, move))
    assert all(move is None for move in moves[:-1])
    np.testing.assert_array_equal(moves[-1].sample(0.0).p, motion.sample(1500).p)
    np.testing.assert_allclose(moves[-1].sample(moves[-1].duration_s).p, HERE, atol=1e-15)


def test_an_order_meanwhile_lets_the_way_be_judged_anew():
    made_of = []

    def judged(name, move):
        made_of.append(move)
        return Inspection(PLATFORM, lambda _: 0, name, move)

    operating, motion = made()
    operating = Operating(operating.settings, 1000.0, 0.5, no_jogging(1000.0), judged)
    there = motion.sample(0)._replace(p=np.array([0.05, 0.0, 0.0]))
    operating.way("park", 0, motion, there)
    operating.way("park", 1, motion, there)
    assert len(made_of) == 1
    operating.step([HOLD], 2, Mode.TRACKING, motion)
    operating.way("park", 2, motion, there)
    assert len(made_of) == 2
    operating.engage(3, motion)
    operating.way("park", 3, motion, there)
    assert len(made_of) == 3, "the way of the motion before began elsewhere"


@pytest.mark.parametrize("refusal", ["", "it is too far"])
def test_a_way_that_has_been_judged_is_taken_once_and_the_next_one_is_judged_for_itself(refusal):
    operating, motion = made()
    judged: list[Any] = []

    def at_once(name, move):
        judged.append(move)
        return SimpleNamespace(step=lambda: True, refusal=refusal, move=move)

    operating._judged = at_once
    for k, x in enumerate((0.05, 0.07)):
        operating.go = operating.parks = True
        there = motion.sample(0)._replace(p=np.array([x, 0.0, 0.0]))
        move = operating.way("park", 0, motion, there)
        assert len(judged) == k + 1
        assert move is (None if refusal else judged[k])
        assert (operating.go, operating.parks) == (not refusal, not refusal)
        assert operating.trouble == refusal


def test_start_after_a_jog_goes_back_once_to_where_the_path_was_left():
    operating, motion = made()
    judged: list[Any] = []

    def at_once(name, move):
        judged.append((name, move))
        return SimpleNamespace(step=lambda: True, refusal="", move=move)

    operating._judged = at_once
    left = motion.sample(100).p
    operating.go = False
    motion.settle(100, 0.0)
    motion.leave(HoldTrajectory(left + np.array([0.0, 0.01, 0.0]), EYE), 100)
    for tick in range(101, 111):
        operating.step([START] if tick == 101 else (), tick, Mode.TRACKING, motion)
    ((name, move),) = judged
    assert name == "start: the way back to the path"
    assert motion.trajectory is move
    np.testing.assert_allclose(move.sample(0.0).p, left + np.array([0.0, 0.01, 0.0]), atol=1e-12)
    np.testing.assert_allclose(move.sample(move.duration_s).p, left, atol=1e-12)
    assert motion.override.target == 1.0, "it is under way"


def test_operator_and_log_are_told_once_why_a_way_is_not_followed():
    cycle = build_cycle(load("virtual"), 1000.0, 0.01)
    events: list[Any] = []
    course = Course(cycle, armed=False, event=lambda *event: events.append(event))
    cycle.mode = Mode.TRACKING
    cycle.tick["t_ns"] = 5
    cycle.operating.go, cycle.operating.trouble = False, "park: not followed, since it is so"
    for _ in range(2):
        course._tell()
    assert events == [(5, "warning", "park: not followed, since it is so")]
    assert waits_for(course) == "another order: park: not followed, since it is so"
    stub: Any = SimpleNamespace(cycle=cycle)
    cycle.operating.trouble = ""
    assert waits_for(stub) == "start"


def test_armed_again_nobody_is_told_why_a_way_was_not_followed_before_and_the_log_is_told_it_anew():
    cycle = build_cycle(load("virtual"), 1000.0, 0.01)
    told: list[str] = []
    course = Course(cycle, event=lambda _t, _level, text: told.append(text))
    cycle.mode = Mode.TRACKING
    for tick in (10, 20):
        cycle.operating.engage(tick, cycle.motion)
        cycle.operating.go = False
        assert waits_for(course) == "start"
        course._tell()
        cycle.operating.trouble = "park: not followed, since it is so"
        course._tell()
    assert told == ["park: not followed, since it is so"] * 2


@pytest.mark.parametrize(
    ("way_m", "poses"), [(1e-3, 17), (0.075, 17), (0.0831, 18), (0.4999, 101), (40.0, 1001)]
)
def test_a_way_has_a_pose_every_5_mm_and_at_least_17_and_at_most_1001(way_m, poses):
    seen: list[float] = []

    def good(sample):
        seen.append(sample.p[0])
        return 0

    inspection = Inspection(
        PLATFORM, good, "park", GeodesicMove(HERE, EYE, np.array([way_m, 0.0, 0.0]), EYE, 4.0)
    )
    while not inspection.step():
        pass
    assert len(seen) == poses
    assert (seen[0], seen[-1]) == (0.0, way_m)
    assert inspection.step()
    assert len(seen) == poses, "none is judged twice"


@pytest.mark.parametrize(("bad", "asked", "at"), [(0, 1, 0), (1, 2, 6), (8, 9, 50), (16, 17, 100)])
def test_the_first_pose_that_is_refused_ends_the_judgement_and_is_named_by_its_share_of_the_time(
    bad, asked, at
):
    seen: list[int] = []

    def judge(_sample):
        seen.append(len(seen))
        return int(Refusal.STROKE) if len(seen) == bad + 1 else 0

    inspection = Inspection(
        PLATFORM, judge, "park", GeodesicMove(HERE, EYE, np.array([0.01, 0.0, 0.0]), EYE, 4.0)
    )
    ticks = 1
    while not inspection.step():
        assert inspection.refusal == ""
        ticks += 1
    assert len(seen) == asked
    assert ticks == bad // 2 + 1
    reason = "a leg would be outside the soft ends of its stroke"
    assert inspection.refusal == f"park: not followed, since {at} % along it {reason}"
    assert inspection.step()
    assert len(seen) == asked
