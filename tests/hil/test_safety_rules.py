"""Every safety rule at its limit, on both sides of it.

A test name begins with the file of its rule: the mutation test runs the tests of a file against changed
copies.
"""

import math

import numpy as np
import pytest

from drivers.signals import NEVER, Foreign
from hil.safety import force_limits, motion, signals

ON_ONE_LEG = pytest.mark.parametrize("leg", range(6))
LENGTHS = np.array([5.0, 7.0, 4.0, 9.0, 6.0, 8.0])


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
def test_signals_number_that_is_not_finite_is_found_at_any_position(shape, bad):
    x = np.full(shape, -1e300)
    assert signals.all_finite(x)
    for index in np.ndindex(shape):
        y = x.copy()
        y[index] = bad
        assert not signals.all_finite(y)


def test_signals_history_has_one_bit_for_each_of_32_ticks():
    for bits in (0, 1, 2, 3, 4, 0b1011, 1 << 31, (1 << 32) - 1):
        assert signals.ones(bits) == bits.bit_count()
    assert signals.ones((1 << 40) - 1) == 32
    history = 0
    for happened, expected in ((True, 0b1), (True, 0b11), (False, 0b110), (True, 0b1101)):
        history = signals.noted(history, happened)
        assert history == expected
    assert signals.noted(1 << 30, False) == 1 << 31
    assert signals.noted(1 << 31, False) == 0
    assert signals.noted((1 << 32) - 1, True) == (1 << 32) - 1


# -- legs


@ON_ONE_LEG
def test_signals_legs_are_stale_from_the_limit_on(leg):
    assert not signals.stale(ints(1, leg, 0), 2)
    assert signals.stale(ints(2, leg, 0), 2)
    assert signals.stale(ints(3, leg, 0), 2)
    assert not signals.stale(ints(4, leg, 0), 5)
    assert signals.stale(ints(5, leg, 0), 5)
    assert signals.stale(ints(NEVER, leg, 0), 5)


# -- bus


def test_signals_bus_is_down_if_off_or_after_repeated_refusals():
    # real drives allow 10 ms; a stretch of 4 ms is near to what would have ended their run
    assert (signals.DEGRADED_AT, signals.UNRELIABLE) == (8, 8)
    assert (signals.HARMFUL_STRETCH_NS, signals.STRETCH_FREE_NS) == (4_000_000, 500_000_000)
    assert sum(kind for kind in Foreign if kind is not Foreign.ESTOP) == signals.CONTROLLER
    assert signals.bus_down(True, 0)
    assert not signals.bus_down(False, 0)
    assert not signals.bus_down(False, 0b1111)
    assert signals.bus_down(False, 0b11111)
    assert signals.bus_down(False, 0b1111111)
    assert not signals.bus_down(False, 0b111101110)
    assert signals.bus_down(False, 0b1111011110)
    assert not signals.bus_down(False, 0b11111 << 3)
    assert not signals.bus_down(False, 0b111110)


# -- stroke


def test_motion_speed_cap_before_a_soft_end_is_sqrt_2ad_and_at_least_the_creep_speed():
    assert motion.speed_cap(1.0, 2.0) == 2.0
    assert motion.speed_cap(0.25, 8.0) == 2.0
    assert motion.speed_cap(4.0, 8.0) == 8.0
    for distance in (0.0, -0.5, 1e-9):
        assert motion.speed_cap(distance, 2.0) == 1e-3


@ON_ONE_LEG
def test_motion_speed_of_a_leg_is_capped_only_towards_a_soft_end(leg):
    def fast(q, dq):
        return motion.too_fast_for_end(six(q, leg, 5.0), six(dq, leg), 2.0, 8.0, 2.0)

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
def test_motion_speed_limit_of_a_leg_applies_in_both_directions(leg):
    for dq, expected in ((0.5, False), (-0.5, False), (0.501, True), (-0.501, True)):
        assert motion.overspeed(six(dq, leg), 0.5) == expected


# -- following


