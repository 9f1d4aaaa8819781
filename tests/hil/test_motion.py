"""The present trajectory, and the look ahead across its end."""

import numpy as np
import pytest

from hil.loop.motion import Motion
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import PoseSample
from hil.trajectory.piecewise import PiecewisePolynomial
from tests.hil.motions import ahead, before

T = 1e-3
HERE, THERE = np.zeros(3), np.array([0.1, 0.0, 0.0])
EYE = np.eye(3)
AHEAD = 1.8e-3


def next_path():
    """x = 0.1 + 2 t^2 for 1 s: it begins with an acceleration of 4 m/s^2."""
    coefficients = np.zeros((1, 6, 6))
    coefficients[0, 0, 0], coefficients[0, 2, 0] = 0.1, 2.0
    return PiecewisePolynomial(np.array([0.0, 1.0]), coefficients)


@pytest.mark.parametrize("duration", [0.5, 0.4996, 0.50000000001, 0.3 * T / T])
def test_the_look_ahead_crosses_the_end_of_the_approach(duration):
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(GeodesicMove(HERE, EYE, THERE, EYE, duration), 100, then=next_path())
    begins = next(tick for tick in range(100, 1000) if motion.finished(tick))
    seen = {tick: ahead(motion, tick, AHEAD) for tick in range(begins - 4, begins)}
    for tick, (sample, along) in seen.items():
        t = (tick - begins) * T + AHEAD
        if t < 0:
            assert along is None
            assert sample.p[0] == pytest.approx(0.1, abs=1e-6)
        else:
            assert along == pytest.approx(t, abs=1e-12)
            assert sample.p[0] == pytest.approx(0.1 + 2 * t * t, abs=1e-12)
            assert sample.dtwist[0] == pytest.approx(4.0)
    motion.start(next_path(), begins)
    first, along = ahead(motion, begins, AHEAD)
    assert along is None
    assert first.p[0] - seen[begins - 1][0].p[0] == pytest.approx(2 * (AHEAD**2 - (AHEAD - T) ** 2))


def test_a_late_start_is_waited_for_at_the_end_of_the_approach():
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(GeodesicMove(HERE, EYE, THERE, EYE, 0.5), 0, then=next_path())
    for tick in range(500, 520):
        sample, along = ahead(motion, tick, AHEAD)
        assert along is None
        np.testing.assert_allclose(sample.p, THERE)
        assert not sample.dtwist.any()


def test_a_hold_on_the_approach_puts_off_what_comes_next():
    """Held at 0.1 s for half a second; at full speed again the next path begins where the approach ends."""
    motion, path = Motion(T, HERE, EYE, 0.2), next_path()
    motion.start(GeodesicMove(HERE, EYE, THERE, EYE, 1.0), 0, then=path)
    seen, tick = {}, 0
    while not motion.finished(tick):
        tick += 1
        motion.advance(tick)
        motion.aim(tick, 1.0, go=not 100 <= tick < 600)
        seen[tick] = before(motion, tick, path), ahead(motion, tick, AHEAD)[1]
    begins = max(seen)
    assert begins >= 1500, "held for half a second"
    full = [tick for tick in seen if tick < 100 or tick > 850]
    assert all(seen[tick][0] is not None for tick in full)
    after = [tick for tick in full if tick > 850]
    assert [seen[tick][0] for tick in after] == pytest.approx([(tick - begins) * T for tick in after])
    assert all(seen[tick][1] is None for tick in full if tick < begins - 1)
    assert seen[begins - 1][1] == pytest.approx(AHEAD - T)


def test_the_look_ahead_of_a_stop_is_the_stop():
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(GeodesicMove(HERE, EYE, THERE, EYE, 0.5), 0, then=next_path())
    before = ahead(motion, 250, AHEAD)[0]
    motion.stop(250, 0.5)
    after = ahead(motion, 250, AHEAD)[0]
    np.testing.assert_allclose(after.p, before.p, atol=1e-7)
    np.testing.assert_allclose(after.twist, before.twist, atol=1e-4)
    assert ahead(motion, 499, AHEAD)[0].p[0] < 0.1, "the next trajectory is off"


def test_after_a_stop_on_the_approach_nothing_comes_next():
    motion, path = Motion(T, HERE, EYE, 0.5), next_path()
    motion.start(GeodesicMove(HERE, EYE, THERE, EYE, 0.5), 0, then=path)
    motion.stop(480, 0.01)
    stands = motion.trajectory.sample(1.0).p
    for tick in range(480, 500):
        assert before(motion, tick, path) is None
        sample, along = ahead(motion, tick, 0.05)
        assert along is None
        np.testing.assert_allclose(sample.p, stands, atol=1e-12)


def test_the_look_ahead_past_the_last_end_is_rest():
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(next_path(), 0)
    sample, along = ahead(motion, 999, AHEAD)
    assert along is None
    assert sample.p[0] == pytest.approx(2.1)
    assert not sample.twist.any()
    motion.start(HoldTrajectory(THERE, EYE), 10)
    np.testing.assert_allclose(ahead(motion, 10, AHEAD)[0].p, THERE)


class Turn:
    """About z at 0.5 rad/s, for a while or for ever."""

    def __init__(self, duration_s: float | None) -> None:
        self.duration_s = duration_s

    def sample(self, t: float) -> PoseSample:
        c, s = np.cos(0.5 * t), np.sin(0.5 * t)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return PoseSample(HERE, R, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5]), np.zeros(6))


@pytest.mark.parametrize("begins", [0, 300])
@pytest.mark.parametrize("patience_s", [0.0, 0.25])
def test_a_motion_is_overdue_once_it_has_ended_longer_ago_than_it_is_waited_for(begins, patience_s):
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(Turn(1.0), begins)
    ends = begins + 1000
    last = ends + round(patience_s / T)
    assert [motion.finished(tick) for tick in (begins, ends - 1, ends, last + 900)] == [
        False,
        False,
        True,
        True,
    ]
    assert not any(motion.overdue(tick, patience_s) for tick in (begins, ends - 1, last - 1))
    assert all(motion.overdue(tick, patience_s) for tick in (last + 1, last + 900))


@pytest.mark.parametrize("trajectory", [Turn(None), HoldTrajectory(HERE, EYE)], ids=["turn", "hold"])
def test_a_motion_without_an_end_is_never_finished_nor_overdue(trajectory):
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(trajectory, 0)
    assert not any(motion.finished(tick) or motion.overdue(tick, 0.0) for tick in (0, 1, 10_000))


@pytest.mark.parametrize("begins", [0, 300])
def test_a_stop_of_a_motion_that_is_held_is_overdue_from_the_tick_of_the_stop_on(begins):
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(Turn(None), begins)
    motion.settle(begins + 100, 0.0)
    motion.stop(begins + 200, 0.5)
    assert not motion.overdue(begins + 299, 0.1)
    assert motion.overdue(begins + 301, 0.1)


@pytest.mark.parametrize("stops", [0, 1, 50])
def test_a_stop_at_rest_is_finished_in_its_tick_and_not_before(stops):
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(Turn(None), 0)
    motion.settle(0, 0.0)
    assert not motion.finished(stops)
    motion.stop(stops, 0.5)
    assert [motion.finished(tick) for tick in (stops - 1, stops, stops + 1)] == [False, True, True]
