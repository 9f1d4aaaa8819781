"""Certificate watch among the safety rules: when it is active, what it allows, and what breaks it."""

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Mode, Warn
from tests.hil.safety_bench import (
    FAULT,
    MOVING,
    PERIOD_NS,
    RATE_HZ,
    WARN,
    Bench,
    certified,
    leg,
)

UNUSED = {"legs_used": 0b011111, "unseen": 1}
CLEAN = [np.nan, np.nan, np.nan, np.nan]


def figures(bench, mode=Mode.TRACKING, de=0.0, **changes):
    return bench.tick(mode, dq=leg(-de), **changes)


def broken(bench, **changes):
    return bool(figures(bench, **changes).warnings & Warn.CERTIFICATE)


def test_guard_reports_no_certificate_values_for_a_law_without_a_certificate():
    bench = Bench()
    for mode in Mode:
        np.testing.assert_array_equal(figures(bench, mode).certificate, CLEAN)


@pytest.mark.parametrize("mode", Mode)
def test_guard_watches_the_certificate_only_in_moving_modes(mode):
    bench = certified()
    first, second = (figures(bench, mode, de=de) for de in (0.5, 0.25))
    if mode in MOVING:
        np.testing.assert_allclose(first.certificate, [1.0, np.nan, np.nan, np.nan])
        np.testing.assert_allclose(second.certificate[:2], [0.25, -0.75 * RATE_HZ])
        assert second.certificate[3] == pytest.approx(0.5, rel=1e-4)
    else:
        for verdict in (first, second):
            np.testing.assert_array_equal(verdict.certificate, CLEAN)
            assert not verdict.warnings
            assert not verdict.faults


@pytest.mark.parametrize(
    ("action", "warning", "fault"),
    [
        (0.0, Warn.NONE, Fault.NONE),
        (WARN, Warn.CERTIFICATE, Fault.NONE),
        (FAULT, Warn.CERTIFICATE, Fault.CERTIFICATE),
    ],
)
def test_guard_warns_or_faults_for_a_broken_certificate(action, warning, fault):
    bench = certified(action)
    for de, told in ((0.5, False), (0.4, False), (0.6, True), (0.3, False)):
        verdict = figures(bench, de=de, bus_errors=1, condition=60.0)
        assert verdict.warnings == Warn.BUS | (warning if told else Warn.NONE)
        assert verdict.faults == Fault.CONDITION | (fault if told else Fault.NONE)
    assert not figures(certified(action), bus_off=True).faults & Fault.CERTIFICATE


def test_guard_does_not_check_the_certificate_of_a_platform_on_its_brakes():
    ready = np.full(6, int(DriveState.READY))
    bench = certified()
    for de in (0.0, 0.5):
        verdict = figures(bench, Mode.RELEASING, de=de, drive_state=ready)
        np.testing.assert_array_equal(verdict.certificate, CLEAN)
    assert not broken(bench, de=1.0)
    assert broken(bench, de=1.5)
    figures(bench, Mode.PARKING)
    figures(bench, Mode.PARKED)
    assert not broken(bench, de=2.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"age": leg(1, 0, np.int64)},
        UNUSED,
        {"skipped": 1},
        {"lateness_ns": PERIOD_NS // 5 + 1},
        {"dq_d": leg(26.0)},
    ],
    ids=["stale", "unused", "skipped", "late", "jump"],
)
def test_guard_restarts_the_certificate_check_after_a_disturbed_tick(changes):
    bench = certified()
    assert not broken(bench)
    assert not broken(bench, de=0.5, **changes)
    assert np.isnan(figures(bench, de=0.5, **changes).certificate[2:]).all()
    for all_used in ({}, {"legs_used": 0b111111, "unseen": 0}):
        bench = certified()
        figures(bench, **all_used)
        assert broken(bench, de=0.5, **all_used)


def test_guard_divides_the_rate_of_V_by_the_time_of_skipped_ticks():
    bench = certified()
    figures(bench)
    assert figures(bench, de=0.5, skipped=3).certificate[1] == pytest.approx(1.0 * RATE_HZ / 4)


@pytest.mark.parametrize("late_ns", [-4_000_000, 4_000_000])
def test_guard_adds_the_motion_of_a_late_tick_to_the_certificate_bound(late_ns):
    """2 m/s and up to 100 m/s^2 for 4 ms give 8 mm and 0.4 m/s; W = 2 (e + de)."""
    moving = {"dq_d": leg(2.0), "lateness_ns": late_ns}
    bench = certified(disturbance=100.0)
    figures(bench, de=-2.0, dq_d=leg(2.0))
    at = 0.408
    assert not broken(bench, de=-2.0 + 0.999 * at, **moving)
    assert broken(bench, de=-2.0 + 1.01 * at, **moving)


@pytest.mark.parametrize("changes", [{"age": leg(1, 0, np.int64)}, UNUSED])
def test_guard_does_not_compare_a_measured_error_with_an_estimated_one(changes):
    bench = certified()
    figures(bench)
    figures(bench, **changes)
    assert not broken(bench, de=0.5)
    assert not broken(bench, de=0.5)
    assert broken(bench, de=0.8)


def test_guard_checks_the_certificate_only_after_the_law_forces_act_despite_a_stale_leg():
    bench = certified(ticks=4)
    figures(bench)
    figures(bench, tau=leg(1000.0))
    ages = [leg(age, 0, np.int64) for age in (0, 1, 0, 0, 0, 0)]
    judged = [bool(np.isfinite(figures(bench, age=age).certificate[2])) for age in ages]
    assert judged == [False] * 4 + [True] * 2


def test_guard_does_not_check_the_certificate_after_limited_forces():
    bench = certified(ticks=3)
    figures(bench)
    assert not broken(bench, tau=0.0)
    verdict = figures(bench, tau=leg(1000.0))
    assert verdict.warnings & Warn.FORCE_STEP
    assert np.isfinite(verdict.certificate[2])
    judged = [bool(np.isfinite(figures(bench).certificate[2])) for _ in range(6)]
    assert judged == [False] * 3 + [True] * 3
    bench = certified()
    figures(bench)
    bench.tick(tau=leg(1000.0))
    bench.safety.reset()
    assert not broken(bench, de=0.5)
    assert broken(bench, de=0.8), "a reset must clear the earlier force change"


def test_guard_checks_the_certificate_of_a_pose_space_law_with_pose_errors():
    bench = certified(pose=1.0)
    pushed = {"p_d": np.array([0.0, 0.0, 0.5]), "q": leg(5.1, 5.0)}
    assert bench.tick(**pushed).certificate[0] == pytest.approx(4 * 0.25)
    assert bench.safety.watches_pose
    bench = certified()
    assert bench.tick(**pushed).certificate[0] == pytest.approx(4 * 0.01)
    assert not bench.safety.watches_pose
    assert not Bench().safety.watches_pose


def test_guard_lists_the_axes_that_break_the_certificate_long_enough():
    assert Bench().safety.broken_axes() == ()
    bench = certified(confirm=2.0)
    named = []
    for de in (0.5, 0.6, 0.9, 1.4, 0.1):
        figures(bench, de=de)
        named.append(bench.safety.broken_axes())
    assert named == [(), (), (3,), (3,), ()]
