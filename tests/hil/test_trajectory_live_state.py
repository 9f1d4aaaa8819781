"""What a live trajectory keeps and forgets: a reset, its share of speed, a halt, and the instants that are judged."""

import numpy as np
import pytest

from hil.trajectory.live import LiveTrajectory, first_stage
from tests.hil.test_trajectory_live import LIMITS, PERIOD, START, UNLIKE, A, J, V, live, off
from tests.judged import ANYWHERE
from tests.judged import judged as by_address

WINDOW = round(2 * A / J / PERIOD)
FAR = off(2.0, -1.0, 1.5, 0.4, 0, 0.3)


def goes(trajectory, first, last, admit=ANYWHERE):
    for k in range(first, last):
        trajectory.advance(k, admit)
    return trajectory.sample(0.0)


def test_a_reset_leaves_nothing_of_what_was():
    for end in (LiveTrajectory.halt, LiveTrajectory.brake):
        trajectory, fresh = live(UNLIKE), live(UNLIKE)
        trajectory.aim(FAR)
        trajectory.limit(0.5)
        goes(trajectory, 1, 300)
        end(trajectory)
        goes(trajectory, 300, 400)
        trajectory.reset()
        for name in set(trajectory._live.dtype.names) - {"history"}:
            np.testing.assert_equal(trajectory._live[name], fresh._live[name], err_msg=name)
        np.testing.assert_array_equal(trajectory._history, fresh._history)
        assert trajectory.duration_s is None
        assert trajectory.resting
        np.testing.assert_array_equal(goes(trajectory, 1, 3).p, START[:3])


def test_the_history_before_the_beginning_is_rest_at_the_start():
    """Braking in the first ticks is judged with it."""
    start = np.array([0.3, -0.2, 1.0, 0.1, -0.1, 0.05])
    trajectory, judged = live(start=start), []
    trajectory.aim(start + 0.1)

    @by_address
    def look(chi):
        judged.append(chi)
        return 0

    goes(trajectory, 1, 4, look)
    assert judged
    away = (np.array(judged) - start) / PERIOD**2
    assert away.min() >= -1e-6
    assert away.max() < 20.0, "some ticks of the acceleration of 1 m/s^2"


@pytest.mark.parametrize("word", range(6))
def test_each_word_has_its_own_velocity_acceleration_and_window(word):
    trajectory = live(UNLIKE)
    trajectory.aim(START + 10.0 * np.eye(6)[word])
    v, a, j = UNLIKE[:, word]
    x = trajectory._history
    assert trajectory._live["window"][word] == np.ceil(round(2 * a / j / PERIOD, 6))
    goes(trajectory, 1, 11)
    k = 10 % len(x)
    np.testing.assert_allclose(x[k, 1, word], 10 * PERIOD * a, rtol=1e-12)
    np.testing.assert_allclose(x[k, 0, word] - START[word], 0.5 * a * (10 * PERIOD) ** 2, rtol=1e-9)
    trajectory._history[:, 1, word] = v
    goes(trajectory, 11, 12)
    np.testing.assert_allclose(x[11 % len(x), 1, word], v, rtol=1e-12)


@pytest.mark.parametrize(("rate_Hz", "A", "J", "ticks"), [
    (1000.0, 1.0, 10.0, 200), (1000.0, 1.0 + 2.5e-9, 10.0, 201), (1000.0, 1.0 + 7.5e-12, 10.0, 201),
    (8000.0, 1.393, 0.7, 31_840), (1000.0, 1.0, 1e5, 1), (1000.0, 1.0, 1e13, 1),
])  # fmt: skip
def test_a_window_is_of_the_fewest_whole_ticks_that_keep_the_jerk_and_of_one_at_least(rate_Hz, A, J, ticks):
    """2 A / J: 0.7 m/s^3 after 1.393 m/s^2 are 3.98 s, by numbers as they are rounded 31840.000000000004 ticks."""
    trajectory = live(np.array([[V] * 6, [A] * 6, [J] * 6]), period=1.0 / rate_Hz)
    np.testing.assert_array_equal(trajectory._live["window"], [ticks] * 6)


