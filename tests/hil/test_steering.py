"""Steering: which set-points are taken and refused, and what is counted."""

import numpy as np
import pytest

from drivers.signals import Refusal
from hil.loop.admission import Counts, Steering
from hil.signals import SetPoint, explain
from hil.trajectory.live import LiveTrajectory
from tests.judged import judged

START = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
LIMITS = np.array([[0.3] * 6, [1.0] * 6, [10.0] * 6])


def admission(chi):
    """A world that ends at x = 0.2 and has a wall between y = 0.05 and 0.06."""
    return (Refusal.STROKE if abs(chi[0]) > 0.2 else 0) | (Refusal.FORCE if 0.05 < chi[1] < 0.06 else 0)


@pytest.fixture
def steering():
    return Steering(LiveTrajectory(START, LIMITS, 1e-3), admission, judged(admission))


def at(x=0.0, y=0.0):
    return SetPoint(x, y, 1.0, 0.0, 0.0, 0.0)


def move(steering, points, tick, *, tracking=True):
    """Take set-points, and go to a tick of the trajectory, as the cycle does."""
    steering.take(points, tracking=tracking)
    against = 0 if tick is None else steering.trajectory.advance(tick, steering.judge)
    if against:
        steering.stopped(against)


def go(steering, first, last):
    for tick in range(first, last):
        move(steering, (), tick)
    return steering.trajectory.sample(0.0).p


def test_a_good_set_point_is_taken_and_reached(steering):
    move(steering, (at(0.1),), 1)
    assert steering.counts == Counts(1, 0, 0)
    assert steering.answers == [0]
    np.testing.assert_allclose(go(steering, 2, 2000), [0.1, 0, 1], rtol=0, atol=1e-14)
    assert steering.answers == []


def test_a_bad_set_point_is_refused_and_the_good_one_before_it_stays(steering):
    move(steering, (at(0.1),), 1)
    move(steering, (at(0.3),), 2)
    assert steering.counts == Counts(1, 1, Refusal.STROKE)
    assert steering.answers == [Refusal.STROKE]
    assert go(steering, 3, 2000)[0] == pytest.approx(0.1, abs=1e-14)
    assert steering.counts == Counts(1, 1, 0), "said once, counted for good"


def test_of_several_in_one_tick_the_last_good_one_is_followed(steering):
    move(steering, (at(0.1), at(-0.1), at(9.0)), 1)
    assert steering.answers == [0, 0, Refusal.STROKE]
    assert steering.counts == Counts(2, 1, Refusal.STROKE)
    assert go(steering, 2, 2000)[0] == pytest.approx(-0.1, abs=1e-14)


def test_set_points_before_or_after_the_tracking_are_refused(steering):
    move(steering, (at(0.1),), None, tracking=False)
    assert steering.answers == [Refusal.NOT_TRACKING]
    steering.trajectory.reset()
    assert go(steering, 1, 500)[0] == 0.0
    assert steering.counts == Counts(0, 1, 0), "a restart forgets the place, not the count"


def test_a_wall_on_the_way_stops_before_it_and_is_counted_once(steering):
    move(steering, (at(0.0, 0.1),), 1)
    refusals = []
    for tick in range(2, 2000):
        move(steering, (), tick)
        refusals.append(steering.counts.refusal)
        assert steering.trajectory.sample(0.0).p[1] <= 0.05
    assert steering.counts == Counts(1, 1, 0)
    assert [r for r in refusals if r] == [Refusal.FORCE | Refusal.ON_THE_WAY]
    assert steering.trajectory.sample(0.0).p[1] > 0.049


def test_a_set_point_and_the_way_refused_in_one_tick_are_both_reported(steering):
    """The platform moves on in a tick with set-points as in one without."""
    move(steering, (at(0.0, 0.04),), 1)
    before = go(steering, 2, 300)[1]
    steering._admission = lambda chi: Refusal.STROKE if abs(chi[0]) > 0.2 else Refusal.FORCE
    steering.judge = judged(steering._admission)
    move(steering, (at(0.3),), 300)
    assert steering.trajectory.sample(0.0).p[1] > before
    assert steering.counts == Counts(1, 2, Refusal.STROKE | Refusal.FORCE | Refusal.ON_THE_WAY)
    assert steering.answers == [Refusal.STROKE]


def test_reset_forgets_all(steering):
    move(steering, (at(0.1), at(9)), 1)
    go(steering, 2, 300)
    steering.reset()
    assert steering.counts == Counts(0, 0, 0)
    assert steering.answers == []
    np.testing.assert_array_equal(steering.trajectory.sample(0.0).p, START[:3])


@pytest.mark.parametrize("refusal", [r for r in Refusal if r is not Refusal.ON_THE_WAY])
def test_every_refusal_has_its_words(refusal):
    assert len(explain(refusal)) > 20
    assert explain(refusal) in explain(refusal | Refusal.ON_THE_WAY)
    assert explain(0) == ""
