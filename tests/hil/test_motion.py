"""Motion along a trajectory: its time, its end, its successor, the path that was left, and the look-ahead."""

from math import isnan
from typing import Any

import numpy as np
import pytest

from drivers.compiled.compiler import INTEGER, REAL, kernel, record
from hil.loop.motion import MOTION, Motion, ticks_left
from hil.loop.motion import ahead as ahead_of
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.move import GeodesicMove
from hil.trajectory.override import OVERRIDE
from hil.trajectory.path import SAMPLE, PoseSample, of_record
from hil.trajectory.piecewise import PiecewisePolynomial
from tests.pose_judges import ANYWHERE

T, LONG = 1e-3, 0.25
"""Period, s; its long value makes whole ticks exact."""
HERE, THERE = np.zeros(3), np.array([0.1, 0.0, 0.0])
EYE = np.eye(3)
AHEAD = 1.8e-3


def next_path():
    """x = 0.1 + 2 t^2 for 1 s: a path that begins with an acceleration of 4 m/s^2."""
    coefficients = np.zeros((1, 6, 6))
    coefficients[0, 0, 0], coefficients[0, 2, 0] = 0.1, 2.0
    return PiecewisePolynomial(np.array([0.0, 1.0]), coefficients)


def move(duration_s=1.0):
    return GeodesicMove(HERE, EYE, THERE, EYE, duration_s)


class Turn:
    """Rotation about z at 0.5 rad/s, for a while or for ever."""

    def __init__(self, duration_s: float | None) -> None:
        self.duration_s = duration_s

    def sample(self, t: float) -> PoseSample:
        c, s = np.cos(0.5 * t), np.sin(0.5 * t)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return PoseSample(HERE, R, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5]), np.zeros(6))


def along(trajectory, tick=0, then=None, period_s=LONG):
    """Motion along a trajectory that began at a tick."""
    motion = Motion(period_s, HERE, EYE, 0.5)
    motion.start(trajectory, tick, then=then)
    return motion


_ticks_left = kernel(record(MOTION), record(OVERRIDE), INTEGER)(ticks_left)
_ahead = kernel(record(MOTION), record(OVERRIDE), INTEGER, REAL, record(SAMPLE))(ahead_of)


def before(motion: Motion, tick: int, path: Any) -> float | None:
    """Time, s, to the start of the next path (negative before it); None if unknown."""
    if motion.then is not path or not motion.override.full:
        return None
    return float(-_ticks_left(motion.record, motion.override.record, tick) * motion.override.record["period"])


def ahead(motion: Motion, tick: int, s: float) -> tuple[PoseSample, float | None]:
    """Sample `s` seconds after a tick, and the time along the next path, None before it."""
    into = np.zeros((), SAMPLE)
    status, along = _ahead(motion.record, motion.override.record, tick, s, into)
    assert status == 0
    return of_record(into), None if isnan(along) else along


# -- its time and its end


def test_trajectory_time_counts_from_the_tick_of_its_start():
    motion = Motion(LONG, THERE, EYE, 0.5)
    assert (motion.tick, motion.time(0), motion.time(3)) == (0, 0.0, 0.75)
    assert motion.left is None
    np.testing.assert_array_equal(motion.sample(7).p, THERE)
    assert not motion.sample(7).twist.any()
    motion.start(next_path(), 5)
    assert (motion.tick, motion.time(5), motion.time(7)) == (5, 0.0, 0.5)
    for a, b in zip(motion.sample(7), motion.trajectory.sample(0.5), strict=True):
        assert a.tobytes() == b.tobytes(), "the sample at full speed must be that of the path itself"
    motion.rest(THERE, EYE, 9)
    assert (motion.tick, motion.time(9)) == (9, 0.0)
    motion.leave(move(), 11)
    assert motion.tick == 11


@pytest.mark.parametrize("patience_s", [0.0, 0.5])
def test_a_motion_is_overdue_only_after_the_waiting_time(patience_s):
    waits = round(patience_s / LONG)
    motion = along(Turn(1.0))
    assert [motion.overdue(4 + waits + k, patience_s) for k in (0, 1)] == [False, True]
    motion.settle(4, 0.0)
    motion.stop(8, 0.5)
    assert [motion.overdue(8 + waits + k, patience_s) for k in (0, 1)] == [False, True]


@pytest.mark.parametrize("stops", [0, 1, 50])
def test_a_stop_at_rest_is_finished_exactly_at_its_own_tick(stops):
    motion = along(Turn(None), period_s=T)
    motion.settle(0, 0.0)
    assert not motion.finished(stops)
    motion.stop(stops, 0.5)
    assert [motion.finished(tick) for tick in (stops - 1, stops, stops + 1)] == [False, True, True]
    assert not motion.overdue(stops + 99, 0.1)
    assert motion.overdue(stops + 101, 0.1)


# -- a new one forgets the one before