@pytest.mark.parametrize("word", range(6))
@pytest.mark.parametrize("part", ["twist", "dtwist"])
def test_a_platform_of_which_one_word_moves_or_begins_to_move_does_not_rest(part, word):
    trajectory = live()
    trajectory.halt()
    assert trajectory.resting
    trajectory._live[part] = np.eye(6)[word]
    assert not trajectory.resting


def test_a_halt_is_at_the_place_of_rest_and_another_target_ends_it():
    trajectory = live()
    trajectory.aim(FAR)
    goes(trajectory, 1, 500)
    assert not trajectory.resting
    trajectory.halt()
    assert not trajectory.resting, "it still comes to rest"
    rest = trajectory._live["rest"].copy()
    sample = goes(trajectory, 500, 500 + round(V / A / PERIOD) + WINDOW + 2)
    assert trajectory.resting
    np.testing.assert_allclose(sample.p, rest[:3], rtol=0, atol=1e-12)
    trajectory.aim(FAR)
    assert not trajectory.resting


def test_at_rest_at_a_target_that_is_no_place_of_rest_it_is_ready_to_go_on():
    trajectory = live()
    trajectory.aim(START)
    goes(trajectory, 1, 10)
    assert not trajectory.resting
    trajectory.halt()
    assert trajectory.resting


@pytest.mark.parametrize("share", [0.25, 0.5, 0.255])
def test_a_share_of_the_speed_is_braked_to_within_the_acceleration_and_counts_for_no_way_to_rest(share):
    trajectory = live()
    trajectory.aim(FAR)
    goes(trajectory, 1, 500)
    trajectory.limit(share)
    v, rows = [], trajectory._history
    for k in range(500, 900):
        trajectory.advance(k, ANYWHERE)
        v.append(rows[k % len(rows), 1, 0])
    assert v[0] == pytest.approx(V - A * PERIOD)
    assert np.diff(v).min() >= -A * PERIOD * (1 + 1e-9)
    assert v[-1] == share * V
    trajectory.limit(0.0)
    trajectory.halt()
    trajectory.advance(900, ANYWHERE)
    ticks = np.ceil(share * V / (A * PERIOD))
    assert rows[900 % len(rows), 1, 0] == pytest.approx(share * V * (ticks - 1) / ticks, rel=1e-9)


def test_a_brake_ends_as_many_ticks_later_as_the_fastest_word_and_the_longest_window_take():
    for way in (1.0, -1.0):
        trajectory = live(UNLIKE)
        trajectory.aim(START + way * np.array([0, 0, 0, 0, 5.0, 0]))
        goes(trajectory, 1, 101)
        trajectory.brake()
        longest = round((2 * UNLIKE[1] / UNLIKE[2] / PERIOD).max())
        assert trajectory.duration_s == pytest.approx((100 + 100 + 1 + longest + 1) * PERIOD)


def test_the_way_to_rest_is_judged_from_its_end_on_and_the_first_that_is_found_is_told():
    trajectory, judged = live(), []
    trajectory.aim(FAR)

    @by_address
    def look(chi):
        judged.append(chi[0])
        return len(judged) if len(judged) >= 3 else 0

    goes(trajectory, 1, 300)
    assert trajectory.advance(300, look) == 3
    assert len(judged) == 3
    assert judged == sorted(judged, reverse=True)
    assert trajectory.advance(301, look) == 0, "on the way that was good before it is not judged again"
    assert len(judged) == 3


@pytest.mark.parametrize(
    ("limits", "ticks", "longest", "marks"),
    [(LIMITS, 2, 202, 5), (LIMITS, 110, 310, 7), (LIMITS, 510, 500, 10), (UNLIKE, 90, 1000, 16)],
)
def test_the_way_to_rest_is_judged_every_50_ms_at_most_16_times_and_last_at_rest(
    limits, ticks, longest, marks
):
    trajectory, judged, way = live(limits), [], np.array([2.0, 0, 0, 0, 0, 0])
    trajectory.aim(START + way)
    goes(trajectory, 1, ticks)

    @by_address
    def look(chi):
        judged.append(chi[0])
        return 0

    trajectory.advance(ticks, look)
    trajectory.brake()
    assert len(judged) == marks
    x = [trajectory.sample(0.0).p[0]]
    for k in range(ticks + 1, ticks + longest + 1):
        trajectory.advance(k, ANYWHERE)
        x.append(trajectory.sample(0.0).p[0])
    instants = [int(np.ceil(longest * (j + 1) / marks)) for j in range(marks)]
    np.testing.assert_allclose(judged[::-1], np.array(x)[instants], rtol=0, atol=1e-13)


