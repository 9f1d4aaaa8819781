"""Every safety rule at its limit, on both sides of it.

A test is named after the file of the rule: the mutation test runs those of a file against changed copies of it.
"""

import math

import numpy as np
import pytest

from drivers.signals import NEVER, DriveState
from hil.safety import bus, effort, finite, following, history, kinematics, legs, recorder, stroke, timing

ON_ONE_LEG = pytest.mark.parametrize("leg", range(6))


def six(value, leg=None, other=0.0):
    """Six times `value`, or six `other` with `value` on one leg."""
    x = np.full(6, float(value if leg is None else other))
    if leg is not None:
        x[leg] = value
    return x


def ints(value, leg, other):
    x = np.full(6, int(other))
    x[leg] = int(value)
    return x


# -- finite


@pytest.mark.parametrize("shape", [(6,), (3,), (3, 3), (6, 6)])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_finite_finds_one_bad_number_anywhere(shape, bad):
    x = np.full(shape, -1e300)
    assert finite.all_finite(x)
    for index in np.ndindex(shape):
        y = x.copy()
        y[index] = bad
        assert not finite.all_finite(y)


# -- history


def test_history_counts_the_ones():
    for bits in (0, 1, 2, 3, 4, 0b1011, 1 << 31, (1 << 32) - 1):
        assert history.ones(bits) == bits.bit_count()
    assert history.ones((1 << 40) - 1) == 32


# -- legs


@ON_ONE_LEG
def test_legs_are_stale_from_the_limit_on(leg):
    assert not legs.stale(ints(1, leg, 0), 2)
    assert legs.stale(ints(2, leg, 0), 2)
    assert legs.stale(ints(3, leg, 0), 2)
    assert not legs.stale(ints(4, leg, 0), 5)
    assert legs.stale(ints(5, leg, 0), 5)
    assert legs.stale(ints(NEVER, leg, 0), 5)


@ON_ONE_LEG
def test_legs_in_fault_or_rebooted_are_lost(leg):
    for state in DriveState:
        expected = state in {DriveState.FAULT, DriveState.BOOT}
        assert legs.drive_lost(ints(state, leg, DriveState.RUN)) == expected


@ON_ONE_LEG
def test_legs_run_only_all_together(leg):
    for state in DriveState:
        assert legs.all_running(ints(state, leg, DriveState.RUN)) == (state == DriveState.RUN)
    assert not legs.all_running(ints(DriveState.RUN, leg, DriveState.READY))


# -- bus


def test_bus_remembers_which_ticks_had_refused_frames():
    history = 0
    for failed, expected in ((1, 0b1), (6, 0b11), (0, 0b110), (1, 0b1101)):
        history = bus.refusals(history, failed)
        assert history == expected
    assert bus.refusals(1 << 30, 0) == 1 << 31
    assert bus.refusals(1 << 31, 0) == 0
    assert bus.refusals((1 << 32) - 1, 1) == (1 << 32) - 1


def test_bus_is_down_when_off_or_refusing_in_a_row_or_often():
    assert bus.bus_down(True, 0)
    assert not bus.bus_down(False, 0)
    assert not bus.bus_down(False, 0b1111)
    assert bus.bus_down(False, 0b11111)
    assert bus.bus_down(False, 0b1111111)
    assert not bus.bus_down(False, 0b111101110)
    assert bus.bus_down(False, 0b1111011110)
    assert not bus.bus_down(False, 0b11111 << 3)
    assert not bus.bus_down(False, 0b111110)


def test_bus_is_noisy_with_errors_losses_or_refusals():
    assert not bus.bus_noisy(0, 0, 0)
    assert bus.bus_noisy(1, 0, 0)
    assert bus.bus_noisy(0, 1, 0)
    assert bus.bus_noisy(0, 0, 1)


# -- recorder


def test_recorder_loses_when_dead_or_when_drops_grow():
    assert not recorder.recorder_losing(True, 0, 0)
    assert not recorder.recorder_losing(True, 7, 7)
    assert recorder.recorder_losing(True, 8, 7)
    assert recorder.recorder_losing(False, 0, 0)


