"""The rules put together: which fault, which warning and which force come out of a tick, in which mode."""

from typing import NamedTuple

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.signals import DriveState, Fault, Foreign, Mode, Stop, Warn
from hil.config.limits import LimitSettings
from hil.contracts.records import record_of
from hil.safety import guard
from hil.safety.certificate import Watch
from hil.safety.encoder_limits import NONE
from tests.hil.encoder_bench import probed

POWERED = (
    *(Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING),
    *(Mode.PARKING, Mode.UNLOADING, Mode.HELD),
)
MOVING = POWERED[1:5]
FOLLOWING = POWERED[1:6]
CLOSED = (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
OFF = (Mode.WAITING, Mode.IDLE, Mode.PARKED, Mode.FAULT)
RATE_HZ = 40.0
"""A window of ten ticks."""
PERIOD_NS = 25_000_000
LIMITS = LimitSettings(
    force_N=100.0, force_step_N=50.0, force_window_N=80.0, speed_m_s=3.0, deceleration_m_s2=2.0,
    stroke_margin_m=1.0, following_error_m=0.25, following_error_s=0.5, standstill_m=0.125,
    consistency_m=1e-4, condition=50.0, stale_warn_ticks=2, stale_fault_ticks=5,
)  # fmt: skip


class Judged(NamedTuple):
    """A verdict, and what safety filled in."""

    warnings: Warn
    faults: Fault
    stop: Stop
    tau: Array
    certificate: tuple[float, ...]
    """V, its rate, its bound, its share."""
    tau_asked: Array


class Bench:
    """A Safety and a healthy tick in which single values can be changed; what it fills was something else."""

    def __init__(self, **options):
        settings = {"drive_force_limit": 1000.0, "length_min": 1.0, "length_max": 9.0, "rate_Hz": RATE_HZ}
        self.safety = guard.Safety(LIMITS, **{**settings, **options})
        self.record = record_of()

    def tick(self, mode=Mode.TRACKING, tau=0.0, **columns):
        healthy = {
            "mode": mode, "recorder_alive": 1, "tau_asked": tau, "condition": 2.0,
            "length": 5.0, "drive_state": DriveState.RUN, "age": 0, "counted_age": columns.get("age", 0),
            "q": 5.0, "R": np.eye(3), "J": np.eye(6), "q_d": 5.0, "R_d": np.eye(3),
            "tau": 77.0, "legs_moved": 0b111111,
        }  # fmt: skip
        tick = record_of(**{**healthy, **columns})
        verdict: guard.Verdict = probed(self.safety, tick, self.record)
        self.record, self.moved_m = tick, self.safety.moved_m(tick)
        certificate = tuple(float(tick[f"lyapunov{name}"]) for name in ("", "_rate", "_bound", "_share"))
        return Judged(*verdict, tick["tau"], certificate, tick["tau_asked"])


def leg(value, other=0.0, dtype=float):
    x = np.full(6, other, dtype)
    x[3] = value
    return x


@pytest.mark.parametrize("mode", Mode)
def test_guard_is_silent_in_a_healthy_tick(mode):
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
def test_guard_faults_for_this_reason_alone_while_powered_and_never_else(reason):
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
def test_guard_lets_pass_what_is_just_inside_the_limits(reason):
    for mode in POWERED:
        assert Bench().tick(mode, **NEARLY[reason]).faults == Fault.NONE


def test_guard_lets_buses_be_a_tenth_of_a_period_apart_or_as_configured():
    for given_us, limit_ns in ((None, 100_000), (37.5, 37_500)):
        limits = LIMITS.model_copy(update={"sync_skew_us": given_us})
        assert guard.Safety(limits, 1.0, 9.0, 1000.0, 1e6).limits["sync_skew_ns"] == limit_ns


def test_guard_two_reasons_are_two_faults():
    changes = {"hop": 2.0, "condition": 60.0, "bus_off": True, "tau": np.nan}
    verdict = Bench().tick(Mode.TRACKING, **changes)
    assert verdict.faults == Fault.ASSEMBLY | Fault.CONDITION | Fault.BUS | Fault.LAW


@pytest.mark.parametrize("mode", Mode)
def test_guard_watches_the_following_error_until_the_brakes_are_closed(mode):
    for q_d, dq_d in ((5.26, 0.0), (4.74, 0.0), (6.26, 2.0)):
        verdict = Bench().tick(mode, q_d=leg(q_d, 5.0), dq_d=leg(dq_d))
        assert verdict.faults == (Fault.FOLLOWING if mode in FOLLOWING else Fault.NONE)


def moved_legs(bench, mode, **columns):
    tick = bench.tick(mode, **columns)
    return tick.faults, int(bench.record["legs_moved"])


@pytest.mark.parametrize("mode", Mode)
def test_guard_watches_legs_on_closed_brakes_and_names_the_one_that_moves(mode):
    bench = Bench()
    assert moved_legs(bench, mode) == (Fault.NONE, 0)
    assert moved_legs(bench, mode, length=leg(5.125, 5.0)) == (Fault.NONE, 0)
    expected = (Fault.BRAKE, 0b001000) if mode in CLOSED else (Fault.NONE, 0)
    assert moved_legs(bench, mode, length=leg(4.87, 5.0)) == expected
    if mode in CLOSED:
        np.testing.assert_allclose(bench.moved_m, leg(0.13), atol=1e-12)


def test_guard_lets_a_force_come_back_at_once_and_limits_its_changes_from_there():
    bench = Bench()
    for _ in range(12):
        bench.tick(Mode.UNLOADING, 0.0)
    assert bench.tick(Mode.HELD, 90.0).tau[0] == 50.0, "a step"
    held = np.array([90.0, -90.0, 0.0, 95.0, 40.0, -10.0])
    bench.safety.resume(held)
    verdict = bench.tick(Mode.HELD, held)
    np.testing.assert_array_equal(verdict.tau, held)
    assert verdict.warnings == Warn.NONE
    np.testing.assert_array_equal(bench.tick(Mode.HELD, held - [81.0, 0, 0, 0, 0, 0]).tau[0], 40.0)
    low = bench.tick(Mode.HELD, held - [85.0, 0, 0, 0, 0, 0])
    assert low.tau[0] == 10.0, "the window of ten ticks begins at the force that came back"


@pytest.mark.parametrize("mode", CLOSED)
def test_guard_lets_legs_stand_elsewhere_after_they_were_free(mode):
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


def test_guard_watches_legs_after_a_fault_once_they_rested_for_a_fifth_of_a_second():
    bench = Bench()
    for _ in range(8):  # 0.2 s
        assert bench.tick(Mode.FAULT, length=5.0).faults == Fault.NONE
    assert bench.tick(Mode.FAULT, length=6.0).faults == Fault.NONE, "from here they stand"
    assert bench.tick(Mode.FAULT, length=6.2).faults == Fault.BRAKE
    assert bench.tick(Mode.FAULT, length=6.2, rate=leg(0.021)).faults == Fault.NONE, "it moves: no longer"
    for k in range(9):
        assert bench.tick(Mode.FAULT, length=5.0 + k).faults == Fault.NONE
    assert bench.tick(Mode.FAULT, length=6.0).faults == Fault.BRAKE


@pytest.mark.parametrize("mode", Mode)
def test_guard_warns_of_stale_legs_once_drives_should_talk(mode):
    for age, warns in ((1, False), (2, True), (4, True)):
        verdict = Bench().tick(mode, age=leg(age, 0, np.int64))
        expected = warns and mode not in {Mode.WAITING, Mode.IDLE}
        assert verdict.warnings == (Warn.STALE if expected else Warn.NONE)
        assert verdict.faults == Fault.NONE


@pytest.mark.parametrize("mode", MOVING)
def test_guard_faults_when_a_drive_leaves_run_but_not_while_drives_come_up(mode):
    bench = Bench()
    ready = leg(DriveState.READY, DriveState.RUN, np.int64)
    assert bench.tick(mode, drive_state=ready).faults == Fault.NONE
    assert bench.tick(mode, drive_state=ready).faults == Fault.NONE
    assert bench.tick(mode).faults == Fault.NONE
    assert bench.tick(mode, drive_state=ready).faults == Fault.DRIVE
    assert bench.tick(mode, drive_state=ready).faults == Fault.DRIVE
    assert bench.tick(Mode.PARKING, drive_state=ready).faults == Fault.NONE
    assert bench.tick(mode, drive_state=ready).faults == Fault.NONE


def test_guard_forgets_running_drives_on_reset_and_with_closed_brakes():
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


def test_guard_takes_five_refusals_in_a_row_or_eight_in_32_ticks_for_a_dead_bus():
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
def test_guard_takes_no_estimate_of_a_leg_where_its_brake_is_tested(mode):
    """The filter stands in for a leg that may be lost; on shut brakes it believes that all stand."""
    tested = mode in {Mode.LOADING, Mode.UNLOADING}
    for age, of_the_leg in ((4, Fault.NONE), (5, Fault.STALE)):
        verdict = Bench().tick(mode, age=leg(age, 0, np.int64), counted_age=leg(0, 0, np.int64))
        assert verdict.faults == (of_the_leg if tested else Fault.NONE)
        assert Bench().tick(mode, age=leg(age, 0, np.int64)).faults == (
            Fault.STALE if age == 5 else Fault.NONE
        )
    assert Bench().tick(mode, legs_slipped=1 << 5).faults == (Fault.STALE if tested else Fault.NONE)


@pytest.mark.parametrize("mode", Mode)
def test_guard_faults_for_a_doubled_node_and_another_set_up_once_the_drives_are_set_up(mode):
    judged = mode is Mode.IDLE or mode in POWERED
    for bits in (1, 1 << 5, 0b111111):
        assert Bench().tick(mode, doubled=bits).faults == (Fault.DUPLICATE_NODE if judged else Fault.NONE)
        assert Bench().tick(mode, altered=bits).faults == (Fault.SET_UP if judged else Fault.NONE)


@pytest.mark.parametrize("mode", Mode)
def test_guard_faults_for_refused_frames_of_the_drives_in_eight_ticks_of_32(mode):
    bench = Bench()
    faults = [bench.tick(mode, rejected=2 * (n % 2)).faults for n in range(16)]
    assert faults == [Fault.NONE] * 15 + [Fault.REFUSED_FRAMES if mode in POWERED else Fault.NONE]
    bench.safety.reset()
    assert bench.tick(mode, rejected=1).faults == Fault.NONE
    bench = Bench()
    for before, rejected, sensors in ((Mode.IDLE, 1, 0), (mode, 3, 3)):
        for _ in range(7):
            tick = bench.tick(before, rejected=rejected, sensors_rejected=sensors)
            assert tick.faults == Fault.NONE, "those of sensors do not count"
    verdict = bench.tick(mode, rejected=4, sensors_rejected=3)
    assert verdict.faults == (Fault.REFUSED_FRAMES if mode in POWERED else Fault.NONE)


def test_guard_stops_a_bench_whose_time_stood_still_for_more_than_its_share():
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


def test_guard_does_not_count_short_stretches_however_many():
    bench = Bench()
    assert not any(bench.tick(stretched_ns=3_999_999).stop for _ in range(1000))
    stops = [bench.tick(tick=0, stretched_ns=4_000_000).stop for _ in range(126)]
    assert stops == [Stop.NONE] * 125 + [Stop.STRETCHED]


def test_guard_pushes_a_leg_that_stands_still_and_faults_for_one_that_is_held_fast():
    limits = NONE._replace(watched_legs=63, length_noise_m=0.01, push_N=np.full(6, 8.0), push_ticks=2)
    bench = Bench(encoders=limits)
    astray, ready = leg(5.2, 5.0), leg(DriveState.READY, DriveState.RUN, np.int64)
    for q_d in (5.0, astray, astray):
        bench.tick(Mode.LOADING, q_d=q_d, drive_state=ready)
        assert not bench.record["probe_force"].any()
    verdicts = [bench.tick(q_d=q_d) for q_d in (5.0, *[astray] * 5)]
    np.testing.assert_allclose([v.tau[3] for v in verdicts[:5]], [0.0, 8.0, 8.0, 0.0, -8.0])
    assert [v.faults for v in verdicts] == [Fault.NONE] * 5 + [Fault.ENCODER]


def test_guard_warns_of_a_noisy_bus_and_of_rejected_frames():
    bench = Bench()
    for cause in ("bus_errors", "bus_overflow", "sends_failed"):
        assert bench.tick(**{cause: 1}).warnings == Warn.BUS
    assert bench.tick().warnings == Warn.NONE
    for mode in (Mode.WAITING, Mode.TRACKING):
        assert Bench().tick(mode, rejected=1).warnings == Warn.REJECTED


def test_guard_warns_of_late_ticks_and_of_eight_in_32():
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
def test_guard_counts_skipped_periods_as_late_ticks_until_32_later_ones(skipped, degraded):
    bench = Bench()
    bench.tick(skipped=31)
    for _ in range(32):
        bench.tick()
    found = [bench.tick(skipped=skipped).warnings, *(bench.tick().warnings for _ in range(30))]
    assert found == [Warn.DEGRADED] * degraded + [Warn.NONE] * (31 - degraded)


def test_guard_asks_for_a_stop_after_as_many_missed_periods_as_configured():
    bench = Bench()
    no, missed = Stop.NONE, Stop.MISSED
    assert [bench.tick(skipped=n).stop for n in (4, 0, 4, 1, 0, 5)] == [no, no, no, missed, no, missed]
    assert bench.tick(skipped=5).faults == Fault.NONE
    for mode in OFF:
        assert not Bench().tick(mode, skipped=9).stop
    bench.tick(skipped=4)
    bench.safety.reset()
    assert not bench.tick(skipped=4).stop
    limits = LIMITS.model_copy(update={"missed_stop_ticks": 7})
    bench.safety = guard.Safety(limits, 1.0, 9.0, RATE_HZ, 1e6)
    assert [bench.tick(skipped=n).stop for n in (6, 0, 5, 2)] == [0, 0, 0, Stop.MISSED]


def test_guard_warns_of_a_lossy_recorder_and_stops_without_one_if_so_configured():
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
    assert strict.tick(recorder_alive=False, skipped=9).stop is Stop.RECORDER, "slower is no cure"
    assert not strict.tick(recorder_alive=True).stop
    assert strict.tick(recorder_alive=True, recorder_dropped=9).stop
    assert not strict.tick(Mode.PARKED, recorder_alive=False).stop
    assert Bench().tick(recorder_alive=False).stop is Stop.NONE
    assert [b.safety.stops_unrecorded for b in (strict, bench, Bench())] == [True, False, False]


def test_guard_limits_the_step_from_the_last_force_sent():
    bench = Bench()
    for asked, sent in ((60.0, 50.0), (55.0, 55.0), (0.0, 5.0), (-45.0, -25.0)):  # the last one by the window
        verdict = bench.tick(tau=leg(asked))
        np.testing.assert_array_equal(verdict.tau, leg(sent))
        assert bool(verdict.warnings & Warn.FORCE_STEP) == (asked in {60.0, 0.0})


def test_guard_warns_of_each_limit_by_name():
    wide = {"force_N": 100.0, "force_step_N": 1e6, "force_window_N": 1e6}
    for name, warn in (
        ("force_N", Warn.FORCE_LIMIT),
        ("force_step_N", Warn.FORCE_STEP),
        ("force_window_N", Warn.FORCE_WINDOW),
    ):
        limits = LIMITS.model_copy(update={**wide, "force_N": 1e6, name: 100.0})
        safety = Bench()
        safety.safety = guard.Safety(limits, 1.0, 9.0, RATE_HZ, 1e6)
        assert safety.tick(tau=leg(100.0)).warnings == Warn.NONE
        safety.safety.reset()
        verdict = safety.tick(tau=leg(-100.5))
        assert verdict.warnings == warn
        np.testing.assert_array_equal(verdict.tau, leg(-100.0))


def test_guard_asks_no_more_than_the_drives_can_give():
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
    """Ask for 100 N from zero and return the forces sent; the window allows 80 N."""
    return [float(bench.tick(tau=leg(sign * 100.0)).tau[3]) for _ in range(13)]


def test_guard_window_is_250_ms_long_up_and_down_and_one_tick_at_least():
    bench = Bench()
    # from the zero before the first tick: 50 by the step, then 80 until that zero is ten ticks old and gone
    assert climb(bench) == [50.0] + [80.0] * 9 + [100.0] * 3
    down = [float(bench.tick(tau=leg(-100.0)).tau[3]) for _ in range(12)]
    assert down == [50.0] + [20.0] * 9 + [-30.0] + [-60.0]
    assert climb(Bench(rate_Hz=1.0))[:3] == [50.0, 100.0, 100.0]


def test_guard_window_runs_on_through_skipped_periods_at_the_force_held():
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
def test_guard_window_starts_anew_in_every_part_of_it(sign):
    bench = Bench(rate_Hz=160.0)
    for _ in range(15):
        bench.tick(tau=leg(sign * 30.0))
    bench.tick(Mode.IDLE)
    sent = [sign * bench.tick(tau=leg(sign * 100.0)).tau[3] for _ in range(30)]
    assert sent == [50.0] + [80.0] * 29


def test_guard_window_counts_the_last_tick():
    bench = Bench()
    limits = LIMITS.model_copy(update={"force_step_N": 1e6})
    bench.safety = guard.Safety(limits, 1.0, 9.0, RATE_HZ, 1e6)
    assert [float(bench.tick(tau=leg(a)).tau[3]) for a in (70.0, -30.0, -30.0)] == [70.0, -10.0, -10.0]


@pytest.mark.parametrize("mode", OFF)
def test_guard_starts_from_zero_force_after_the_drives_were_off(mode):
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


def test_guard_sends_no_force_when_the_law_fails_and_what_was_asked_stays_as_it_was():
    bench = Bench()
    bench.tick(tau=leg(40.0))
    verdict = bench.tick(tau=leg(np.nan, 40.0))
    assert verdict.faults == Fault.LAW
    np.testing.assert_array_equal(verdict.tau, np.zeros(6))
    np.testing.assert_array_equal(bench.tick(tau=leg(1000.0)).tau_asked, leg(1000.0))


def test_guard_repeats_to_the_bit_after_reset():
    bench = Bench()
    inputs = [(float(100 * np.sin(k)), k % 7 == 0, k % 5) for k in range(60)]

    def run():
        out = [bench.tick(tau=leg(a), bus_off=b, skipped=c) for a, b, c in inputs]
        return [(v.tau.tobytes(), v.warnings, v.faults, v.stop) for v in out]

    first = run()
    bench.safety.reset()
    assert run() == first


UNSURE = {"fusion_warnings": Warn.ENCODER, "fusion_faults": Fault.UNCERTAIN}


@pytest.mark.parametrize("mode", Mode)
def test_guard_passes_on_warnings_of_the_filter_and_faults_while_powered(mode):
    verdict = Bench().tick(mode, **UNSURE, condition=60.0, bus_errors=1)
    assert verdict.warnings == Warn.ENCODER | Warn.BUS
    assert verdict.faults == (Fault.UNCERTAIN | Fault.CONDITION if mode in POWERED else Fault.NONE)


# -- the certificate: V = 4 (de + e)^2 of each axis, which may not grow at all

POSE, ACTION = 0, 3
UNUSED = {"legs_used": 0b011111, "unseen": 1}
WARN, FAULT = 1.0, 2.0
CLEAN = [np.nan, np.nan, np.nan, np.nan]


def certified(action=WARN, ticks=3, **options):
    table = np.zeros((12, 6))
    table[2:5] = 4.0  # P_11, P_12, P_22
    table[5] = 1e3  # disturbance: the reference may jump by 25 m/s
    table[6], table[8] = 1e-6, 1.0  # noise, decay
    table[11] = [0.0, 0.0, 1.0, action, 1.0, 1.0 / RATE_HZ]
    for name, value in options.items():
        row, axis = {"pose": (11, 0), "confirm": (11, 4), "disturbance": (5, 3)}[name]
        table[row, axis] = value
    return Bench(watch=Watch(table, ticks))


def figures(bench, mode=Mode.TRACKING, de=0.0, **changes):
    return bench.tick(mode, dq=leg(-de), **changes)


def broken(bench, **changes):
    return bool(figures(bench, **changes).warnings & Warn.CERTIFICATE)


def test_guard_watches_nothing_without_a_certificate():
    bench = Bench()
    for mode in Mode:
        np.testing.assert_array_equal(figures(bench, mode).certificate, CLEAN)


@pytest.mark.parametrize("mode", Mode)
def test_guard_watches_the_certificate_while_the_law_moves_the_platform(mode):
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
def test_guard_warns_or_faults_where_the_certificate_is_broken(action, warning, fault):
    bench = certified(action)
    for de, told in ((0.5, False), (0.4, False), (0.6, True), (0.3, False)):
        verdict = figures(bench, de=de, bus_errors=1, condition=60.0)
        assert verdict.warnings == Warn.BUS | (warning if told else Warn.NONE)
        assert verdict.faults == Fault.CONDITION | (fault if told else Fault.NONE)
    assert not figures(certified(action), bus_off=True).faults & Fault.CERTIFICATE


def test_guard_watches_no_platform_on_its_brakes():
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
def test_guard_watches_the_certificate_anew_after_a_disturbed_tick(changes):
    bench = certified()
    assert not broken(bench)
    assert not broken(bench, de=0.5, **changes)
    assert np.isnan(figures(bench, de=0.5, **changes).certificate[2:]).all()
    for all_used in ({}, {"legs_used": 0b111111, "unseen": 0}):
        bench = certified()
        figures(bench, **all_used)
        assert broken(bench, de=0.5, **all_used)


def test_guard_takes_the_time_of_skipped_ticks_into_the_rate_of_V():
    bench = certified()
    figures(bench)
    assert figures(bench, de=0.5, skipped=3).certificate[1] == pytest.approx(1.0 * RATE_HZ / 4)


@pytest.mark.parametrize("late_ns", [-4_000_000, 4_000_000])
def test_guard_allows_a_certificate_what_a_late_tick_makes_of_motion(late_ns):
    """2 m/s and up to 100 m/s^2 for 4 ms are 8 mm and 0.4 m/s, W = 2 (e + de)."""
    moving = {"dq_d": leg(2.0), "lateness_ns": late_ns}
    bench = certified(disturbance=100.0)
    figures(bench, de=-2.0, dq_d=leg(2.0))
    at = 0.408
    assert not broken(bench, de=-2.0 + 0.999 * at, **moving)
    assert broken(bench, de=-2.0 + 1.01 * at, **moving)


@pytest.mark.parametrize("changes", [{"age": leg(1, 0, np.int64)}, UNUSED])
def test_guard_compares_no_error_to_one_that_was_an_estimate(changes):
    bench = certified()
    figures(bench)
    figures(bench, **changes)
    assert not broken(bench, de=0.5)
    assert not broken(bench, de=0.5)
    assert broken(bench, de=0.8)


def test_guard_waits_for_the_forces_of_the_law_also_where_a_leg_is_stale():
    bench = certified(ticks=4)
    figures(bench)
    figures(bench, tau=leg(1000.0))
    ages = [leg(age, 0, np.int64) for age in (0, 1, 0, 0, 0, 0)]
    judged = [bool(np.isfinite(figures(bench, age=age).certificate[2])) for age in ages]
    assert judged == [False] * 4 + [True] * 2


def test_guard_does_not_judge_the_law_by_forces_that_a_limit_changed():
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
    assert broken(bench, de=0.8), "a reset forgets it"


def test_guard_takes_the_errors_of_the_pose_for_a_law_in_pose_space():
    bench = certified(pose=1.0)
    pushed = {"p_d": np.array([0.0, 0.0, 0.5]), "q": leg(5.1, 5.0)}
    assert bench.tick(**pushed).certificate[0] == pytest.approx(4 * 0.25)
    assert bench.safety.watches_pose
    bench = certified()
    assert bench.tick(**pushed).certificate[0] == pytest.approx(4 * 0.01)
    assert not bench.safety.watches_pose
    assert not Bench().safety.watches_pose


def test_guard_names_the_axes_that_break_the_certificate_for_as_long_as_is_asked():
    assert Bench().safety.broken_axes() == ()
    bench = certified(confirm=2.0)
    named = []
    for de in (0.5, 0.6, 0.9, 1.4, 0.1):
        figures(bench, de=de)
        named.append(bench.safety.broken_axes())
    assert named == [(), (), (3,), (3,), ()]
