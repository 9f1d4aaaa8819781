"""Combined safety rules: the faults and warnings of a tick, by mode."""

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Foreign, Mode, Stop, Warn
from hil.safety.encoder_limits import NONE
from tests.hil.safety_bench import (
    CLOSED,
    FOLLOWING,
    LIMITS,
    MOVING,
    OFF,
    PERIOD_NS,
    POWERED,
    Bench,
    leg,
)


@pytest.mark.parametrize("mode", Mode)
def test_guard_reports_no_fault_and_no_warning_in_a_healthy_tick(mode):
    verdict = Bench().tick(mode, 20.0)
    assert verdict.warnings == Warn.NONE
    assert verdict.faults == Fault.NONE
    assert verdict.stop is Stop.NONE
    np.testing.assert_array_equal(verdict.tau, np.full(6, 20.0 if mode in POWERED else 0.0))


ALWAYS_FAULTS = {
    "stale": (Fault.STALE, {"age": leg(5, 0, np.int64)}),
    "drive fault": (Fault.DRIVE, {"drive_state": leg(DriveState.FAULT, DriveState.RUN, np.int64)}),
    "drive rebooted": (Fault.DRIVE, {"drive_state": leg(DriveState.BOOT, DriveState.RUN, np.int64)}),
    "bus off": (Fault.BUS, {"bus_off": True}),
    "residual": (Fault.KINEMATICS, {"fk_residual": np.nextafter(1e-4, 1.0)}),
    "not converged": (Fault.KINEMATICS, {"fk_residual": np.inf}),
    "residual that is no number": (Fault.KINEMATICS, {"fk_residual": np.nan}),
    "hop": (Fault.ASSEMBLY, {"hop": 1.0}),
    "hop that is no number": (Fault.ASSEMBLY, {"hop": np.nan}),
    "condition": (Fault.CONDITION, {"condition": 50.001}),
    "condition that is no number": (Fault.CONDITION, {"condition": np.nan}),
    "speed": (Fault.SPEED, {"dq": leg(-3.1)}),
    **{
        name: (Fault.NOT_FINITE, {name: leg(bad)})
        for name, bad in (("length", np.nan), ("rate", np.inf), ("drive_force", -np.inf))
    },
    **{name: (Fault.NOT_FINITE, {name: leg(np.nan, 5.0)}) for name in ("q", "q_d")},
    **{
        name: (Fault.NOT_FINITE, {name: leg(np.nan)})
        for name in ("dq", "twist", "dq_d", "ddq_d", "twist_d", "dtwist_d")
    },
    "p": (Fault.NOT_FINITE, {"p": np.array([0, np.nan, 0])}),
    "R": (Fault.NOT_FINITE, {"R": np.full((3, 3), np.nan)}),
    "J": (Fault.NOT_FINITE, {"J": np.diag(leg(np.nan))}),
    "law": (Fault.LAW, {"tau": leg(np.nan)}),
    "too long": (Fault.STROKE, {"q": leg(9.1, 5.0), "q_d": leg(9.1, 5.0)}),
    "too short": (Fault.STROKE, {"q": leg(0.9, 5.0), "q_d": leg(0.9, 5.0)}),
    "fast towards an end": (Fault.STROKE, {"q": leg(7.0, 5.0), "dq": leg(2.1), "q_d": leg(7.0, 5.0)}),
    "fast to the short one": (Fault.STROKE, {"q": leg(3.0, 5.0), "dq": leg(-2.1), "q_d": leg(3.0, 5.0)}),
}


@pytest.mark.parametrize("reason", ALWAYS_FAULTS)
def test_guard_reports_each_fault_only_while_the_drives_are_powered(reason):
    fault, changes = ALWAYS_FAULTS[reason]
    for mode in POWERED:
        assert Bench().tick(mode, **changes).faults == fault
    for mode in OFF:
        assert Bench().tick(mode, **changes).faults == Fault.NONE


