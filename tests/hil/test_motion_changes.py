"""What a change of trajectory keeps and forgets, the path that is left and resumed, and a live one in motion."""

import numpy as np
import pytest

from hil.loop.motion import Motion
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.move import GeodesicMove
from tests.hil.motions import ahead, before
from tests.hil.test_motion import EYE, HERE, THERE, Turn, next_path
from tests.judged import ANYWHERE

T = 0.25
"""s: with this period whole ticks are exact."""
CHI = np.array([0.1, 0.2, 1.0, 0.0, 0.0, 0.0])
LIMITS = np.array([[0.3] * 6, [1.0] * 6, [10.0] * 6])


def there():
    return GeodesicMove(HERE, EYE, THERE, EYE, 1.0)


def along(trajectory=None, tick=0):
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(trajectory or next_path(), tick)
    return motion


def test_a_motion_is_made_at_rest_at_its_pose_at_tick_zero():
    motion = Motion(T, THERE, EYE, 0.5)
    assert (motion.tick, motion.time(0), motion.time(3)) == (0, 0.0, 0.75)
    assert not motion.away
    assert motion.left is None
    np.testing.assert_array_equal(motion.sample(7).p, THERE)
    assert not motion.sample(7).twist.any()


def test_a_trajectory_counts_from_the_tick_at_which_it_begins():
    motion = along(tick=5)
    assert motion.tick == 5
    assert [motion.time(tick) for tick in (5, 7)] == [0.0, 0.5]
    motion.rest(THERE, EYE, 9)
    assert (motion.tick, motion.time(9)) == (9, 0.0)
    motion.leave(there(), 11)
    assert motion.tick == 11


def test_at_full_speed_the_sample_is_the_trajectory_s_own():
    motion = along(HoldTrajectory(HERE, EYE))
    for a, b in zip(motion.sample(3), motion.trajectory.sample(0.75), strict=True):
        assert a.tobytes() == b.tobytes()


def test_a_new_trajectory_has_not_stopped_where_the_one_before_it_did():
    motion = along(Turn(None))
    motion.settle(1, 0.0)
    motion.stop(2, 0.5)
    assert motion.finished(2)
    motion.start(Turn(1.0), 3)
    motion.settle(3, 1.0)
    assert [motion.finished(tick) for tick in (3, 6, 7)] == [False, False, True]


def test_a_new_trajectory_is_not_followed_by_what_was_to_follow_the_one_before():
    path, motion = next_path(), Motion(T, HERE, EYE, 0.5)
    motion.start(there(), 0, then=path)
    assert before(motion, 1, path) == -0.75
    assert before(motion, 1, next_path()) is None, "another one"
    motion.start(there(), 2)
    assert before(motion, 3, path) is None
    assert ahead(motion, 5, 1.0)[1] is None


def test_a_new_trajectory_resumes_no_path_that_the_one_before_had_left():
    for change in (
        lambda motion: motion.start(Turn(None), 4),
        lambda motion: motion.rest(HERE, EYE, 4),
        lambda motion: motion.stop(4, 0.5),
    ):
        motion = along()
        motion.leave(there(), 3)
        assert motion.away
        change(motion)
        assert not motion.away
        assert motion.left is None


def test_a_path_that_is_left_twice_is_resumed_at_rest_where_it_was_left_first():
    path = next_path()
    motion = along(path, 1)
    motion.leave(there(), 3)
    assert motion.resting, "where the jog begins, nothing moves"
    motion.leave(Turn(None), 8)
    sample, s = motion.left
    assert s == 0.5
    np.testing.assert_array_equal(sample.p, path.sample(0.5).p)
    assert sample.twist.shape == sample.dtwist.shape == (6,)
    assert not sample.twist.any()
    assert not sample.dtwist.any()
    assert motion.away or not motion.override.full
    motion.resume(12)
    assert motion.trajectory is path
    assert motion.resting
    assert not motion.away
    assert [motion.time(tick) for tick in (12, 20)] == [0.5, 0.5]


def test_away_from_its_path_a_motion_is_on_no_clock_at_full_speed_either():
    motion = along()
    assert motion.override.full
    assert not motion.away
    motion.leave(there(), 3)
    motion.settle(3, 1.0)
    assert motion.override.full
    assert motion.away or not motion.override.full


def test_the_time_before_the_next_trajectory_is_zero_from_the_end_on_and_unknown_below_full_speed():
    path, motion = next_path(), Motion(T, HERE, EYE, 0.5)
    motion.start(there(), 0, then=path)
    assert [before(motion, tick, path) for tick in (0, 3, 4, 5, 9)] == [-1.0, -0.25, 0.0, 0.0, 0.0]
    motion.settle(2, 0.5)
    assert before(motion, 3, path) is None
    assert ahead(motion, 3, 1.0)[1] is None


def test_the_look_ahead_to_the_very_tick_at_which_the_next_one_begins_is_its_first_sample():
    motion = Motion(T, HERE, EYE, 0.5)
    motion.start(there(), 0, then=next_path())
    sample, s = ahead(motion, 2, 0.5)
    assert s == 0.0
    assert sample.dtwist[0] == 4.0
    assert ahead(motion, 2, 0.4375)[1] is None


