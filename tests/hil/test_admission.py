"""Admission: against the book's platform, its static forces and its start."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.compiled.pointed import data_at
from drivers.signals import Refusal
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.loop.admission import ADMISSION, Admission, judge
from hil.robot.dynamics import Model
from hil.robot.kinematics import condition
from hil.trajectory.path import PoseSample

BOOK = json.loads((Path(__file__).parents[1] / "data/book_platform.json").read_text())
HOME = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def off(*words):
    """Home, moved by six words."""
    return HOME + np.array(words)


VIRTUAL = load("virtual")
PLATFORM = build_cycle(VIRTUAL, 1000.0, 0.01).parts.platform
STATIC = float(np.abs(BOOK["home_static"]["force"]).max())


def admission(ddchi=(0, 0, 0, 0, 0, 0), low=0.75, high=2.2, rated=30_000.0, stop_s=0.5, **limits):
    settings = VIRTUAL.limits.model_copy(update=limits)
    return Admission(PLATFORM, Model(PLATFORM), settings, low, high, rated, np.array(ddchi, float), stop_s)


def lengths(chi):
    a, b = (np.array(BOOK["geometry"][k]) for k in ("base_joints", "platform_joints"))
    return np.linalg.norm(chi[:3] + Rotation.from_rotvec(chi[3:]).apply(b) - a, axis=1)


def test_home_is_a_good_place():
    assert admission()(HOME) == 0


@pytest.mark.parametrize("seed", range(20))
def test_a_pose_is_refused_exactly_a_millimetre_before_a_soft_end(seed):
    rng = np.random.default_rng(seed)
    chi = HOME + rng.uniform(-0.15, 0.15, 6)
    q = lengths(chi)
    roomy = {"force_N": 1e9, "condition": 1e9, "stroke_margin_m": 0.02}
    for low, high, expected in (
        (q.min() - 0.021 - 1e-9, q.max() + 0.021 + 1e-9, 0),
        (q.min() - 0.021 + 1e-9, q.max() + 0.1, Refusal.STROKE),
        (q.min() - 0.1, q.max() + 0.021 - 1e-9, Refusal.STROKE),
    ):
        assert admission(low=low, high=high, rated=1e12, **roomy)(chi) == expected


@pytest.mark.parametrize("leg", range(6))
def test_a_way_is_refused_exactly_where_a_leg_gets_shorter_or_longer_than_its_soft_ends(leg):
    """Each leg in turn is the shortest one, and the longest one."""
    toward = np.array(BOOK["geometry"]["base_joints"])[leg] * np.array([1.0, 1.0, 0.0])
    roomy = {"force_N": 1e9, "condition": 1e9, "stroke_margin_m": 0.02, "rated": 1e12}
    for way, end in ((0.3, np.argmin), (-0.3, np.argmax)):
        p = HOME[:3] + way * toward / np.linalg.norm(toward)
        q = lengths(np.array([*p, 0.0, 0.0, 0.0]))
        assert end(q) == leg
        there = PoseSample(p, np.eye(3), np.zeros(6), np.zeros(6))
        for low, high, expected in (
            (q.min() - 0.02 - 1e-9, q.max() + 0.02 + 1e-9, 0),
            (q.min() - 0.02 + 1e-9, q.max() + 0.1, Refusal.STROKE),
            (q.min() - 0.1, q.max() + 0.02 - 1e-9, Refusal.STROKE),
        ):
            assert admission(low=low, high=high, **roomy).on_the_way(there) == expected


def test_the_force_at_rest_is_the_books():
    assert admission(force_N=STATIC * (1 + 1e-6))(HOME) == 0
    assert admission(force_N=STATIC * (1 - 1e-6))(HOME) == Refusal.FORCE


def test_the_drives_rated_force_counts_as_well():
    assert admission(rated=STATIC * 0.99)(HOME) == Refusal.FORCE


def test_the_force_leaves_room_for_the_largest_accelerations():
    """At its start the book's path stands at home and accelerates: its forces must fit."""
    start = BOOK["states"][0]
    ddchi = np.abs([*start["a"], *start["alpha"]])
    needed = float(np.abs(start["force"]).max())
    assert needed > 1.2 * STATIC
    assert admission(ddchi, force_N=needed * (1 - 1e-6))(HOME) == Refusal.FORCE
    # Each axis accelerates either way: at most the sum over the axes.
    assert admission(ddchi, force_N=STATIC + 6 * (needed - STATIC))(HOME) == 0