NEARLY = {
    "stale": {"age": leg(4, 0, np.int64)},
    "residual": {"fk_residual": 1e-4},
    "hop": {"hop": 0.99},
    "condition": {"condition": 50.0},
    "speed": {"dq": leg(-2.5)},
    "stroke": {"q": leg(9.0, 5.0), "q_d": leg(9.0, 5.0)},
    "shortest": {"q": leg(1.0, 5.0), "q_d": leg(1.0, 5.0)},
    "approach": {"q": leg(7.0, 5.0), "dq": leg(1.9), "q_d": leg(7.0, 5.0)},
    "following": {"q_d": leg(5.2, 5.0)},
    "following at speed": {"q_d": leg(6.2, 5.0), "dq_d": leg(-2.0)},
}


@pytest.mark.parametrize("reason", NEARLY)
def test_guard_accepts_values_just_inside_the_limits(reason):
    for mode in POWERED:
        assert Bench().tick(mode, **NEARLY[reason]).faults == Fault.NONE


def test_guard_allows_a_sync_skew_of_a_tenth_period_or_as_configured():
    for given_us, limit_ns in ((None, 100_000), (37.5, 37_500)):
        limits = LIMITS.model_copy(update={"sync_skew_us": given_us})
        assert Bench(limits, rate_Hz=1000.0).safety.limits["sync_skew_ns"] == limit_ns


def test_guard_reports_a_separate_fault_for_each_cause_in_a_tick():
    changes = {"hop": 2.0, "condition": 60.0, "bus_off": True, "tau": np.nan}
    verdict = Bench().tick(Mode.TRACKING, **changes)
    assert verdict.faults == Fault.ASSEMBLY | Fault.CONDITION | Fault.BUS | Fault.LAW


@pytest.mark.parametrize("mode", Mode)
def test_guard_checks_the_following_error_until_the_brakes_close(mode):
    for q_d, dq_d in ((5.26, 0.0), (4.74, 0.0), (6.26, 2.0)):
        verdict = Bench().tick(mode, q_d=leg(q_d, 5.0), dq_d=leg(dq_d))
        assert verdict.faults == (Fault.FOLLOWING if mode in FOLLOWING else Fault.NONE)


def moved_legs(bench, mode, **columns):
    tick = bench.tick(mode, **columns)
    return tick.faults, int(bench.record["legs_moved"])


@pytest.mark.parametrize("mode", Mode)
def test_guard_faults_with_the_leg_that_moves_on_its_closed_brake(mode):
    bench = Bench()
    assert moved_legs(bench, mode) == (Fault.NONE, 0)
    assert moved_legs(bench, mode, length=leg(5.125, 5.0)) == (Fault.NONE, 0)
    expected = (Fault.BRAKE, 0b001000) if mode in CLOSED else (Fault.NONE, 0)
    assert moved_legs(bench, mode, length=leg(4.87, 5.0)) == expected
    if mode in CLOSED:
        np.testing.assert_allclose(bench.moved_m, leg(0.13), atol=1e-12)


@pytest.mark.parametrize("mode", CLOSED)
def test_guard_accepts_a_new_rest_position_after_free_motion(mode):
    for between, kept in (
        (Mode.LOADING, True),
        (Mode.PARKED, True),
        (Mode.RELEASING, False),
        (Mode.HELD, False),
    ):
        bench = Bench()
        bench.tick(mode)
        bench.tick(between)
        fault = Fault.BRAKE if kept else Fault.NONE
        assert bench.tick(mode, length=5.2).faults == fault
    bench.safety.reset()
    assert bench.tick(mode, length=7.0).faults == Fault.NONE


def test_guard_checks_standstill_after_a_fault_and_0_2_s_at_rest():
    bench = Bench()
    for _ in range(8):  # 0.2 s
        assert bench.tick(Mode.FAULT, length=5.0).faults == Fault.NONE
    assert bench.tick(Mode.FAULT, length=6.0).faults == Fault.NONE, "the new rest position of the legs"
    assert bench.tick(Mode.FAULT, length=6.2).faults == Fault.BRAKE
    assert bench.tick(Mode.FAULT, length=6.2, rate=leg(0.021)).faults == Fault.NONE, "leg 3 moves again"
    for k in range(9):
        assert bench.tick(Mode.FAULT, length=5.0 + k).faults == Fault.NONE
    assert bench.tick(Mode.FAULT, length=6.0).faults == Fault.BRAKE