def test_recorder_stops_the_run_only_if_so_configured():
    assert recorder.recorder_stop(True, "stop")
    assert not recorder.recorder_stop(False, "stop")
    assert not recorder.recorder_stop(True, "continue")


# -- kinematics


def test_kinematics_faults_above_each_limit_and_on_what_is_no_number():
    assert not kinematics.inconsistent(0.0, 1e-4)
    assert not kinematics.inconsistent(1e-4, 1e-4)
    assert not kinematics.ill_conditioned(50.0, 50.0)
    assert not kinematics.hopped(0.99)
    for bad in (np.nextafter(1e-4, 1), np.inf, np.nan):
        assert kinematics.inconsistent(bad, 1e-4)
    for bad in (50.001, np.inf, np.nan):
        assert kinematics.ill_conditioned(bad, 50.0)
    for bad in (1.0, 1.5, np.inf, np.nan):
        assert kinematics.hopped(bad)


# -- stroke


def test_stroke_cap_is_the_square_root_of_two_a_d_and_never_below_creep():
    assert stroke.speed_cap(1.0, 2.0) == 2.0
    assert stroke.speed_cap(0.25, 8.0) == 2.0
    assert stroke.speed_cap(4.0, 8.0) == 8.0
    for distance in (0.0, -0.5, 1e-9):
        assert stroke.speed_cap(distance, 2.0) == 1e-3


@ON_ONE_LEG
def test_stroke_hard_ends(leg):
    for q, expected in ((1.0, False), (2.0, False), (0.999, True), (2.001, True)):
        assert stroke.beyond_hard_end(six(q, leg, 1.5), 1.0, 2.0) == expected


@ON_ONE_LEG
def test_stroke_speed_towards_a_soft_end_is_capped_and_away_from_it_is_not(leg):
    def fast(q, dq):
        return stroke.too_fast_for_end(six(q, leg, 5.0), six(dq, leg), 2.0, 8.0, 2.0)

    assert not fast(7.0, 2.0)  # 1 m to go at 2 m/s^2: sqrt(2 * 2 * 1) = 2
    assert fast(7.0, 2.001)
    assert not fast(7.0, -4.0)
    assert not fast(3.0, -2.0)
    assert fast(3.0, -2.001)
    assert not fast(3.0, 4.0)
    for beyond, outwards in ((8.1, 1.0), (1.9, -1.0)):
        assert fast(beyond, 0.0011 * outwards)
        assert not fast(beyond, 0.001 * outwards)
        assert not fast(beyond, -1.0 * outwards)
        assert not fast(beyond, 0.0)


@ON_ONE_LEG
def test_stroke_speed_limit_holds_both_ways(leg):
    for dq, expected in ((0.5, False), (-0.5, False), (0.501, True), (-0.501, True)):
        assert stroke.overspeed(six(dq, leg), 0.5) == expected


# -- following


@ON_ONE_LEG
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_following_error_is_allowed_to_grow_with_the_commanded_speed(leg, sign):
    def lags(error, dq_d, per_speed):
        return following.lagging(six(3), 3 + six(sign * error, leg), six(dq_d, leg), 0.25, per_speed)

    assert not lags(0.25, 0.0, 0.0)
    assert lags(0.26, 0.0, 0.0)
    assert lags(0.26, 2.0, 0.0)
    for dq_d in (2.0, -2.0):
        assert not lags(1.25, dq_d, 0.5)
        assert lags(1.26, dq_d, 0.5)


# -- timing


def test_timing_is_late_above_a_fifth_of_the_period():
    assert not timing.is_late(0, 1_000_000)
    assert not timing.is_late(200_000, 1_000_000)
    assert timing.is_late(200_001, 1_000_000)
    assert not timing.is_late(-900_000, 1_000_000)