@pytest.mark.parametrize("patience_s", [0.0, 0.5])
def test_a_motion_that_ended_just_as_long_ago_as_it_is_waited_for_is_not_overdue(patience_s):
    waits = round(patience_s / T)
    motion = along(Turn(1.0))
    assert [motion.overdue(4 + waits + k, patience_s) for k in (0, 1)] == [False, True]
    motion.settle(4, 0.0)
    motion.stop(8, 0.5)
    assert [motion.overdue(8 + waits + k, patience_s) for k in (0, 1)] == [False, True]


def test_a_stop_at_less_than_full_speed_has_ended_at_the_tick_of_rest_and_stays_ended():
    motion = Motion(1e-3, HERE, EYE, 0.5)
    motion.start(Turn(None), 0)
    motion.settle(0, 0.5)
    motion.stop(10, 0.5)
    rests = None
    for tick in range(11, 600):
        motion.advance(tick)
        assert motion.finished(tick) == motion.resting
        if rests is None and motion.resting:
            rests = tick
    assert rests is not None
    assert not motion.overdue(rests + 100, 0.1)
    assert motion.overdue(rests + 101, 0.1)


def test_the_time_at_rest_that_is_foretold_is_the_one_that_braking_leads_to():
    motion, later = along(Turn(None)), along(Turn(None))
    for each in (motion, later):
        each.settle(0, 0.5)
    foretold = motion.override.rests_at(4, 0.75)
    later.aim(4, 0.75, go=True)
    later.advance(5)
    later.aim(5, 0.75, go=False)
    later.advance(50)
    assert later.resting
    assert later.time(50) == pytest.approx(foretold, abs=1e-12)
    assert foretold > motion.time(4)


def lives():
    live = LiveTrajectory(CHI, LIMITS, 1e-3)
    motion = Motion(1e-3, HERE, EYE, 0.5)
    motion.start(live, 0)
    live.aim(CHI + np.array([2.0, 0, 0, 0, 0, 0]))
    return motion, live


def goes(live, first, last):
    for tick in range(first, last):
        live.advance(tick, ANYWHERE)
    return live.sample(0.0).twist[0]


def test_a_live_trajectory_takes_the_share_of_its_speed_and_a_hold_from_the_operator():
    motion, live = lives()
    motion.aim(0, 0.5, go=True)
    assert goes(live, 1, 500) == pytest.approx(0.15)
    assert not motion.resting
    assert motion.override.full, "the path's own speed stays"
    motion.settle(500, 0.0)
    motion.aim(500, 0.5, go=False)
    assert goes(live, 500, 501) > 0.1
    assert goes(live, 501, 1100) == 0.0
    assert motion.resting
    assert motion.override.full


@pytest.mark.parametrize("speed", [1.0, 0.0])
def test_on_hold_a_live_trajectory_gives_up_its_target_whatever_the_speed_that_is_asked_for(speed):
    motion, live = lives()
    goes(live, 1, 500)
    motion.aim(500, speed, go=False)
    goes(live, 500, 1100)
    assert motion.resting
    rests = live.sample(0.0).p.copy()
    motion.aim(1100, 1.0, go=True)
    goes(live, 1100, 1300)
    np.testing.assert_array_equal(live.sample(0.0).p, rests, err_msg="there is no set-point since")


def test_a_live_trajectory_is_stopped_by_its_own_brake():
    motion, live = lives()
    goes(live, 1, 500)
    assert not motion.finished(10**6)
    motion.stop(500, 5.0)
    assert motion.trajectory is live
    ends = round(live.duration_s / 1e-3)
    assert 500 < ends < 1200
    goes(live, 500, ends + 1)
    assert [motion.finished(tick) for tick in (ends - 1, ends + 1)] == [False, True]
    assert motion.resting


@pytest.mark.parametrize("left", [1, 7, 4000])
def test_the_end_of_the_approach_is_found_in_a_few_steps_however_far_it_is(left):
    asked = []

    class Asked(Motion):
        def time(self, tick):
            asked.append(tick)
            return super().time(tick)

    motion, path = Asked(T, HERE, EYE, 0.5), next_path()
    motion.start(GeodesicMove(HERE, EYE, THERE, EYE, 1000.0), 0, then=path)
    assert before(motion, 4000 - left, path) == -left * T
    assert len(asked) <= 3


@pytest.mark.parametrize("sigma", [0.25, 0.5])
def test_below_full_speed_the_look_ahead_is_where_the_platform_will_be_at_that_speed(sigma):
    motion = along(GeodesicMove(HERE, EYE, THERE, EYE, 60.0))
    motion.settle(4, sigma)
    for ticks in (1, 2, 4):
        seen, then = ahead(motion, 6, ticks * T)
        there = motion.sample(6 + ticks)
        assert then is None
        assert not np.array_equal(seen.p, motion.sample(6).p)
        for one, other in zip(seen, there, strict=True):
            np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)