@pytest.mark.parametrize("mode", Mode)
def test_guard_warns_about_stale_legs_after_idle(mode):
    for age, warns in ((1, False), (2, True), (4, True)):
        verdict = Bench().tick(mode, age=leg(age, 0, np.int64))
        expected = warns and mode not in {Mode.WAITING, Mode.IDLE}
        assert verdict.warnings == (Warn.STALE if expected else Warn.NONE)
        assert verdict.faults == Fault.NONE


@pytest.mark.parametrize("mode", MOVING)
def test_guard_faults_when_a_drive_leaves_run_but_not_before_run(mode):
    bench = Bench()
    ready = leg(DriveState.READY, DriveState.RUN, np.int64)
    assert bench.tick(mode, drive_state=ready).faults == Fault.NONE
    assert bench.tick(mode, drive_state=ready).faults == Fault.NONE
    assert bench.tick(mode).faults == Fault.NONE
    assert bench.tick(mode, drive_state=ready).faults == Fault.DRIVE
    assert bench.tick(mode, drive_state=ready).faults == Fault.DRIVE
    assert bench.tick(Mode.PARKING, drive_state=ready).faults == Fault.NONE
    assert bench.tick(mode, drive_state=ready).faults == Fault.NONE


def test_guard_expects_no_run_after_a_reset_or_closed_brakes():
    ready = np.full(6, int(DriveState.READY))
    for mode in (Mode.LOADING, Mode.PARKING, Mode.IDLE, Mode.FAULT):
        bench = Bench()
        bench.tick(Mode.TRACKING)
        bench.tick(mode)
        assert bench.tick(Mode.RELEASING, drive_state=ready).faults == Fault.NONE
    bench = Bench()
    bench.tick(Mode.TRACKING)
    bench.safety.reset()
    assert bench.tick(Mode.RELEASING, drive_state=ready).faults == Fault.NONE


def test_guard_faults_bus_after_5_refusals_in_a_row_or_8_in_32_ticks():
    bench = Bench()
    faults = [bench.tick(sends_failed=n % 2).faults for n in range(16)]
    assert faults == [Fault.NONE] * 15 + [Fault.BUS]
    bench = Bench()
    faults = [bench.tick(sends_failed=n).faults for n in (1, 3, 0, 1, 1, 1, 1, 1, 0)]
    assert faults == [Fault.NONE] * 7 + [Fault.BUS] + [Fault.NONE]
    for _ in range(4):
        bench.tick(sends_failed=1)
    bench.safety.reset()
    assert bench.tick(sends_failed=1).faults == Fault.NONE


@pytest.mark.parametrize("mode", Mode)
def test_guard_faults_for_another_controller_in_every_mode(mode):
    for kind in (Foreign.SYNC, Foreign.COMMAND, Foreign.CONFIG):
        assert Bench().tick(mode, foreign=kind).faults == Fault.SECOND_CONTROLLER
    assert Bench().tick(mode, foreign=Foreign.ESTOP).faults == Fault.ESTOP
    both = Fault.ESTOP | Fault.SECOND_CONTROLLER
    assert Bench().tick(mode, foreign=Foreign.ESTOP | Foreign.SYNC).faults == both


@pytest.mark.parametrize("mode", POWERED)
def test_guard_faults_for_a_stale_leg_during_brake_tests_although_the_filter_estimates_it(mode):
    """The filter replaces a leg that may be lost; on closed brakes it assumes that all legs stand still."""
    tested = mode in {Mode.LOADING, Mode.UNLOADING}
    for age, of_the_leg in ((4, Fault.NONE), (5, Fault.STALE)):
        verdict = Bench().tick(mode, age=leg(age, 0, np.int64), counted_age=leg(0, 0, np.int64))
        assert verdict.faults == (of_the_leg if tested else Fault.NONE)
        assert Bench().tick(mode, age=leg(age, 0, np.int64)).faults == (
            Fault.STALE if age == 5 else Fault.NONE
        )
    assert Bench().tick(mode, legs_slipped=1 << 5).faults == (Fault.STALE if tested else Fault.NONE)