def test_timing_remembers_32_ticks_and_counts_skipped_ones_as_late():
    history = timing.late_history(0, True, 0)
    assert history == 0b1
    history = timing.late_history(history, False, 2)
    assert history == 0b1110
    assert timing.late_history(history, True, 0) == 0b11101
    for _ in range(28):
        history = timing.late_history(history, False, 0)
    assert history == 0b111 << 29
    assert timing.late_history(history, False, 0) == 0b11 << 30
    assert timing.late_history(0, False, 10**9) == 2**32 - 2
    assert timing.late_history(0, False, 32) == 2**32 - 2
    assert timing.late_history(0, False, 31) == 2**32 - 2
    assert timing.late_history(0, False, 30) == 2**31 - 2


def test_timing_is_degraded_from_eight_late_ticks_on():
    assert not timing.is_degraded(0b1111111 << 20)
    assert timing.is_degraded(0b11111111 << 20)
    assert timing.is_degraded(0x80000001 | 0x7FF0)


def test_timing_adds_skipped_periods_until_a_tick_skips_none():
    run = timing.missed_run(0, 3)
    assert run == 3
    run = timing.missed_run(run, 1)
    assert run == 4
    assert not timing.too_many_missed(run, 5)
    assert timing.too_many_missed(timing.missed_run(run, 1), 5)
    assert timing.too_many_missed(6, 5)
    assert not timing.too_many_missed(6, 7)
    assert timing.missed_run(run, 0) == 0


# -- effort


@ON_ONE_LEG
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_effort_is_clipped_to_the_force_limit(leg, sign):
    tau = six(sign * 10.0, leg, 3.0)
    assert not effort.limit_force(tau, 10.0)
    np.testing.assert_array_equal(tau, six(sign * 10.0, leg, 3.0))
    tau = six(sign * 10.5, leg, 3.0)
    assert effort.limit_force(tau, 10.0)
    np.testing.assert_array_equal(tau, six(sign * 10.0, leg, 3.0))


@ON_ONE_LEG
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_effort_moves_at_most_a_step_from_the_last_one(leg, sign):
    last = six(7.0)
    tau = last + six(sign * 2.0, leg)
    assert not effort.limit_step(tau, last, 2.0)
    np.testing.assert_array_equal(tau, last + six(sign * 2.0, leg))
    tau = last + six(sign * 2.5, leg)
    assert effort.limit_step(tau, last, 2.0)
    np.testing.assert_array_equal(tau, last + six(sign * 2.0, leg))
    np.testing.assert_array_equal(last, six(7.0))


def test_effort_window_has_the_extremes_of_all_its_rows():
    for rows in (1, 5, effort.BLOCK, effort.BLOCK + 1, 3 * effort.BLOCK - 2):
        blocks = math.ceil(rows / effort.BLOCK)
        history, lows, highs = np.zeros((rows, 6)), np.zeros((blocks, 6)), np.zeros((blocks, 6))
        random = np.random.default_rng(rows)
        for tick in range(2 * rows):
            effort.remember(random.normal(size=6), tick % rows, history, lows, highs)
            low, high = effort.window_extremes(lows, highs)
            np.testing.assert_array_equal(low, history.min(axis=0))
            np.testing.assert_array_equal(high, history.max(axis=0))


@ON_ONE_LEG
def test_effort_window_forgets_a_force_with_its_row(leg):
    history, lows, highs = np.zeros((40, 6)), np.zeros((3, 6)), np.zeros((3, 6))
    for tick in range(120):
        effort.remember(six(7.0 if tick == 50 else 0.0, leg), tick % 40, history, lows, highs)
        low, high = effort.window_extremes(lows, highs)
        np.testing.assert_array_equal(low, six(0.0))
        np.testing.assert_array_equal(high, six(7.0 if 50 <= tick < 90 else 0.0, leg))


@ON_ONE_LEG
def test_effort_stays_within_the_window_of_all_recent_forces(leg):
    low, high = six(-1.0), six(4.0)
    for asked, sent in ((7.0, 7.0), (7.5, 7.0), (-4.0, -4.0), (-4.5, -4.0)):
        tau = six(asked, leg, 2.0)
        assert effort.limit_window(tau, low, high, 8.0) == (asked != sent)
        np.testing.assert_array_equal(tau, six(sent, leg, 2.0))
