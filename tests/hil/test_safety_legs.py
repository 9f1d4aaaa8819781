"""Safety checks each leg by its own values and the certificate by its weights, and remembers earlier
ticks.
"""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Mode, Stop, Warn
from hil.safety import Safety
from hil.safety.certificate import Watch
from tests.hil.encoder_bench import BOTH_SIGNS
from tests.hil.safety_bench import LIMITS, OFF, RATE_HZ, Bench
from tests.hil.safety_bench import leg as on_leg_3

ON_EACH_LEG = pytest.mark.parametrize("leg", range(6))
LAST_N = np.array([10.0, -20.0, 30.0, -40.0, 50.0, -60.0])


@BOTH_SIGNS
@pytest.mark.parametrize("limit", ["force_step_N", "force_window_N"])
def test_step_and_window_limits_use_the_forces_of_the_same_leg(limit, sign):
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
def test_a_leg_beyond_a_hard_end_or_a_drive_out_of_run_faults_on_any_leg(leg):
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


# -- the certificate

T = 1.0 / RATE_HZ
LATE_s = 4e-3
"""Late enough to count as motion, but not enough for a late tick."""


def watching(disturbance):
    """Bench with V = 9 e^2 + 4 e de + 4 de^2 and a level that neither grows nor decays.

    The law demands an acceleration that no reference has.
    """
    table = np.zeros((12, 6))
    table[0] = 1e3
    table[2], table[3], table[4] = 9.0, 2.0, 4.0
    table[5] = disturbance
    table[8] = 1.0
    table[11] = [0.0, 0.0, 1.0, 1.0, 1.0, T]
    return Bench(watch=Watch(table, 3))


def test_certificate_weights_errors_of_length_and_of_rate_separately():
    bench = watching(disturbance=1e3)
    assert bench.tick(q=on_leg_3(4.5, 5.0), dq=on_leg_3(-0.25)).certificate[0] == pytest.approx(
        2.25 + 0.5 + 0.25
    )
    assert bench.tick(q=on_leg_3(4.5, 5.0), dq=on_leg_3(0.25)).certificate[0] == pytest.approx(
        2.25 - 0.5 + 0.25
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_certificate_bound_weights_lateness_by_speed_and_by_acceleration(sign):
    """sqrt(P_11) = 3 times 2 m/s, sqrt(P_22) = 2 times 3 m/s^2 and a disturbance of 50 m/s^2."""
    bench = watching(disturbance=on_leg_3(50.0, 1e3))
    moving = {"dq_d": on_leg_3(sign * 2.0), "dq": on_leg_3(sign * 1.5), "ddq_d": on_leg_3(sign * -3.0)}
    bench.tick(**moving)
    share = bench.tick(**moving, lateness_ns=round(1e9 * LATE_s)).certificate[3]
    assert share == pytest.approx(1.0 / (1.0 + LATE_s * (3.0 * 2.0 + 2.0 * (3.0 + 50.0))))


def accelerated(tick):
    """Reference after some ticks at 40 m/s^2, from 2 m/s on: its rate grows by 1 m/s per tick."""
    s = tick * T
    return {
        "q_d": on_leg_3(5.0 + 2.0 * s + 20.0 * s**2, 5.0),
        "dq_d": on_leg_3(2.0 + 40.0 * s),
        "ddq_d": on_leg_3(40.0),
    }


@pytest.mark.parametrize(
    ("changed", "by"), [("q_d", 0.99), ("q_d", 1.01), ("q_d", -1.01), ("dq_d", 0.99), ("dq_d", 1.01)]
)
def test_certificate_measures_a_reference_jump_against_the_rates_of_the_reference(changed, by):
    """A disturbance of 8 m/s^2 allows 0.2 m/s within a tick, and 5 mm."""
    bench = watching(disturbance=8.0)
    for tick in range(3):
        told = bench.tick(**accelerated(tick), q=on_leg_3(5.0, 5.0)).certificate
        assert np.isfinite(told[2]) == (tick > 0)
    moved = accelerated(3)
    moved[changed] = moved[changed] + on_leg_3(by * {"q_d": T * T * 8.0, "dq_d": T * 8.0}[changed])
    if changed == "dq_d":
        moved["q_d"] = moved["q_d"] + on_leg_3(0.5 * T * by * T * 8.0)
    assert np.isfinite(bench.tick(**moved).certificate[2]) == (abs(by) < 1.0)


# -- what is remembered


ON_EACH_OFF = pytest.mark.parametrize("mode", OFF)

# -- what bus, loop and recorder did while the drives were off counts from the tick on that powers them


@ON_EACH_OFF
def test_frames_that_could_not_be_sent_before_power_up_count_for_the_bus_fault(mode):
    bench = Bench()
    for _ in range(4):
        verdict = bench.tick(mode, sends_failed=1)
        assert (verdict.faults, verdict.warnings) == (Fault.NONE, Warn.BUS)
    assert bench.tick(Mode.LOADING, sends_failed=1).faults == Fault.BUS


@ON_EACH_OFF
def test_missed_periods_and_late_ticks_before_power_up_count_for_later_limits(mode):
    bench = Bench()
    assert bench.tick(mode, skipped=4).stop is Stop.NONE
    assert bench.tick(Mode.LOADING, skipped=1).stop is Stop.MISSED
    bench = Bench()
    for _ in range(7):
        assert bench.tick(mode, lateness_ns=9_000_000).warnings == Warn.LATE
    assert bench.tick(Mode.LOADING, lateness_ns=9_000_000).warnings == Warn.LATE | Warn.DEGRADED


@ON_EACH_OFF
def test_recorder_loss_before_power_up_does_not_count_later(mode):
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
def test_legs_at_rest_without_brakes_may_move_again_after_a_fault(mode):
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
def test_force_resumed_after_a_fault_is_clamped_to_the_force_limit(mode):
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


def test_resumed_force_is_sent_at_once_if_the_force_window_is_one_tick():
    bench = Bench(rate_Hz=1.0)
    bench.safety.resume(WITHIN)
    verdict = bench.tick(Mode.HELD, WITHIN)
    np.testing.assert_array_equal(verdict.tau, WITHIN)
    assert verdict.warnings == Warn.NONE