def test_new_trajectory_discards_the_successor_of_the_previous_trajectory():
    path = next_path()
    motion = along(move(), then=path)
    assert before(motion, 1, path) == -0.75
    assert before(motion, 1, next_path()) is None, "another path is not the next one"
    motion.start(move(), 2)
    assert before(motion, 3, path) is None
    assert ahead(motion, 5, 1.0)[1] is None


@pytest.mark.parametrize(
    "change",
    [
        lambda motion: motion.start(Turn(None), 4),
        lambda motion: motion.rest(HERE, EYE, 4),
        lambda motion: motion.stop(4, 0.5),
    ],
    ids=["start", "rest", "stop"],
)
def test_new_trajectory_discards_the_path_that_was_interrupted_by_a_move(change):
    motion = along(next_path())
    motion.leave(move(), 3)
    assert motion.away
    change(motion)
    assert not motion.away
    assert motion.left is None


def test_path_interrupted_twice_is_resumed_where_it_was_first_interrupted():
    path = next_path()
    motion = along(path, 1)
    motion.leave(move(), 3)
    assert motion.resting, "where the jog begins, nothing moves"
    motion.leave(Turn(None), 8)
    sample, s = motion.left
    assert s == 0.5
    np.testing.assert_array_equal(sample.p, path.sample(0.5).p)
    assert not np.concatenate([sample.twist, sample.dtwist]).any()
    motion.resume(12)
    assert motion.trajectory is path
    assert (motion.resting, motion.away) == (True, False)
    assert [motion.time(tick) for tick in (12, 20)] == [0.5, 0.5]


# -- the look ahead


@pytest.mark.parametrize("duration", [0.5, 0.4996, 0.50000000001])
def test_predicted_reference_continues_across_the_end_of_the_approach(duration):
    motion = along(move(duration), 100, next_path(), T)
    begins = next(tick for tick in range(100, 1000) if motion.finished(tick))
    seen = {tick: ahead(motion, tick, AHEAD) for tick in range(begins - 4, begins)}
    for tick, (sample, s) in seen.items():
        t = (tick - begins) * T + AHEAD
        if t < 0:
            assert s is None
            assert sample.p[0] == pytest.approx(0.1, abs=1e-6)
        else:
            assert s == pytest.approx(t, abs=1e-12)
            assert sample.p[0] == pytest.approx(0.1 + 2 * t * t, abs=1e-12)
            assert sample.dtwist[0] == pytest.approx(4.0)
    motion.start(next_path(), begins)
    first, s = ahead(motion, begins, AHEAD)
    assert s is None
    assert first.p[0] - seen[begins - 1][0].p[0] == pytest.approx(2 * (AHEAD**2 - (AHEAD - T) ** 2))


def test_a_hold_on_the_approach_delays_the_next_path():
    """Held at 0.1 s for half a second; later at full speed the next path begins at the end of the
    approach.
    """
    motion, path = Motion(T, HERE, EYE, 0.2), next_path()
    motion.start(move(), 0, then=path)
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


def test_time_to_the_next_path_is_zero_from_its_start_and_unknown_at_reduced_speed():
    path = next_path()
    motion = along(move(), then=path)
    assert [before(motion, tick, path) for tick in (0, 3, 4, 5, 9)] == [-1.0, -0.25, 0.0, 0.0, 0.0]
    sample, s = ahead(motion, 2, 0.5)
    assert (s, sample.dtwist[0]) == (0.0, 4.0), "its first sample in the very tick at which it begins"
    assert ahead(motion, 2, 0.4375)[1] is None
    motion.settle(2, 0.5)
    assert before(motion, 3, path) is None
    assert ahead(motion, 3, 1.0)[1] is None


# -- a live one, whose speed is its own


def lives():
    live = LiveTrajectory(
        np.array([0.1, 0.2, 1.0, 0.0, 0.0, 0.0]), np.repeat([[0.3], [1.0], [10.0]], 6, 1), T
    )
    motion = Motion(T, HERE, EYE, 0.5)
    motion.settle(0, 0.2)
    motion.start(live, 0)
    assert motion.override.full, "whatever the speed before"
    live.aim(np.array([2.1, 0.2, 1.0, 0.0, 0.0, 0.0]))
    return motion, live


def goes(live, first, last):
    for tick in range(first, last):
        live.advance(tick, ANYWHERE)
    return live.sample(0.0).twist[0]


def test_a_live_trajectory_obeys_the_operators_speed_and_hold():
    motion, live = lives()
    motion.aim(0, 0.5, go=True)
    assert goes(live, 1, 500) == pytest.approx(0.15)
    assert not motion.resting
    motion.settle(500, 0.0)
    motion.aim(500, 0.5, go=False)
    assert goes(live, 500, 501) > 0.1
    assert goes(live, 501, 1100) == 0.0
    assert motion.resting
    assert motion.override.full, "the path's own speed stays"
    rests = live.sample(0.0).p.copy()
    motion.aim(1100, 1.0, go=True)
    goes(live, 1100, 1300)
    np.testing.assert_array_equal(live.sample(0.0).p, rests, err_msg="there is no set-point since")
