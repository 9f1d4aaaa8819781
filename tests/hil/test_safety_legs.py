"""Each leg is judged and limited by its own values, where all of them differ."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Warn
from hil.safety import Safety, motion
from tests.hil.encoder_bench import BOTH_SIGNS, six
from tests.hil.test_safety import LIMITS, RATE_HZ, Bench

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
@pytest.mark.parametrize("limit", ["force_step_N", "force_window_N"])
def test_a_force_may_move_a_step_and_within_the_window_from_those_of_its_own_leg(limit, sign):
    wide = {"force_N": 1e6, "force_step_N": 1e6, "force_window_N": 1e6}
    bench = Bench()
    bench.safety = Safety(LIMITS.model_copy(update={**wide, limit: 2.0}), 1.0, 9.0, RATE_HZ, 1e6)
    bench.safety.resume(LAST_N)
    warned = Warn.FORCE_STEP if limit == "force_step_N" else Warn.FORCE_WINDOW
    assert bench.tick(tau=LAST_N).warnings == Warn.NONE
    verdict = bench.tick(tau=LAST_N + sign * 9.0)
    np.testing.assert_array_equal(verdict.tau, LAST_N + sign * 2.0)
    assert verdict.warnings == warned


@ON_EACH_LEG
def test_a_leg_beyond_a_hard_end_or_a_drive_out_of_run_is_found_wherever_it_is(leg):
    for q, fault in ((1.0, Fault.NONE), (0.999, Fault.STROKE), (9.0, Fault.NONE), (9.001, Fault.STROKE)):
        lengths = np.where(np.arange(6) == leg, q, 5.0)
        assert Bench().tick(q=lengths, q_d=lengths).faults == fault
    for state in DriveState:
        states = np.where(np.arange(6) == leg, int(state), int(DriveState.RUN))
        lost = state in {DriveState.FAULT, DriveState.BOOT}
        assert Bench().tick(drive_state=states).faults == (Fault.DRIVE if lost else Fault.NONE)
        bench = Bench()
        bench.tick()
        left = state is not DriveState.RUN
        assert bench.tick(drive_state=states).faults == (Fault.DRIVE if left else Fault.NONE)
