"""Each leg is judged and limited by its own values, where all of them differ."""

from __future__ import annotations

import numpy as np
import pytest

from hil.safety import force_limits, motion
from tests.hil.encoder_bench import BOTH_SIGNS, six

ON_EACH_LEG = pytest.mark.parametrize("leg", range(6))
LENGTHS = np.array([5.0, 7.0, 4.0, 9.0, 6.0, 8.0])
LAST_N = np.array([10.0, -20.0, 30.0, -40.0, 50.0, -60.0])
HEARD = np.zeros(6, np.int64)


@ON_EACH_LEG
@BOTH_SIGNS
def test_the_following_error_of_a_leg_is_from_its_own_length(leg, sign):
    lagging, rates = motion.lagging, six(4.0, leg)
    for q_d, lags in ((0.25, False), (0.26, True)):
        assert lagging(LENGTHS, LENGTHS + six(sign * q_d, leg), six(0.0), 0.25, 0.0) == lags
        assert lagging(LENGTHS, LENGTHS + six(sign * (q_d + 2.0), leg), rates, 0.25, 0.5) == lags


@ON_EACH_LEG
@BOTH_SIGNS
def test_a_leg_stands_where_it_was_heard_itself(leg, sign):
    moved, still = motion.moved_legs, six(np.nan)
    assert moved(LENGTHS, HEARD, still, 0.25) == 0
    np.testing.assert_array_equal(still, LENGTHS)
    assert moved(LENGTHS + six(sign * 0.26, leg), HEARD, still, 0.25) == 1 << leg


@BOTH_SIGNS
def test_a_force_may_move_a_step_away_from_the_last_one_of_its_own_leg(sign):
    tau = LAST_N + sign * 9.0
    assert force_limits.limit_step(tau, LAST_N, 2.0)
    np.testing.assert_array_equal(tau, LAST_N + sign * 2.0)
    assert not force_limits.limit_step(tau, LAST_N, 2.0)


@BOTH_SIGNS
def test_a_force_stays_within_the_window_of_its_own_leg(sign):
    low, high = LAST_N - np.arange(6.0), LAST_N + 2.0 * np.arange(6.0)
    tau = LAST_N + sign * 1e3
    assert force_limits.limit_window(tau, low, high, 100.0)
    np.testing.assert_array_equal(tau, low + 100.0 if sign > 0 else high - 100.0)
    assert not force_limits.limit_window(tau, low, high, 100.0)