@pytest.mark.parametrize("mode", Mode)
def test_guard_faults_for_duplicate_nodes_and_changed_set_up(mode):
    judged = mode is Mode.IDLE or mode in POWERED
    for bits in (1, 1 << 5, 0b111111):
        assert Bench().tick(mode, doubled=bits).faults == (Fault.DUPLICATE_NODE if judged else Fault.NONE)
        assert Bench().tick(mode, altered=bits).faults == (Fault.SET_UP if judged else Fault.NONE)


@pytest.mark.parametrize("mode", Mode)
def test_guard_faults_for_refused_drive_frames_in_8_of_32_ticks(mode):
    bench = Bench()
    faults = [bench.tick(mode, rejected=2 * (n % 2)).faults for n in range(16)]
    assert faults == [Fault.NONE] * 15 + [Fault.REFUSED_FRAMES if mode in POWERED else Fault.NONE]
    bench.safety.reset()
    assert bench.tick(mode, rejected=1).faults == Fault.NONE
    bench = Bench()
    for before, rejected, sensors in ((Mode.IDLE, 1, 0), (mode, 3, 3)):
        for _ in range(7):
            tick = bench.tick(before, rejected=rejected, sensors_rejected=sensors)
            assert tick.faults == Fault.NONE, "rejected sensor frames must not count"
    verdict = bench.tick(mode, rejected=4, sensors_rejected=3)
    assert verdict.faults == (Fault.REFUSED_FRAMES if mode in POWERED else Fault.NONE)


def test_guard_stops_a_run_whose_virtual_clock_pauses_for_more_than_its_share():
    stood = 10_000_000
    for tick, allowed in ((0, 50), (4000, 550)):  # half a second, and 5 % of 4000 periods of 25 ms
        bench = Bench()
        verdicts = [bench.tick(tick=tick, stretched_ns=stood).stop for _ in range(allowed + 1)]
        assert verdicts == [Stop.NONE] * allowed + [Stop.STRETCHED]
        bench.safety.reset()
        assert not bench.tick(tick=tick, stretched_ns=stood).stop
    bench = Bench()
    for mode in OFF:
        assert not bench.tick(mode, tick=0, stretched_ns=10 * 500_000_000).stop
    assert bench.tick(tick=0).stop is Stop.STRETCHED


def test_guard_ignores_any_number_of_short_pauses_of_the_virtual_clock():
    bench = Bench()
    assert not any(bench.tick(stretched_ns=3_999_999).stop for _ in range(1000))
    stops = [bench.tick(tick=0, stretched_ns=4_000_000).stop for _ in range(126)]
    assert stops == [Stop.NONE] * 125 + [Stop.STRETCHED]


def test_guard_pushes_a_leg_with_frozen_reading_and_faults_if_it_does_not_move():
    limits = NONE._replace(watched_legs=63, length_noise_m=0.01, push_N=np.full(6, 8.0), push_ticks=2)
    bench = Bench(encoders=limits)
    astray, ready = leg(5.2, 5.0), leg(DriveState.READY, DriveState.RUN, np.int64)
    for q_d in (5.0, astray, astray):
        bench.tick(Mode.LOADING, q_d=q_d, drive_state=ready)
        assert not bench.record["probe_force"].any()
    verdicts = [bench.tick(q_d=q_d) for q_d in (5.0, *[astray] * 5)]
    np.testing.assert_allclose([v.tau[3] for v in verdicts[:5]], [0.0, 8.0, 8.0, 0.0, -8.0])
    assert [v.faults for v in verdicts] == [Fault.NONE] * 5 + [Fault.ENCODER]


def test_guard_warns_about_bus_errors_and_rejected_frames():
    bench = Bench()
    for cause in ("bus_errors", "bus_overflow", "sends_failed"):
        assert bench.tick(**{cause: 1}).warnings == Warn.BUS
    assert bench.tick().warnings == Warn.NONE
    for mode in (Mode.WAITING, Mode.TRACKING):
        assert Bench().tick(mode, rejected=1).warnings == Warn.REJECTED


