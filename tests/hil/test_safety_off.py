"""What bus, loop and recorder did while the drives were off counts from the tick on that powers them."""

import pytest

from drivers.signals import Fault, Mode, Stop, Warn
from tests.hil.test_safety import OFF, Bench

ON_EACH = pytest.mark.parametrize("mode", OFF)


@ON_EACH
def test_a_bus_that_refused_frames_before_the_drives_were_powered_is_dead_in_their_first_tick(mode):
    bench = Bench()
    for _ in range(4):
        verdict = bench.tick(mode, sends_failed=1)
        assert (verdict.faults, verdict.warnings) == (Fault.NONE, Warn.BUS)
    assert bench.tick(Mode.LOADING, sends_failed=1).faults == Fault.BUS


@ON_EACH
def test_periods_missed_before_the_drives_were_powered_are_of_the_same_row(mode):
    bench = Bench()
    assert bench.tick(mode, skipped=4).stop is Stop.NONE
    assert bench.tick(Mode.LOADING, skipped=1).stop is Stop.MISSED


@ON_EACH
def test_ticks_that_were_late_before_the_drives_were_powered_are_of_the_same_32(mode):
    bench = Bench()
    for _ in range(7):
        assert bench.tick(mode, lateness_ns=9_000_000).warnings == Warn.LATE
    assert bench.tick(Mode.LOADING, lateness_ns=9_000_000).warnings == Warn.LATE | Warn.DEGRADED


@ON_EACH
def test_what_the_recorder_lost_before_the_drives_were_powered_is_told_then_and_no_news_later(mode):
    bench = Bench(on_recorder_loss="stop")
    bench.tick(mode, recorder_dropped=2)
    lost = bench.tick(mode, recorder_dropped=5)
    assert (lost.warnings, lost.stop) == (Warn.RECORDER, Stop.NONE)
    then = bench.tick(Mode.LOADING, recorder_dropped=5)
    assert (then.warnings, then.stop) == (Warn.NONE, Stop.NONE)