@ON_ONE_LEG
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_motion_following_error_limit_grows_with_the_commanded_speed(leg, sign):
    def lags(error, dq_d, per_speed):
        return motion.lagging(LENGTHS, LENGTHS + six(sign * error, leg), six(dq_d, leg), 0.25, per_speed)

    assert not lags(0.25, 0.0, 0.0)
    assert lags(0.26, 0.0, 0.0)
    assert lags(0.26, 2.0, 0.0)
    for dq_d in (2.0, -2.0):
        assert not lags(1.25, dq_d, 0.5)
        assert lags(1.26, dq_d, 0.5)


# -- effort


@ON_ONE_LEG
def test_force_limits_clamp_the_force_of_one_leg(leg):
    for asked, sent in ((4.0, 4.0), (4.5, 4.0), (2.0, 2.0), (-1.0, -1.0), (-1.5, -1.0)):
        tau = six(asked, leg, 9.0)
        assert force_limits.clamp(tau, leg, -1.0, 4.0) == (asked != sent)
        np.testing.assert_array_equal(tau, six(sent, leg, 9.0))


def window_of(rows):
    return np.zeros((rows + 2 * math.ceil(rows / force_limits.BLOCK), 6))


def test_force_limits_window_has_the_extremes_of_all_its_rows():
    remember, extremes = force_limits.remember, force_limits.window_extremes
    for rows in (1, 5, force_limits.BLOCK, force_limits.BLOCK + 1, 3 * force_limits.BLOCK - 2):
        window = window_of(rows)
        random = np.random.default_rng(rows)
        for tick in range(2 * rows):
            remember(random.normal(size=6), tick % rows, window, rows)
            low, high = extremes(window, rows)
            np.testing.assert_array_equal(low, window[:rows].min(axis=0))
            np.testing.assert_array_equal(high, window[:rows].max(axis=0))


@ON_ONE_LEG
def test_force_limits_window_drops_a_force_with_its_row(leg):
    window = window_of(40)
    for tick in range(120):
        force_limits.remember(six(7.0 if tick == 50 else 0.0, leg), tick % 40, window, 40)
        low, high = force_limits.window_extremes(window, 40)
        np.testing.assert_array_equal(low, six(0.0))
        np.testing.assert_array_equal(high, six(7.0 if 50 <= tick < 90 else 0.0, leg))


# -- standstill


@ON_ONE_LEG
@pytest.mark.parametrize("sign", [1, -1])
def test_motion_standstill_checks_the_rate_of_every_reporting_leg(leg, sign):
    assert (motion.REST_m_s, motion.HOP) == (0.02, 1.0), "the constants stated in the docs on faults"
    heard, silent = np.zeros(6, np.int64), ints(1, leg, 0)
    assert motion.at_rest(six(sign * 0.49, leg), heard, 0.5)
    assert not motion.at_rest(six(sign * 0.5, leg), heard, 0.5)
    assert motion.at_rest(six(sign * 0.5, leg), silent, 0.5)
    assert not motion.at_rest(six(0.5, leg, 0.6), silent, 0.5), "the other legs report"


@ON_ONE_LEG
@pytest.mark.parametrize("sign", [1, -1])
def test_motion_standstill_reports_the_leg_that_has_moved_too_far(leg, sign):
    heard, still = np.zeros(6, np.int64), six(np.nan)
    assert motion.moved_legs(LENGTHS, heard, still, 0.25) == 0
    np.testing.assert_array_equal(still, LENGTHS)
    assert motion.moved_legs(LENGTHS + six(sign * 0.25, leg), heard, still, 0.25) == 0
    assert motion.moved_legs(LENGTHS + six(sign * 0.26, leg), heard, still, 0.25) == 1 << leg
    assert motion.moved_legs(LENGTHS + 1.0, heard, still, 0.25) == 0b111111
    np.testing.assert_array_equal(still, LENGTHS)


@ON_ONE_LEG
def test_motion_standstill_of_a_silent_leg_begins_at_its_next_feedback(leg):
    still = six(np.nan)
    silent = ints(1, leg, 0)
    assert motion.moved_legs(six(0.0, leg, 5.0), silent, still, 0.25) == 0
    assert np.isnan(still).tolist() == [k == leg for k in range(6)]
    others = 0b111111 & ~(1 << leg)
    assert motion.moved_legs(six(7.0), silent, still, 0.25) == others
    assert motion.moved_legs(six(7.0), np.zeros(6, np.int64), still, 9.0) == 0
    assert still[leg] == 7.0