def test_a_refused_way_is_left_for_the_rest_that_was_good_a_tick_ago():
    trajectory = live()
    trajectory.aim(FAR)
    goes(trajectory, 1, 300)
    good = trajectory._live["rest"].copy()
    goes(trajectory, 300, 301, by_address(lambda _: 1))
    np.testing.assert_array_equal(trajectory._live["rest"], good)
    sample = goes(trajectory, 301, 1000)
    np.testing.assert_allclose(sample.p, good[:3], rtol=0, atol=1e-12)
    assert trajectory.resting


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("ticks", [1, 2, 6])
def test_a_refused_way_is_told_and_braked_within_the_limits_at_any_share_and_over_skipped_ticks(share, ticks):
    """Only the first of the ticks that are made up for finds anything: after it the way is the one to rest."""
    trajectory = live()
    trajectory.aim(FAR)
    goes(trajectory, 1, 500)
    good, rows = trajectory._live["rest"].copy(), trajectory._history
    trajectory.limit(share)
    assert trajectory.advance(499 + ticks, by_address(lambda _: 5)) == 5
    assert trajectory.advance(500 + ticks, by_address(lambda _: 5)) == 0
    steps = np.diff([rows[k % len(rows), 1, 0] for k in range(499, 501 + ticks)])
    np.testing.assert_allclose(steps, -A * PERIOD, rtol=1e-9)
    np.testing.assert_allclose(goes(trajectory, 501 + ticks, 1300).p, good[:3], rtol=0, atol=1e-12)


def test_where_nothing_moves_nothing_is_judged():
    trajectory, judged = live(), []
    trajectory.aim(START)

    @by_address
    def look(chi):
        judged.append(chi)
        return 0

    goes(trajectory, 1, 10, look)
    assert not judged


def stepped(x, v, target, step):
    return np.array(
        [first_stage(*word, PERIOD) for word in zip(x, v, target, LIMITS[0], step, strict=True)]
    ).T


def test_the_first_stage_steps_by_the_mean_speed_and_tells_where_braking_ends():
    x, v = np.zeros(6), np.array([0.0, 0.1, -0.1, 0.3, 0.1, 0.0])
    target = np.array([1.0, 1.0, -1.0, 1.0, -1.0, 0.0])
    step = A * PERIOD * np.array([1.0, 2.0, 1.0, 1.0, 4.0, 1.0])
    x1, v1, rest = stepped(x, v, target, step)
    np.testing.assert_allclose(v1, [1e-3, 0.102, -0.101, 0.3, 0.096, 0.0], rtol=1e-12)
    np.testing.assert_allclose(x1, 0.5 * PERIOD * (v + v1), rtol=1e-12)
    ticks = np.array([1, 51, 101, 300, 24, 0])
    np.testing.assert_allclose(rest, x1 + 0.5 * PERIOD * v1 * ticks, rtol=1e-12)


@pytest.mark.parametrize("off_m", [3e-13, -3e-13, 0.0])
def test_each_word_that_comes_to_rest_within_rounding_of_its_target_is_put_on_it_to_the_bit(off_m):
    x = np.array([0.1, -0.2, 1.0, 0.01, -0.03, 0.05])
    v = np.array([4e-4, -3e-4, 2e-4, -1e-4, 5e-4, 6e-4])
    target = x + 0.5 * PERIOD * v + off_m
    x1, v1, rest = stepped(x, v, target, np.full(6, A * PERIOD))
    assert not v1.any()
    assert x1.tobytes() == target.tobytes()
    assert rest.tobytes() == target.tobytes()
