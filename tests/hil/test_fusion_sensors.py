"""When the filter takes samples, which sensors it misses, and from which forces it goes on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.compiled.compiler import kernel, record
from drivers.config import ImuSettings
from drivers.signals import DriveState, Fault, Warn
from drivers.tick_columns import TICK
from hil.config.estimation import FusionSettings
from hil.contracts.records import altered, record_of
from hil.estimation.external_wrench import SENSOR_PATIENCE, ExternalWrench
from hil.estimation.fusion import SILENT_SAMPLES, FusedEstimator
from hil.estimation.fusion_layout import FUSION, KEPT
from hil.estimation.fusion_tick import judge
from hil.robot.dynamics import Model
from tests import sensed
from tests.hil.test_fusion import (
    LEGS,
    LOOSE,
    LOOSE_LEGS,
    MS,
    PLATFORM,
    TRACKER,
    ZERO,
    Fused,
    T,
    Truth,
    estimator,
    legs,
    measurement,
)
from tests.sensed import Readings, Sample

PATIENCE = round(SILENT_SAMPLES / TRACKER.rate_Hz / T)
"""Ticks without a sample of use until the tracker is missed."""


@pytest.mark.parametrize("stamped", [3, 4, 5, 6, 7])
@pytest.mark.parametrize("offset_s", [-4e-4, 0.0, 4e-4])
def test_a_sample_that_is_stamped_with_a_tick_that_the_loop_skipped_is_taken_at_its_own_instant(
    stamped, offset_s
):
    """A platform that moves at 1 m/s, and ticks 4 to 6 are left out."""
    start = Truth(4)
    velocity = np.array([1.0, -0.5, 0.25])
    found = estimator(LOOSE, LOOSE_LEGS, start)
    seen = None
    for tick in (1, 2, 3, 7, 8):
        p = start.p + velocity * tick * T
        then = start.p + velocity * (stamped * T + offset_s)
        samples = (Sample(stamped, offset_s, (*then, *start.R.as_rotvec())),) if tick == 8 else ()
        twist = np.concatenate((velocity, np.zeros(3)))
        seen = Fused(found, tick, measurement(*legs(p, start.R, twist)), Readings(tracker=samples))
    assert seen is not None
    assert seen["tracker"] == 1
    assert np.abs(seen["innovation_tracker"]).max() < 3e-4


def silent_for(tracker: Any, imu: Any, ticks: int = 2 * PATIENCE) -> list[tuple[int, bool]]:
    """Return since how many ticks nothing of use came of the tracker, and whether a sensor is missed."""
    truth = Truth(7)
    both = FusedEstimator(
        PLATFORM, Model(PLATFORM), FusionSettings(), LEGS, TRACKER, ImuSettings(rate_Hz=200.0), T
    )
    both.start(0, 0, truth.p, truth.R.as_matrix())
    m = measurement(*legs(truth.p, truth.R, ZERO))
    seen = []
    for tick in range(1, ticks):
        readings = Readings(tracker=tracker(tick, truth), imu=imu(tick, truth))
        health = Fused(both, tick, m, readings).health
        seen.append((round(health.gap_s / T), health.missed))
    return seen


def tracked(off_m: float) -> Any:
    """Return samples of a tracker every 5 ms that is off by so much."""

    def samples(tick: int, truth: Truth) -> tuple[Sample, ...]:
        pose = (*(truth.p + off_m), *truth.R.as_rotvec())
        return (Sample(tick - 1, 0.0, pose),) if tick % 5 == 0 else ()

    return samples


def still(tick: int, truth: Truth) -> tuple[Sample, ...]:
    """Return samples of an IMU at rest, every 5 ms."""
    at_rest = (0.0, 0.0, 0.0, *truth.R.inv().apply(-PLATFORM.gravity))
    return (Sample(tick - 1, 5e-4, at_rest),) if tick % 5 == 0 else ()


def silent(_tick: int, _truth: Truth) -> tuple[Sample, ...]:
    return ()


@pytest.mark.parametrize("imu", [still, silent])
@pytest.mark.parametrize("tracker", [tracked(0.05), silent], ids=["refused", "silent"])
def test_a_tracker_that_is_of_no_use_is_missed_whatever_the_imu_does(tracker, imu):
    seen = silent_for(tracker, imu)
    assert seen == [(tick, tick > PATIENCE) for tick in range(1, 2 * PATIENCE)]


def test_an_imu_that_is_silent_is_missed_beside_a_tracker():
    seen = silent_for(tracked(0.0), silent)
    assert seen == [(tick % 5, tick > PATIENCE) for tick in range(1, 2 * PATIENCE)]


def test_sensors_that_are_heard_are_not_missed():
    assert not any(missed for _, missed in silent_for(tracked(0.0), still))


def force(found: FusedEstimator) -> Any:
    """Return the forces (6,) N from which the acceleration of the last interval was found; None: it was not."""
    now = int(found.record["newest"])
    u, x = found._steps[now], found._steps[now - 1]["x"]
    if not u["influence"].any():
        return None
    at_rest = Model(PLATFORM).forward_dynamics(x[0:3], x[3:12].reshape(3, 3), x[12:18], ZERO)
    return np.linalg.solve(u["influence"], u["dtwist"] - at_rest)


def driven(forces: Any, ages: Any = 0, blind: Any = 0) -> Any:
    truth = Truth(0)
    m = measurement(*legs(truth.p, truth.R, ZERO))
    return altered(m, drive_force=forces, drive_state=[DriveState.RUN] * 6, age=ages, blind=blind)


def test_an_interval_has_the_mean_of_the_forces_at_its_ends():
    found = estimator()
    forces = []
    said = [np.arange(6.0), -2.0 * np.arange(6.0), np.full(6, 10.0)]
    for tick, tau in enumerate(said, 1):
        sensed.update(found, altered(driven(tau), tick=tick), tick * MS, Readings(), ZERO, ZERO)
        forces.append(force(found))
    expected = [said[0], -0.5 * np.arange(6.0), 5.0 - np.arange(6.0)]
    np.testing.assert_allclose(forces, expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_without_an_encoder_that_speaks_is_believed_its_force_and_a_silent_one_gets_its_command(
    leg,
):
    found = estimator()
    other = (leg + 1) % 6
    ages = [7 * (i in {leg, other}) for i in range(6)]
    blind = [int(i == leg) for i in range(6)]
    tick = altered(driven(np.arange(6.0) + 1.0, ages, blind), tick=1)
    sensed.update(found, tick, MS, Readings(), np.full(6, 50.0), ZERO)
    expected = [50.0 if i == other else i + 1.0 for i in range(6)]
    np.testing.assert_allclose(force(found), expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("state", [DriveState.READY, DriveState.OFF, DriveState.FAULT])
def test_with_one_brake_that_is_not_open_no_force_carries_the_pose_on_and_every_leg_is_believed(leg, state):
    """A shut brake takes what the model would make of the forces, and the mean of them begins anew."""
    found, forces = estimator(), []
    states = [state if i == leg else DriveState.RUN for i in range(6)]
    for number, drives in enumerate(([DriveState.RUN] * 6, states, [DriveState.RUN] * 6), 1):
        tick = altered(driven(np.full(6, 10.0 * number)), tick=number, drive_state=drives)
        sensed.update(found, tick, number * MS, Readings(), ZERO, ZERO)
        interval = found._steps[found.record["newest"]]
        shut = drives is states
        assert (interval["used"] == (KEPT if shut else 1)).all()
        assert not (shut and interval["dtwist"].any())
        forces.append(force(found))
    assert forces[1] is None
    np.testing.assert_allclose(forces[::2], [[10.0] * 6, [30.0] * 6], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("odd", ["", "brake", "leg", "leg that is silent"])
@pytest.mark.parametrize("leg", [0, 5])
def test_what_stands_on_shut_brakes_has_lost_its_speed_within_the_interval(odd, leg):
    """5 mm/s of one leg that is heard is a motion; what was read last of a silent one is none."""
    found, at = estimator(), np.arange(6) == leg
    twist = np.array([0.1, -0.2, 0.3, -0.4, 0.5, -0.6])
    found._steps[found.record["newest"]]["x"][12:18] = twist
    states = np.where(at & (odd == "brake"), int(DriveState.RUN), int(DriveState.READY))
    rates, ages = 5e-3 * (at & ("leg" in odd)), 1 * (at & ("silent" in odd))
    tick = altered(driven(np.zeros(6)), tick=1, drive_state=states, rate=rates, age=ages)
    sensed.update(found, tick, MS, Readings(), ZERO, ZERO)
    stands = odd in {"", "leg that is silent"}
    lost = found._steps[found.record["newest"]]["dtwist"] * T
    np.testing.assert_allclose(lost, -twist if stands else np.zeros(6), rtol=1e-12)
    assert force(found) is None


def test_a_filter_that_begins_anew_knows_of_no_slip_no_contradiction_and_no_force_of_before():
    found, fresh, truth = estimator(), estimator(), Truth(5)
    for tick in range(1, 4):
        sensed.update(found, altered(driven(np.ones(6)), tick=tick), tick * MS, Readings(), ZERO, ZERO)
    for name, leg in (("slipped", 2), ("against", 1), ("left_out", 4)):
        found.record[name][leg] = 2
    for each in (found, fresh):
        each.start(50, 50 * MS, truth.p, truth.R.as_matrix())
    assert not found.record["slipped"].any()
    for name in ("newest", "count", "driven", "left_out", "against", "heard"):
        np.testing.assert_array_equal(found.record[name], fresh.record[name], name)
    for name in ("tick", "latched_ns", "x"):
        np.testing.assert_array_equal(found._steps[0][name], fresh._steps[0][name])
    np.testing.assert_array_equal(found._covariances[0], fresh._covariances[0])


def test_a_filter_that_begins_anew_is_turned_as_its_new_pose():
    """What turns with the platform is turned by the last attitude: nothing is left of the run before."""
    found = estimator()
    for seed in (1, 2):
        R = Truth(seed).R.as_matrix() @ np.diag([1.0, -1.0, -1.0] if seed == 2 else [1.0, 1.0, 1.0])
        found.start(0, 0, Truth(seed).p, R)
        np.testing.assert_array_equal(found.record["R"], R)


judge_tick = kernel(record(FUSION), record(TICK))(judge)


def judged(lost: int | None = None, **found: Any) -> tuple[FusedEstimator, Any]:
    """The filter and the tick after a tick of which it has found this; leg 2 may be lost."""
    settings = FusionSettings(may_lose_legs=[2])
    fused = FusedEstimator(PLATFORM, Model(PLATFORM), settings, LEGS, TRACKER, None, T)
    fused.record["position_std_m"] = 1e-4
    fused.record["lost"] = 0 if lost is None else 1 << lost
    for name, value in found.items():
        fused.record[name] = value
    tick = record_of(tick=1)
    judge_tick(fused.record, tick)
    return fused, tick


@pytest.mark.parametrize("missed", [False, True])
@pytest.mark.parametrize("leg", [None, 2, 4])
def test_a_missed_sensor_and_a_lost_encoder_are_each_warned_of_beside_the_other(leg, missed):
    _, tick = judged(leg, missed=missed)
    encoder, sensor = Warn.NONE if leg is None else Warn.ENCODER, Warn.SENSOR if missed else Warn.NONE
    assert Warn(int(tick["fusion_warnings"])) == encoder | sensor


@pytest.mark.parametrize(("leg", "alone"), [(None, False), (2, True), (4, False)])
def test_the_tracker_holds_the_pose_only_where_a_leg_is_lost_without_which_the_run_goes_on(leg, alone):
    found, tick = judged(leg, gap_s=0.2)
    assert found.record["alone_s"] == (0.2 if alone else 0.0)
    assert Fault(int(tick["fusion_faults"])) == (Fault.UNCERTAIN if alone else Fault.NONE)


@pytest.mark.parametrize(("rate_Hz", "period_s"), [(100.0, 1e-3), (1000.0, 1e-3), (400.0, 4e-3)])
def test_a_wrench_sensor_is_late_once_it_has_left_out_samples_of_its_own_rate(rate_Hz, period_s):
    wrench = ExternalWrench(None, rate_Hz, period_s)
    wrench._record["read_at"] = 10
    late = []
    for tick in range(10, 60):
        late.append(wrench.fill(record_of(tick=tick), fusing=False))
    patience = SENSOR_PATIENCE / rate_Hz / period_s
    assert late == [tick - 10 > patience + 1e-9 for tick in range(10, 60)]