def test_a_pose_near_the_turn_of_a_right_angle_about_z_is_singular():
    turned = off(0, 0, 0, 0, 0, np.deg2rad(89))
    roomy = {"force_N": 1e9, "low": 0.1, "high": 5.0}
    assert admission(**roomy)(turned) & Refusal.CONDITION
    assert admission(**roomy)(off(0, 0, 0, 0, 0, np.deg2rad(30))) == 0


@pytest.mark.parametrize("word", range(6))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_no_pose(word, value):
    chi = HOME.copy()
    chi[word] = value
    assert admission()(chi) == Refusal.NOT_A_POSE


def test_more_than_half_a_turn_is_no_pose():
    assert admission()(off(0, 0, 0, 0, 3.2, 0)) == Refusal.NOT_A_POSE


@pytest.mark.parametrize(
    "axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0, 0.8), (0, 0.8, 0.6), (0.6, 0.8, 0)]
)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_half_a_turn_about_any_axis_is_a_pose_and_more_is_none(axis, way):
    roomy = {"force_N": 1e99, "rated": 1e99, "low": -1e9, "high": 1e9, "condition": 1e99}
    for turns, is_pose in ((0.50005, False), (0.49995, True)):
        found = admission(**roomy)(off(0, 0, 0, *(way * turns * 2.0 * np.pi * np.array(axis))))
        assert (found != Refusal.NOT_A_POSE) == is_pose


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_half_a_turn_is_a_pose_to_the_last_bit(axis, way):
    roomy = {"force_N": 1e99, "rated": 1e99, "low": -1e9, "high": 1e9, "condition": 1e99}
    for angle, is_pose in ((np.pi, True), (np.nextafter(np.pi, 4.0), False)):
        found = admission(**roomy)(off(0, 0, 0, *(way * angle * np.eye(3)[axis])))
        assert (found != Refusal.NOT_A_POSE) == is_pose


@pytest.mark.parametrize(("fall", "sign"), [(0.0, 1.0), (3.0, -1.0)], ids=["pushes", "pulls"])
def test_a_leg_may_push_and_pull_on_the_way_with_no_more_than_its_force(fall, sign):
    """At rest all legs push; down with three times the acceleration of free fall they pull."""
    dtwist = np.array([*(fall * PLATFORM.gravity), 0.0, 0.0, 0.0])
    tau = Model(PLATFORM).inverse_dynamics(HOME[:3], np.eye(3), np.zeros(6), dtwist)
    assert (sign * tau > 0.9 * STATIC).all()
    there = PoseSample(HOME[:3], np.eye(3), np.zeros(6), dtwist)
    assert admission(force_N=np.abs(tau).max() * (1 + 1e-6)).on_the_way(there) == 0
    assert admission(force_N=np.abs(tau).min() * (1 - 1e-6)).on_the_way(there) == Refusal.FORCE


@pytest.mark.parametrize(("share", "steepest"), [(1.0, 1.5), (0.3, np.sqrt(4.5 * 0.3))])
@pytest.mark.parametrize(
    ("twist", "stop_s"),
    [((0.2, 0, 0, 0, 0, 0), 0.5), ((0, 0, -0.3, 0, 0, 0), 2.0), ((0, 0, 0, 0, 0, 0.5), 0.1)],
)
def test_a_jogs_forces_change_within_250_ms_by_no_more_than_is_said_and_by_most_of_it(
    twist, stop_s, share, steepest
):
    """Forces of the motion itself: rest, the steepest sigma', at speed, its steepest fall, and 250 ms on.

    With |sigma''| <= 4.5 / T^2 a change by s has sigma' of up to sqrt(4.5 s) / T, and of 1.5 / T at most.
    """
    model, twist = Model(PLATFORM), np.array(twist)
    here = PoseSample(HOME[:3], np.eye(3), twist, np.zeros(6))
    said = admission(stop_s=stop_s).change_N(here, share)
    forces = []
    for sigma, rate, t in [
        (0, 0, 0),
        (0, 1, 0),
        (1, 1, 0),
        (1, 0, 0),
        (1, 0, 0.25),
        (1, -1, 0.25),
        (0, -1, 0.25),
    ]:
        R = Rotation.from_rotvec(share * t * twist[3:]).as_matrix()
        motion = share * sigma * twist, rate * steepest / stop_s * twist
        forces.append(model.inverse_dynamics(HOME[:3] + share * t * twist[:3], R, *motion))
    seen = float(np.ptp(forces, axis=0).max())
    assert 0.8 * said < seen <= said * (1 + 1e-9)
    assert not admission(stop_s=stop_s, force_window_N=said * (1 + 1e-9)).too_sudden(here, share)
    assert admission(stop_s=stop_s, force_window_N=said * (1 - 1e-9)).too_sudden(here, share)


