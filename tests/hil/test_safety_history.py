"""What safety remembers from before: ticks with the drives off, legs that rested, and a force that comes back."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Fault, Mode, Stop, Warn
from tests.hil.test_safety import OFF, RATE_HZ, Bench

ON_EACH_OFF = pytest.mark.parametrize("mode", OFF)

# -- what bus, loop and recorder did while the drives were off counts from the tick on that powers them


@ON_EACH_OFF
def test_a_bus_that_refused_frames_before_the_drives_were_powered_is_dead_then(mode):
    bench = Bench()
    for _ in range(4):
        verdict = bench.tick(mode, sends_failed=1)
        assert (verdict.faults, verdict.warnings) == (Fault.NONE, Warn.BUS)
    assert bench.tick(Mode.LOADING, sends_failed=1).faults == Fault.BUS


@ON_EACH_OFF
def test_periods_missed_and_ticks_late_before_the_drives_were_powered_count(mode):
    bench = Bench()
    assert bench.tick(mode, skipped=4).stop is Stop.NONE
    assert bench.tick(Mode.LOADING, skipped=1).stop is Stop.MISSED
    bench = Bench()
    for _ in range(7):
        assert bench.tick(mode, lateness_ns=9_000_000).warnings == Warn.LATE
    assert bench.tick(Mode.LOADING, lateness_ns=9_000_000).warnings == Warn.LATE | Warn.DEGRADED


@ON_EACH_OFF
def test_what_the_recorder_lost_before_the_drives_were_powered_is_no_news_later(mode):
    bench = Bench(on_recorder_loss="stop")
    bench.tick(mode, recorder_dropped=2)
    lost = bench.tick(mode, recorder_dropped=5)
    assert (lost.warnings, lost.stop) == (Warn.RECORDER, Stop.NONE)
    then = bench.tick(Mode.LOADING, recorder_dropped=5)
    assert (then.warnings, then.stop) == (Warn.NONE, Stop.NONE)


# -- legs that rest while a force holds them


SETTLED = round(0.2 * RATE_HZ)
"""Ticks after which legs at rest have to stand still after a fault."""


@pytest.mark.parametrize(
    "mode",
    [Mode.WAITING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.HELD],
)
def test_legs_that_rested_where_no_brake_holds_them_may_move_on_and_rest_again_after_a_fault(mode):
    benches = Bench(), Bench()
    for bench in benches:
        for _ in range(3 * SETTLED):
            assert bench.tick(mode).faults == Fault.NONE
    moved, failed = benches
    assert moved.tick(mode, length=6.0, q=6.0, q_d=6.0).faults == Fault.NONE
    assert not moved.record["legs_moved"]
    for k in range(SETTLED + 1):
        assert failed.tick(Mode.FAULT, length=5.0 + 0.2 * k).faults == Fault.NONE
    assert failed.tick(Mode.FAULT, length=7.0).faults == Fault.BRAKE


# -- a force that comes back at once


BACK = np.array([250.0, -250.0, 99.0, -99.0, 130.0, 0.0])
WITHIN = np.array([100.0, -100.0, 99.0, -99.0, 100.0, 0.0])


@pytest.mark.parametrize("mode", [Mode.HELD, Mode.PARKING])
def test_a_force_beyond_the_limit_comes_back_as_the_limit_and_steps_count_from_there(mode):
    bench = Bench()
    bench.tick(mode, 0.0)
    bench.safety.resume(BACK)
    for _ in range(3):
        verdict = bench.tick(mode, BACK)
        np.testing.assert_array_equal(verdict.tau, WITHIN)
        assert verdict.warnings & Warn.FORCE_LIMIT
        assert not verdict.warnings & Warn.FORCE_STEP
    bench = Bench()
    bench.safety.resume(BACK)
    verdict = bench.tick(Mode.HELD, 0.0)
    np.testing.assert_array_equal(verdict.tau, [50.0, -50.0, 49.0, -49.0, 50.0, 0.0])
    assert verdict.warnings & Warn.FORCE_STEP


def test_a_force_comes_back_at_once_where_the_window_of_forces_is_a_single_tick_too():
    bench = Bench(rate_Hz=1.0)
    bench.safety.resume(WITHIN)
    verdict = bench.tick(Mode.HELD, WITHIN)
    np.testing.assert_array_equal(verdict.tau, WITHIN)
    assert verdict.warnings == Warn.NONE