def test_guard_warns_about_late_ticks_and_separately_about_8_late_ticks_in_32():
    bench = Bench()
    late, on_time, apart = PERIOD_NS // 5 + 1, PERIOD_NS // 5, PERIOD_NS // 10
    assert bench.tick(lateness_ns=on_time).warnings == Warn.NONE
    assert bench.tick(lateness_ns=-PERIOD_NS, sync_skew_ns=apart).warnings == Warn.NONE
    assert Bench().tick(sync_skew_ns=apart + 1).warnings == Warn.LATE
    for _ in range(7):
        assert bench.tick(lateness_ns=late).warnings == Warn.LATE
    assert bench.tick(lateness_ns=late).warnings == Warn.LATE | Warn.DEGRADED
    for _ in range(24):
        assert bench.tick().warnings == Warn.DEGRADED
    assert bench.tick().warnings == Warn.NONE
    for _ in range(8):
        bench.tick(lateness_ns=late)
    bench.safety.reset()
    assert bench.tick().warnings == Warn.NONE


@pytest.mark.parametrize(("skipped", "degraded"), [(7, 0), (8, 24), (31, 24), (10**9, 24)])
def test_guard_counts_skipped_periods_as_late_for_32_ticks(skipped, degraded):
    bench = Bench()
    bench.tick(skipped=31)
    for _ in range(32):
        bench.tick()
    found = [bench.tick(skipped=skipped).warnings, *(bench.tick().warnings for _ in range(30))]
    assert found == [Warn.DEGRADED] * degraded + [Warn.NONE] * (31 - degraded)


def test_guard_requests_a_stop_after_the_set_number_of_missed_periods():
    bench = Bench()
    no, missed = Stop.NONE, Stop.MISSED
    assert [bench.tick(skipped=n).stop for n in (4, 0, 4, 1, 0, 5)] == [no, no, no, missed, no, missed]
    assert bench.tick(skipped=5).faults == Fault.NONE
    for mode in OFF:
        assert not Bench().tick(mode, skipped=9).stop
    bench.tick(skipped=4)
    bench.safety.reset()
    assert not bench.tick(skipped=4).stop
    bench = Bench(LIMITS.model_copy(update={"missed_stop_ticks": 7}), drive_force_limit=1e6)
    assert [bench.tick(skipped=n).stop for n in (6, 0, 5, 2)] == [0, 0, 0, Stop.MISSED]


def test_guard_warns_about_recorder_loss_and_stops_if_configured():
    bench = Bench(on_recorder_loss="continue")
    dropped = [bench.tick(recorder_dropped=n).warnings for n in (0, 3, 3, 4)]
    assert dropped == [Warn.NONE, Warn.RECORDER, Warn.NONE, Warn.RECORDER]
    bench.safety.reset()
    assert bench.tick(recorder_dropped=4).warnings == Warn.NONE
    assert bench.tick(recorder_dropped=5).warnings == Warn.RECORDER
    dead = bench.tick(recorder_alive=False, recorder_dropped=5)
    assert (dead.warnings, dead.stop, dead.faults) == (Warn.RECORDER, Stop.NONE, Fault.NONE)
    strict = Bench(on_recorder_loss="stop")
    assert strict.tick(recorder_alive=False).stop is Stop.RECORDER
    assert strict.tick(recorder_alive=False, skipped=9).stop is Stop.RECORDER, "the recorder loss is reported"
    assert not strict.tick(recorder_alive=True).stop
    assert strict.tick(recorder_alive=True, recorder_dropped=9).stop
    assert not strict.tick(Mode.PARKED, recorder_alive=False).stop
    assert Bench().tick(recorder_alive=False).stop is Stop.NONE
    assert [b.safety.stops_unrecorded for b in (strict, bench, Bench())] == [True, False, False]


UNSURE = {"fusion_warnings": Warn.ENCODER, "fusion_faults": Fault.UNCERTAIN}


@pytest.mark.parametrize("mode", Mode)
def test_guard_warns_about_an_uncertain_filter_and_faults_for_it_while_powered(mode):
    verdict = Bench().tick(mode, **UNSURE, condition=60.0, bus_errors=1)
    assert verdict.warnings == Warn.ENCODER | Warn.BUS
    assert verdict.faults == (Fault.UNCERTAIN | Fault.CONDITION if mode in POWERED else Fault.NONE)