def test_a_change_of_force_that_is_no_number_is_too_sudden():
    assert admission().too_sudden(PoseSample(HOME[:3], np.eye(3), np.full(6, np.nan), np.zeros(6)), 1.0)


def test_a_leg_may_be_as_short_or_as_long_as_its_ends_to_the_last_bit():
    """At (3, 4, 12) m all six legs are 13 m long, exactly."""
    b = PLATFORM.platform_joints
    chi = np.array([3.0, 4.0, 12.0, 0.0, 0.0, 0.0])
    model, k = Model(PLATFORM), np.zeros((), ADMISSION)
    k["base_joints"] = k["platform_joints"] = b
    k["radius"], k["constants"], k["code"] = PLATFORM.radius, data_at(model.constants), model.code
    k["condition"], k["force"] = 1e9, 1e99

    def judged(low, high):
        k["low"], k["high"] = low, high
        return judge(k, chi)

    assert judged(13.0, 13.0) != Refusal.STROKE
    assert judged(np.nextafter(13.0, 14.0), 14.0) == Refusal.STROKE
    assert judged(12.0, np.nextafter(13.0, 12.0)) == Refusal.STROKE


@pytest.mark.parametrize("seed", range(12))
def test_the_change_of_forces_is_that_of_weight_speed_and_inertia_from_here_to_250_ms_on(seed):
    """A sample that moves, turns and accelerates, forces by the equations of motion at both ends of that way."""
    rng = np.random.default_rng(seed)
    twist = rng.uniform(-1.0, 1.0, 6) * [0.4, 0.4, 0.4, 0.6, 0.6, 0.6]
    dtwist = rng.uniform(-1.0, 1.0, 6) * 30.0
    p, R = HOME[:3] + rng.uniform(-0.1, 0.1, 3), Rotation.from_rotvec(rng.uniform(-0.2, 0.2, 3))
    share, stop_s = rng.uniform(0.2, 1.0), rng.uniform(0.3, 2.0)
    v, a, model = share * twist, share**2 * dtwist, Model(PLATFORM)
    zero, ends = np.zeros(6), []
    for t in (0.0, 0.25):
        turned = (Rotation.from_rotvec(t * v[3:]) * R).as_matrix()
        here = p + t * v[:3], turned
        rest = model.inverse_dynamics(*here, zero, zero)
        ends.append((rest, *(model.inverse_dynamics(*here, *each) - rest for each in ((v, a), (zero, v)))))
    (rest, going, inertia), (rest1, going1, inertia1) = ends
    faster = min(1.5, np.sqrt(4.5 * share)) / (stop_s * share)
    by_speed = np.maximum(np.abs(going), np.abs(going1))
    change = np.abs(rest1 - rest) + by_speed + faster * (np.abs(inertia) + np.abs(inertia1))
    said = admission(stop_s=stop_s).change_N(PoseSample(p, R.as_matrix(), twist, dtwist), share)
    assert said == pytest.approx(change.max(), rel=1e-9)


def test_a_pose_and_a_way_may_be_as_near_to_a_singular_pose_as_the_limit_to_the_last_bit():
    p, R = HOME[:3], np.eye(3)
    limit = condition(PLATFORM, p, R)
    there = PoseSample(p, R, np.zeros(6), np.zeros(6))
    for most, expected in ((limit, 0), (np.nextafter(limit, 0.0), Refusal.CONDITION)):
        judge_it = admission(condition=most)
        assert judge_it(HOME) == expected
        assert judge_it.on_the_way(there) == expected
