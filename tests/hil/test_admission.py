"""Admission of set-points, moves and jogs against the book's platform, and the steering of a live reference."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import Refusal
from hil.app.compose import build_cycle
from hil.loop.admission import Admission, Counts, Steering
from hil.robot.dynamics import Model
from hil.robot.kinematics import condition, jacobian, leg_lengths
from hil.signals import SetPoint
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.path import PoseSample
from tests.hil.cycle_bench import VIRTUAL
from tests.pose_judges import judged

BOOK = json.loads((Path(__file__).parents[1] / "data/book_platform.json").read_text())
HOME = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
PLATFORM = build_cycle(VIRTUAL, 1000.0, 0.01).parts.platform
MODEL = Model(PLATFORM)
STATIC = float(np.abs(BOOK["home_static"]["force"]).max())
P, R, STILL = HOME[:3] + np.array([0.02, -0.03, 0.04]), np.eye(3), np.zeros(6)
CHI, THERE = np.array([*P, 0.0, 0.0, 0.0]), PoseSample(P, R, STILL, STILL)
ROOMY: dict[str, Any] = {
    "force_N": 1e9, "rated": 1e12, "condition": 1e9, "stroke_margin_m": 0.0, "low": 0.1, "high": 5.0,
    "speed_m_s": 9.0, "deceleration_m_s2": 1e3,
}  # fmt: skip
LEGS_AND_WAYS = pytest.mark.parametrize(
    ("leg", "way"), [(leg, way) for leg in range(6) for way in (1.0, -1.0)]
)


def admission(ddchi=(0, 0, 0, 0, 0, 0), low=0.75, high=2.2, rated=30_000.0, stop_s=0.5, **limits):
    settings = VIRTUAL.limits.model_copy(update=limits)
    return Admission(PLATFORM, MODEL, settings, low, high, rated, np.array(ddchi, float), stop_s)


def lengths(chi):
    a, b = (np.array(BOOK["geometry"][k]) for k in ("base_joints", "platform_joints"))
    return np.linalg.norm(chi[:3] + Rotation.from_rotvec(chi[3:]).apply(b) - a, axis=1)


def toward(leg, way):
    """A position at which a leg is the shortest one, or (way -1) the longest one."""
    base = np.array(BOOK["geometry"]["base_joints"])[leg] * np.array([1.0, 1.0, 0.0])
    return HOME[:3] + way * 0.3 * base / np.linalg.norm(base)


# -- limits to the last bit


@pytest.mark.parametrize(
    ("fields", "most", "stricter", "refusal"),
    [
        (("low", "soft_min"), leg_lengths(PLATFORM, P, R).min(), 9.0, Refusal.STROKE),
        (("high", "soft_max"), leg_lengths(PLATFORM, P, R).max(), 0.0, Refusal.STROKE),
        (("condition",), condition(PLATFORM, P, R), 0.0, Refusal.CONDITION),
        (("force",), np.abs(MODEL.inverse_dynamics(P, R, STILL, STILL)).max(), 0.0, Refusal.FORCE),
    ],
)
def test_poses_and_paths_are_accepted_at_a_limit_and_refused_just_beyond_it(fields, most, stricter, refusal):
    judge = admission(**ROOMY)
    for limit, expected in ((most, 0), (np.nextafter(most, stricter), refusal)):
        for name in fields:
            judge._record[name] = limit
        assert judge(CHI) == expected
        assert judge.on_the_way(THERE) == expected


# -- set-points


def test_home_pose_is_refused_if_the_force_limit_is_below_the_textbook_static_force():
    assert admission()(HOME) == 0
    assert admission(force_N=STATIC * (1 + 1e-6))(HOME) == 0
    assert admission(force_N=STATIC * (1 - 1e-6))(HOME) == Refusal.FORCE
    assert admission(rated=STATIC * 0.99)(HOME) == Refusal.FORCE, "the rated force of the drives limits, too"


@pytest.mark.parametrize("seed", range(8))
def test_a_set_point_is_refused_from_1_mm_before_a_soft_end(seed):
    chi = HOME + np.random.default_rng(seed).uniform(-0.15, 0.15, 6)
    q = lengths(chi)
    for low, high, expected in (
        (q.min() - 0.021 - 1e-9, q.max() + 0.021 + 1e-9, 0),
        (q.min() - 0.021 + 1e-9, q.max() + 0.1, Refusal.STROKE),
        (q.min() - 0.1, q.max() + 0.021 - 1e-9, Refusal.STROKE),
    ):
        assert admission(**ROOMY | {"low": low, "high": high, "stroke_margin_m": 0.02})(chi) == expected


@pytest.mark.parametrize("word", range(6))
def test_the_force_check_includes_the_largest_acceleration_of_each_axis(word):
    ddchi = 3.0 * np.eye(6)[word]
    rest = MODEL.inverse_dynamics(P, R, STILL, STILL)
    most = max(np.abs(MODEL.inverse_dynamics(P, R, STILL, way * ddchi)).max() for way in (1.0, -1.0))
    assert most > 1.05 * np.abs(rest).max()
    assert admission(ddchi, **ROOMY | {"force_N": most * (1 + 1e-9)})(CHI) == 0
    assert admission(ddchi, **ROOMY | {"force_N": most * (1 - 1e-9)})(CHI) == Refusal.FORCE


def test_a_pose_rotated_by_nearly_90_degrees_about_z_is_singular():
    roomy = {"force_N": 1e9, "low": 0.1, "high": 5.0}
    for turn_deg, refused in ((89, True), (30, False)):
        turned = HOME + np.array([0, 0, 0, 0, 0, np.deg2rad(turn_deg)])
        assert bool(admission(**roomy)(turned) & Refusal.CONDITION) == refused


@pytest.mark.parametrize("word", range(6))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_non_finite_pose_is_refused(word, value):
    chi = HOME.copy()
    chi[word] = value
    assert admission()(chi) == Refusal.NOT_A_POSE


AXES = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0, 0.8), (0, 0.8, 0.6), (0.6, 0.8, 0)]


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_rotations_up_to_180_degrees_are_poses_and_larger_ones_are_not(axis, way):
    judge = admission(**ROOMY | {"low": -1e9, "high": 1e9, "force_N": 1e99, "rated": 1e99, "condition": 1e99})
    exact = [(np.pi, True), (np.nextafter(np.pi, 4.0), False)] if 1 in axis else []
    for angle, is_pose in ((1.0001 * np.pi, False), (0.9999 * np.pi, True), *exact):
        found = judge(HOME + np.array([0, 0, 0, *(way * angle * np.array(axis))]))
        assert (found != Refusal.NOT_A_POSE) == is_pose


# -- moves


def one_leg(leg, rate, p=P):
    """A sample in which only one leg changes its length."""
    return PoseSample(p, R, np.linalg.solve(jacobian(PLATFORM, p, R), rate * np.eye(6)[leg]), STILL)


@pytest.mark.parametrize("leg", range(6))
def test_a_path_is_refused_exactly_where_a_leg_passes_its_soft_ends(leg):
    for way, end in ((1.0, np.argmin), (-1.0, np.argmax)):
        p = toward(leg, way)
        q = lengths(np.array([*p, 0.0, 0.0, 0.0]))
        assert end(q) == leg
        for low, high, expected in (
            (q.min() - 0.02 - 1e-9, q.max() + 0.02 + 1e-9, 0),
            (q.min() - 0.02 + 1e-9, q.max() + 0.1, Refusal.STROKE),
            (q.min() - 0.1, q.max() + 0.02 - 1e-9, Refusal.STROKE),
        ):
            judge = admission(**ROOMY | {"low": low, "high": high, "stroke_margin_m": 0.02})
            assert judge.on_the_way(PoseSample(p, R, STILL, STILL)) == expected


@LEGS_AND_WAYS
def test_on_a_path_a_leg_may_move_at_its_speed_limit_but_no_faster(leg, way):
    judge = admission(**ROOMY | {"speed_m_s": 0.3})
    assert judge.on_the_way(one_leg(leg, way * 0.3 * (1 - 1e-9))) == 0
    assert judge.on_the_way(one_leg(leg, way * 0.3 * (1 + 1e-9))) == Refusal.SPEED


@LEGS_AND_WAYS
def test_on_a_path_a_leg_must_be_able_to_brake_before_its_end(leg, way):
    """At 2 m/s^2 and 0.04 m from its end a leg may move at 0.4 m/s; it is the nearest one to that end."""
    p = toward(leg, -way)
    q = lengths(np.array([*p, 0.0, 0.0, 0.0]))
    assert (way * q).argmax() == leg
    ends = {"high": q[leg] + 0.04} if way > 0.0 else {"low": q[leg] - 0.04}
    judge = admission(**ROOMY | ends | {"deceleration_m_s2": 2.0})
    for share, expected in ((1 - 1e-6, 0), (1 + 1e-6, Refusal.SPEED), (-1 - 1e-6, 0)):
        assert judge.on_the_way(one_leg(leg, share * way * 0.4, p)) == expected


@LEGS_AND_WAYS
def test_on_a_path_a_leg_may_push_and_pull_up_to_its_force_limit(leg, way):
    """In motion, where this leg has to give 5 kN, and the others 1 kN in the other direction."""
    twist = np.array([0.1, -0.2, 0.15, 0.3, -0.2, 0.25])
    moving = MODEL.inverse_dynamics(P, R, twist, STILL)
    inertia = np.array([MODEL.inverse_dynamics(P, R, twist, each) - moving for each in np.eye(6)]).T
    asked = np.where(np.arange(6) == leg, 5000.0 * way, -1000.0 * way)
    there = PoseSample(P, R, twist, np.linalg.solve(inertia, asked - moving))
    assert admission(**ROOMY | {"force_N": 5000.0 * (1 + 1e-9)}).on_the_way(there) == 0
    assert admission(**ROOMY | {"force_N": 5000.0 * (1 - 1e-9)}).on_the_way(there) == Refusal.FORCE


@pytest.mark.parametrize("word", range(6))
@pytest.mark.parametrize("part", ["twist", "dtwist"])
def test_a_path_with_non_finite_motion_is_refused(part, word):
    motion = np.where(np.arange(6) == word, np.nan, 0.0)
    assert admission(**ROOMY).on_the_way(THERE) == 0
    assert admission(**ROOMY).on_the_way(THERE._replace(**{part: motion})) != 0


# -- jogs: what a force changes by within 250 ms


@pytest.mark.parametrize(("share", "steepest"), [(1.0, 1.5), (0.3, np.sqrt(4.5 * 0.3))])
@pytest.mark.parametrize(
    ("twist", "stop_s"),
    [((0.2, 0, 0, 0, 0, 0), 0.5), ((0, 0, -0.3, 0, 0, 0), 2.0), ((0, 0, 0, 0, 0, 0.5), 0.1)],
)
def test_bound_on_force_changes_of_a_jog_within_250_ms_holds_and_is_tight(twist, stop_s, share, steepest):
    """Forces of the motion: at rest, at the steepest sigma', at speed, at its steepest fall, 250 ms later.

    With |sigma''| <= 4.5 / T^2 a change by s has sigma' of up to sqrt(4.5 s) / T, and of 1.5 / T at most.
    """
    twist = np.array(twist)
    here = PoseSample(HOME[:3], np.eye(3), twist, np.zeros(6))
    bound = admission(stop_s=stop_s).change_N(here, share)
    forces = []
    for sigma, rate, t in (
        *((0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)),
        *((1, 0, 0.25), (1, -1, 0.25), (0, -1, 0.25)),
    ):
        turned = Rotation.from_rotvec(share * t * twist[3:]).as_matrix()
        motion = share * sigma * twist, rate * steepest / stop_s * twist
        forces.append(MODEL.inverse_dynamics(HOME[:3] + share * t * twist[:3], turned, *motion))
    seen = float(np.ptp(forces, axis=0).max())
    assert 0.8 * bound < seen <= bound * (1 + 1e-9)


def test_jog_is_refused_if_it_changes_a_leg_force_by_more_than_force_window_N():
    there = PoseSample(P, R, np.array([0.2, -0.1, 0.1, 0.3, 0.2, -0.3]), STILL)
    change = admission().change_N(there, 0.5)
    assert change > 1.0
    assert not admission(force_window_N=change).too_sudden(there, 0.5)
    assert admission(force_window_N=np.nextafter(change, 0.0)).too_sudden(there, 0.5)
    assert admission().change_N(there, 0.0) == 0.0
    assert admission().too_sudden(there._replace(twist=np.full(6, np.nan)), 1.0), "twist is not finite"


# -- steering


START = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
LIMITS = np.array([[0.3] * 6, [1.0] * 6, [10.0] * 6])


def world(chi):
    """A workspace that ends at x = 0.2, with a wall between y = 0.05 and 0.06."""
    return (Refusal.STROKE if abs(chi[0]) > 0.2 else 0) | (Refusal.FORCE if 0.05 < chi[1] < 0.06 else 0)


@pytest.fixture
def steering():
    return Steering(LiveTrajectory(START, LIMITS, 1e-3), world, judged(world))


def at(x=0.0, y=0.0):
    return SetPoint(x, y, 1.0, 0.0, 0.0, 0.0)


def move(steering, points, tick, *, tracking=True):
    """Accept or refuse set-points, and advance the trajectory to a tick, as the cycle does."""
    steering.take(points, tracking=tracking)
    against = 0 if tick is None else steering.trajectory.advance(tick, steering.judge)
    if against:
        steering.stopped(against)


def go(steering, first, last):
    for tick in range(first, last):
        move(steering, (), tick)
    return steering.trajectory.sample(0.0).p


def test_a_valid_set_point_is_accepted_and_reached(steering):
    move(steering, (at(0.1),), 1)
    assert steering.counts == Counts(1, 0, 0)
    assert steering.answers == [0]
    np.testing.assert_allclose(go(steering, 2, 2000), [0.1, 0, 1], rtol=0, atol=1e-14)
    assert steering.answers == []


def test_an_invalid_set_point_is_refused_and_the_earlier_one_stays(steering):
    move(steering, (at(0.1),), 1)
    move(steering, (at(0.3),), 2)
    assert steering.counts == Counts(1, 1, Refusal.STROKE)
    assert steering.answers == [Refusal.STROKE]
    assert go(steering, 3, 2000)[0] == pytest.approx(0.1, abs=1e-14)
    assert steering.counts == Counts(1, 1, 0), "the refusal is reported once but stays counted"


def test_last_valid_set_point_of_several_in_one_tick_is_followed(steering):
    move(steering, (at(0.1), at(-0.1), at(9.0)), 1)
    assert steering.answers == [0, 0, Refusal.STROKE]
    assert steering.counts == Counts(2, 1, Refusal.STROKE)
    assert go(steering, 2, 2000)[0] == pytest.approx(-0.1, abs=1e-14)


def test_set_points_outside_tracking_are_refused(steering):
    move(steering, (at(0.1),), None, tracking=False)
    assert steering.answers == [Refusal.NOT_TRACKING]
    steering.trajectory.reset()
    assert go(steering, 1, 500)[0] == 0.0
    assert steering.counts == Counts(0, 1, 0), "a reset of the trajectory must not clear the count"


def test_platform_stops_before_a_force_limit_and_counts_one_refused_set_point(steering):
    move(steering, (at(0.0, 0.1),), 1)
    refusals = []
    for tick in range(2, 2000):
        move(steering, (), tick)
        refusals.append(steering.counts.refusal)
        assert steering.trajectory.sample(0.0).p[1] <= 0.05
    assert steering.counts == Counts(1, 1, 0)
    assert [r for r in refusals if r] == [Refusal.FORCE | Refusal.ON_THE_WAY]
    assert steering.trajectory.sample(0.0).p[1] > 0.049


def test_a_refused_set_point_and_path_in_one_tick_are_both_reported(steering):
    """The platform moves in a tick with set-points as in a tick without."""
    move(steering, (at(0.0, 0.04),), 1)
    before = go(steering, 2, 300)[1]
    steering._admission = lambda chi: Refusal.STROKE if abs(chi[0]) > 0.2 else Refusal.FORCE
    steering.judge = judged(steering._admission)
    move(steering, (at(0.3),), 300)
    assert steering.trajectory.sample(0.0).p[1] > before
    assert steering.counts == Counts(1, 2, Refusal.STROKE | Refusal.FORCE | Refusal.ON_THE_WAY)
    assert steering.answers == [Refusal.STROKE]
