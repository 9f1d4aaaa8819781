"""Force limits of safety: size, step and window, by mode."""

import numpy as np
import pytest

from drivers.signals import Fault, Mode, Warn
from tests.hil.safety_bench import (
    LIMITS,
    OFF,
    Bench,
    leg,
)


def test_guard_resumes_a_force_at_once_and_then_limits_its_changes():
    bench = Bench()
    for _ in range(12):
        bench.tick(Mode.UNLOADING, 0.0)
    assert bench.tick(Mode.HELD, 90.0).tau[0] == 50.0, "the first change must be limited by the force step"
    held = np.array([90.0, -90.0, 0.0, 95.0, 40.0, -10.0])
    bench.safety.resume(held)
    verdict = bench.tick(Mode.HELD, held)
    np.testing.assert_array_equal(verdict.tau, held)
    assert verdict.warnings == Warn.NONE
    np.testing.assert_array_equal(bench.tick(Mode.HELD, held - [81.0, 0, 0, 0, 0, 0]).tau[0], 40.0)
    low = bench.tick(Mode.HELD, held - [85.0, 0, 0, 0, 0, 0])
    assert low.tau[0] == 10.0, "the window of ten ticks begins at the force that came back"


def test_guard_limits_the_step_relative_to_the_last_sent_force():
    bench = Bench()
    for asked, sent in ((60.0, 50.0), (55.0, 55.0), (0.0, 5.0), (-45.0, -25.0)):  # the last one by the window
        verdict = bench.tick(tau=leg(asked))
        np.testing.assert_array_equal(verdict.tau, leg(sent))
        assert bool(verdict.warnings & Warn.FORCE_STEP) == (asked in {60.0, 0.0})


def test_guard_warns_about_each_force_limit_by_name():
    wide = {"force_N": 100.0, "force_step_N": 1e6, "force_window_N": 1e6}
    for name, warn in (
        ("force_N", Warn.FORCE_LIMIT),
        ("force_step_N", Warn.FORCE_STEP),
        ("force_window_N", Warn.FORCE_WINDOW),
    ):
        limits = LIMITS.model_copy(update={**wide, "force_N": 1e6, name: 100.0})
        safety = Bench(limits, drive_force_limit=1e6)
        assert safety.tick(tau=leg(100.0)).warnings == Warn.NONE
        safety.safety.reset()
        verdict = safety.tick(tau=leg(-100.5))
        assert verdict.warnings == warn
        np.testing.assert_array_equal(verdict.tau, leg(-100.0))


def test_guard_limits_the_force_to_the_drives_force():
    bench = Bench(drive_force_limit=30.0)
    verdict = bench.tick(tau=leg(31.0))
    assert verdict.warnings == Warn.FORCE_LIMIT
    np.testing.assert_array_equal(verdict.tau, leg(30.0))
    bench = Bench(drive_force_limit=300.0)
    bench.tick(tau=leg(50.0))
    bench.tick(tau=leg(80.0))
    for _ in range(10):
        bench.tick(tau=leg(80.0))
    assert bench.tick(tau=leg(101.0)).warnings == Warn.FORCE_LIMIT


def climb(bench, sign=1.0):
    """Demand 100 N from zero and give the forces sent; the window allows 80 N."""
    return [float(bench.tick(tau=leg(sign * 100.0)).tau[3]) for _ in range(13)]


def test_guard_force_window_lasts_250_ms_and_at_least_one_tick():
    bench = Bench()
    # from the zero before the first tick: 50 by the step, then 80 until that zero is ten ticks old and gone
    assert climb(bench) == [50.0] + [80.0] * 9 + [100.0] * 3
    down = [float(bench.tick(tau=leg(-100.0)).tau[3]) for _ in range(12)]
    assert down == [50.0] + [20.0] * 9 + [-30.0] + [-60.0]
    assert climb(Bench(rate_Hz=1.0))[:3] == [50.0, 100.0, 100.0]


def test_guard_force_window_continues_over_skipped_periods():
    bench = Bench()
    bench.tick(tau=leg(50.0))
    assert bench.tick(tau=leg(100.0), skipped=8).tau[3] == 80.0
    assert bench.tick(tau=leg(100.0)).tau[3] == 100.0
    bench = Bench()
    bench.tick(tau=leg(50.0))
    assert bench.tick(tau=leg(100.0), skipped=10**6).tau[3] == 100.0
    verdict = bench.tick(tau=leg(-100.0), skipped=3)
    assert verdict.tau[3] == 50.0
    assert verdict.warnings & Warn.FORCE_STEP
    bench = Bench()
    asked = ((50.0, 0), (80.0, 3), (-100.0, 0), (-100.0, 0))
    assert [float(bench.tick(tau=leg(a), skipped=n).tau[3]) for a, n in asked] == [50.0, 80.0, 30.0, 0.0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_guard_force_window_is_empty_after_idle(sign):
    bench = Bench(rate_Hz=160.0)
    for _ in range(15):
        bench.tick(tau=leg(sign * 30.0))
    bench.tick(Mode.IDLE)
    sent = [sign * bench.tick(tau=leg(sign * 100.0)).tau[3] for _ in range(30)]
    assert sent == [50.0] + [80.0] * 29


def test_guard_force_window_includes_the_last_tick():
    bench = Bench(LIMITS.model_copy(update={"force_step_N": 1e6}), drive_force_limit=1e6)
    assert [float(bench.tick(tau=leg(a)).tau[3]) for a in (70.0, -30.0, -30.0)] == [70.0, -10.0, -10.0]


@pytest.mark.parametrize("mode", OFF)
def test_guard_starts_from_zero_force_after_the_drives_are_off(mode):
    bench = Bench()
    for before, sign in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        climb(bench, before)
        tau = bench.tick(mode, tau=leg(100.0)).tau
        np.testing.assert_array_equal(tau, np.zeros(6))
        assert climb(bench, sign) == climb(Bench(), sign)
        bench.safety.reset()
        assert climb(bench, sign) == climb(Bench(), sign)
        bench.safety.reset()
        bench.tick(tau=leg(-sign * 50.0))
        assert bench.tick(tau=leg(-sign * 100.0), skipped=3).tau[3] == -sign * 80.0


def test_guard_sends_no_force_for_a_nan_law_and_keeps_the_demand():
    bench = Bench()
    bench.tick(tau=leg(40.0))
    verdict = bench.tick(tau=leg(np.nan, 40.0))
    assert verdict.faults == Fault.LAW
    np.testing.assert_array_equal(verdict.tau, np.zeros(6))
    np.testing.assert_array_equal(bench.tick(tau=leg(1000.0)).tau_asked, leg(1000.0))


def test_guard_gives_bitwise_equal_results_after_a_reset():
    bench = Bench()
    inputs = [(float(100 * np.sin(k)), k % 7 == 0, k % 5) for k in range(60)]

    def run():
        out = [bench.tick(tau=leg(a), bus_off=b, skipped=c) for a, b, c in inputs]
        return [(v.tau.tobytes(), v.warnings, v.faults, v.stop) for v in out]

    first = run()
    bench.safety.reset()
    assert run() == first
