"""What a move may ask of each leg on its way: rate, braking way before an end, and force, by leg and direction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.signals import Refusal
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian, leg_lengths
from hil.trajectory.path import PoseSample
from tests.hil.test_admission import HOME, PLATFORM, admission, lengths

P, R, STILL = HOME[:3] + np.array([0.02, -0.03, 0.04]), np.eye(3), np.zeros(6)
J = jacobian(PLATFORM, P, R)
ROOMY: Any = {
    "force_N": 1e9,
    "rated": 1e12,
    "condition": 1e9,
    "stroke_margin_m": 0.0,
    "low": 0.1,
    "high": 5.0,
}
LEGS_AND_WAYS = [(leg, way) for leg in range(6) for way in (1.0, -1.0)]


def one_leg(leg: int, rate: float) -> PoseSample:
    """A sample in which one leg alone changes its length."""
    return PoseSample(P, R, np.linalg.solve(J, rate * np.eye(6)[leg]), STILL)


@pytest.mark.parametrize(("leg", "way"), LEGS_AND_WAYS)
def test_on_a_way_each_leg_gets_longer_and_shorter_as_fast_as_the_limit_and_no_faster(leg, way):
    judge = admission(**ROOMY, speed_m_s=0.3, deceleration_m_s2=1e3)
    assert judge.on_the_way(one_leg(leg, way * 0.3 * (1 - 1e-9))) == 0
    assert judge.on_the_way(one_leg(leg, way * 0.3 * (1 + 1e-9))) == Refusal.SPEED


@pytest.mark.parametrize(("leg", "way"), LEGS_AND_WAYS)
def test_on_a_way_each_leg_can_brake_before_the_end_that_it_moves_to(leg, way):
    """With 2 m/s^2 and 0.04 m before it a leg may have 0.4 m/s; it is the nearest one to that end."""
    toward = PLATFORM.base_joints[leg] * np.array([1.0, 1.0, 0.0])
    p = HOME[:3] - way * 0.3 * toward / np.linalg.norm(toward)
    q = lengths(np.array([*p, 0.0, 0.0, 0.0]))
    assert (way * q).argmax() == leg
    ends = {"high": q[leg] + 0.04} if way > 0.0 else {"low": q[leg] - 0.04}
    judge = admission(**ROOMY | ends, speed_m_s=9.0, deceleration_m_s2=2.0)
    twist = np.linalg.solve(jacobian(PLATFORM, p, R), way * 0.4 * np.eye(6)[leg])
    for share, expected in ((1 - 1e-6, 0), (1 + 1e-6, Refusal.SPEED), (-1 - 1e-6, 0)):
        assert judge.on_the_way(PoseSample(p, R, share * twist, STILL)) == expected


@pytest.mark.parametrize(("leg", "way"), LEGS_AND_WAYS)
def test_on_a_way_each_leg_pushes_and_pulls_with_what_its_limit_allows_by_the_equations_of_motion(leg, way):
    """In motion, where that leg alone has to give 5 kN, and the others 1 kN the other way."""
    model, twist = Model(PLATFORM), np.array([0.1, -0.2, 0.15, 0.3, -0.2, 0.25])
    moving = model.inverse_dynamics(P, R, twist, STILL)
    inertia = np.array([model.inverse_dynamics(P, R, twist, each) - moving for each in np.eye(6)]).T
    asked = np.where(np.arange(6) == leg, 5000.0 * way, -1000.0 * way)
    there = PoseSample(P, R, twist, np.linalg.solve(inertia, asked - moving))
    roomy = ROOMY | {"speed_m_s": 9.0, "deceleration_m_s2": 1e3}
    assert admission(**roomy | {"force_N": 5000.0 * (1 + 1e-9)}).on_the_way(there) == 0
    assert admission(**roomy | {"force_N": 5000.0 * (1 - 1e-9)}).on_the_way(there) == Refusal.FORCE


@pytest.mark.parametrize("word", range(6))
@pytest.mark.parametrize("part", ["twist", "dtwist"])
def test_a_way_whose_motion_is_no_number_is_refused(part, word):
    motion = np.where(np.arange(6) == word, np.nan, 0.0)
    assert admission(**ROOMY).on_the_way(PoseSample(P, R, STILL, STILL)) == 0
    assert admission(**ROOMY).on_the_way(PoseSample(P, R, STILL, STILL)._replace(**{part: motion})) != 0


@pytest.mark.parametrize("word", range(6))
def test_the_force_at_a_pose_leaves_room_for_the_largest_acceleration_of_each_axis_either_way(word):
    model, ddchi = Model(PLATFORM), 3.0 * np.eye(6)[word]
    rest = model.inverse_dynamics(P, R, STILL, STILL)
    most = max(np.abs(model.inverse_dynamics(P, R, STILL, way * ddchi)).max() for way in (1.0, -1.0))
    assert most > 1.05 * np.abs(rest).max()
    chi = np.array([*P, 0.0, 0.0, 0.0])
    assert admission(ddchi, **ROOMY | {"force_N": most * (1 + 1e-9)})(chi) == 0
    assert admission(ddchi, **ROOMY | {"force_N": most * (1 - 1e-9)})(chi) == Refusal.FORCE


def test_a_pose_and_a_way_may_take_as_much_force_as_the_limit_to_the_last_bit():
    most = float(np.abs(Model(PLATFORM).inverse_dynamics(P, R, STILL, STILL)).max())
    chi, there = np.array([*P, 0.0, 0.0, 0.0]), PoseSample(P, R, STILL, STILL)
    for limit, expected in ((most, 0), (np.nextafter(most, 0.0), Refusal.FORCE)):
        judge = admission(**ROOMY | {"force_N": limit})
        assert judge(chi) == expected
        assert judge.on_the_way(there) == expected


def test_a_jog_may_change_a_force_by_as_much_as_the_window_to_the_last_bit_and_at_rest_by_nothing():
    there = PoseSample(P, R, np.array([0.2, -0.1, 0.1, 0.3, 0.2, -0.3]), STILL)
    said = admission().change_N(there, 0.5)
    assert said > 1.0
    assert not admission(force_window_N=said).too_sudden(there, 0.5)
    assert admission(force_window_N=np.nextafter(said, 0.0)).too_sudden(there, 0.5)
    assert admission().change_N(there, 0.0) == 0.0


def test_a_way_may_lead_to_its_soft_ends_to_the_last_bit():
    q = leg_lengths(PLATFORM, P, R)
    there = PoseSample(P, R, STILL, STILL)
    for low, high, expected in (
        (q.min(), q.max(), 0),
        (np.nextafter(q.min(), 9.0), q.max(), Refusal.STROKE),
        (q.min(), np.nextafter(q.max(), 0.0), Refusal.STROKE),
    ):
        assert admission(**ROOMY | {"low": low, "high": high}).on_the_way(there) == expected


def test_a_sample_whose_rotation_is_a_view_is_judged_as_its_copy():
    turned = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    copy = PoseSample(P, np.ascontiguousarray(turned.T), np.full(6, 0.1), STILL)
    view = copy._replace(R=turned.T)
    judge = admission(**ROOMY)
    assert judge.on_the_way(view) == judge.on_the_way(copy)
    assert judge.change_N(view, 0.5) == judge.change_N(copy, 0.5)
