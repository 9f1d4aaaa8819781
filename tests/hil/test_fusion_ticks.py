"""Intervals of the filter: times of samples and forces, missing sensors, and warnings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.compiled.compiler import MATRIX, kernel, record
from drivers.compiled.pointed import context_of
from drivers.sensing.settings import ImuSettings, TrackerSettings
from drivers.signals import DriveState
from drivers.tick_columns import TICK, part
from hil.config.estimation import FusionSettings
from hil.contracts.records import altered, record_of
from hil.estimation.external_wrench import SENSOR_PATIENCE, ExternalWrench
from hil.estimation.fusion import SILENT_SAMPLES, FusedEstimator
from hil.estimation.fusion_kernels import fill_estimate
from hil.estimation.fusion_layout import FUSION, KEPT, STEP, LegErrors
from hil.robot.dynamics import Model
from tests import sensor_samples
from tests.hil.fusion_bench import (
    LEGS,
    LOOSE,
    LOOSE_LEGS,
    MS,
    PLATFORM,
    TRACKER,
    ZERO,
    A,
    B,
    Fused,
    T,
    Truth,
    estimator,
    legs,
    measurement,
)
from tests.sensor_samples import Readings, Sample

PATIENCE = round(SILENT_SAMPLES / TRACKER.rate_Hz / T)
"""Ticks without a usable sample until the tracker is reported as missing."""


@pytest.mark.parametrize("stamped", [3, 4, 5, 6, 7])
@pytest.mark.parametrize("offset_s", [-4e-4, 0.0, 4e-4])
def test_sensor_sample_of_a_skipped_tick_is_used_at_its_own_instant(stamped, offset_s):
    """A platform with a speed above 1 m/s; ticks 4 to 6 are skipped."""
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


def tracked(off_m: float) -> Any:
    """Samples of a tracker every 5 ms with this error."""
    return lambda tick, truth: (Sample(tick - 1, 0.0, (*(truth.p + off_m), *truth.R.as_rotvec())),)


def still(tick: int, truth: Truth) -> tuple[Sample, ...]:
    """Samples of an IMU at rest, every 5 ms."""
    return (Sample(tick - 1, 5e-4, (0.0, 0.0, 0.0, *truth.R.inv().apply(-PLATFORM.gravity))),)


def silent(_tick: int, _truth: Truth) -> tuple[Sample, ...]:
    return ()


@pytest.mark.parametrize(
    ("tracker", "imu", "heard", "missed"),
    [
        (tracked(0.05), still, False, True),
        (tracked(0.05), silent, False, True),
        (silent, still, False, True),
        (silent, silent, False, True),
        (tracked(0.0), silent, True, True),
        (tracked(0.0), still, True, False),
    ],
)
def test_silent_or_rejected_sensor_is_reported_as_missing(tracker, imu, heard, missed):
    truth = Truth(7)
    both = FusedEstimator(
        PLATFORM, Model(PLATFORM), FusionSettings(), LEGS, TRACKER, ImuSettings(rate_Hz=200.0), T
    )
    both.start(0, 0, truth.p, truth.R.as_matrix())
    m = measurement(*legs(truth.p, truth.R, ZERO))
    for tick in range(1, 2 * PATIENCE):
        samples = [kind(tick, truth) if tick % 5 == 0 else () for kind in (tracker, imu)]
        health = Fused(both, tick, m, Readings(tracker=samples[0], imu=samples[1])).health
        assert round(health.gap_s / T) == (tick % 5 if heard else tick)
        assert health.missed == (missed and tick > PATIENCE)


def force(found):
    """Forces (6,) N behind the acceleration of the last interval; None if it used none."""
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


def test_filter_uses_the_mean_of_the_leg_forces_at_both_ends_of_an_interval():
    found = estimator()
    forces = []
    said = [np.arange(6.0), -2.0 * np.arange(6.0), np.full(6, 10.0)]
    for tick, tau in enumerate(said, 1):
        sensor_samples.update(found, altered(driven(tau), tick=tick), tick * MS, Readings(), ZERO, ZERO)
        forces.append(force(found))
    expected = [said[0], -0.5 * np.arange(6.0), 5.0 - np.arange(6.0)]
    np.testing.assert_allclose(forces, expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("leg", range(6))
def test_filter_uses_the_reported_force_of_a_drive_without_encoder_and_the_commanded_if_silent(leg):
    found = estimator()
    other = (leg + 1) % 6
    ages = [7 * (i in {leg, other}) for i in range(6)]
    blind = [int(i == leg) for i in range(6)]
    tick = altered(driven(np.arange(6.0) + 1.0, ages, blind), tick=1)
    sensor_samples.update(found, tick, MS, Readings(), np.full(6, 50.0), ZERO)
    expected = [50.0 if i == other else i + 1.0 for i in range(6)]
    np.testing.assert_allclose(force(found), expected, rtol=0.0, atol=1e-6)


def test_filter_uses_the_commanded_forces_of_drives_that_report_none():
    found = estimator(errors=LOOSE_LEGS._replace(reports_force=False))
    tick = altered(driven(np.zeros(6)), tick=1)
    sensor_samples.update(found, tick, MS, Readings(), np.arange(6.0) + 50.0, ZERO)
    np.testing.assert_allclose(force(found), np.arange(6.0) + 50.0, rtol=0.0, atol=1e-6)


def test_lengths_that_are_polled_one_after_the_other_give_the_pose_at_the_first_poll():
    start, velocity, turns = Truth(4), np.array([0.3, -0.2, 0.1]), np.array([0.2, 0.1, -0.1])
    found, twist = estimator(LOOSE, LOOSE_LEGS, start), np.concatenate((velocity, turns))
    latch_ns = 50_000 + 60_000 * np.arange(6)

    def at(t_s):
        return start.p + velocity * t_s, Rotation.from_rotvec(turns * t_s) * start.R

    for tick in range(1, 50):
        poses = [at(tick * T + 1e-9 * after) for after in latch_ns]
        each = [legs(p, R, twist) for p, R in poses]
        q, dq = (np.array([each[leg][k][leg] for leg in range(6)]) for k in range(2))
        seen = altered(measurement(q, dq), tick=tick, t_ns=tick * MS, lateness_ns=0, latch_ns=latch_ns)
        sensor_samples.update(found, seen, None, Readings(), ZERO, ZERO)
    assert np.abs(seen["p"] - at(49 * T + 5e-5)[0]).max() < 1e-6, "m; it moves by 0.11 mm between the polls"


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("state", [DriveState.READY, DriveState.OFF, DriveState.FAULT])
def test_filter_ignores_leg_forces_while_one_brake_is_closed(leg, state):
    """A closed brake balances the forces, and afterwards their mean starts again."""
    found, forces = estimator(), []
    states = [state if i == leg else DriveState.RUN for i in range(6)]
    for number, drives in enumerate(([DriveState.RUN] * 6, states, [DriveState.RUN] * 6), 1):
        tick = altered(driven(np.full(6, 10.0 * number)), tick=number, drive_state=drives)
        sensor_samples.update(found, tick, number * MS, Readings(), ZERO, ZERO)
        interval = found._steps[found.record["newest"]]
        shut = drives is states
        assert (interval["used"] == (KEPT if shut else 1)).all()
        assert not (shut and interval["dtwist"].any())
        forces.append(force(found))
    assert forces[1] is None
    np.testing.assert_allclose(forces[::2], [[10.0] * 6, [30.0] * 6], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("odd", ["", "brake", "leg", "leg that is silent"])
@pytest.mark.parametrize("leg", [0, 5])
def test_filter_assumes_zero_speed_while_all_brakes_are_closed(odd, leg):
    """5 mm/s of a leg with fresh feedback is motion; the last reading of a silent leg is not."""
    found, at = estimator(), np.arange(6) == leg
    twist = np.array([0.1, -0.2, 0.3, -0.4, 0.5, -0.6])
    found._steps[found.record["newest"]]["x"][12:18] = twist
    states = np.where(at & (odd == "brake"), int(DriveState.RUN), int(DriveState.READY))
    rates, ages = 5e-3 * (at & ("leg" in odd)), 1 * (at & ("silent" in odd))
    tick = altered(driven(np.zeros(6)), tick=1, drive_state=states, rate=rates, age=ages)
    sensor_samples.update(found, tick, MS, Readings(), ZERO, ZERO)
    stands = odd in {"", "leg that is silent"}
    lost = found._steps[found.record["newest"]]["dtwist"] * T
    np.testing.assert_allclose(lost, -twist if stands else np.zeros(6), rtol=1e-12)
    assert force(found) is None


def test_restart_of_the_filter_clears_slips_forces_and_attitude():
    found, fresh, truth = estimator(), estimator(), Truth(5)
    for tick in range(1, 4):
        sensor_samples.update(
            found, altered(driven(np.ones(6)), tick=tick), tick * MS, Readings(), ZERO, ZERO
        )
    for name, leg in (("slipped", 2), ("against", 1), ("left_out", 4)):
        found.record[name][leg] = 2
    found.record["mean"], found.record["strays"] = 1.0, 1
    for each in (found, fresh):
        each.start(50, 50 * MS, truth.p, truth.R.as_matrix())
    for name in (
        "newest",
        "count",
        "driven",
        "slipped",
        "left_out",
        "against",
        "heard",
        "R",
        "mean",
        "strays",
    ):
        np.testing.assert_array_equal(found.record[name], fresh.record[name], name)
    for name in ("tick", "latched_ns", "x"):
        np.testing.assert_array_equal(found._steps[0][name], fresh._steps[0][name])
    np.testing.assert_array_equal(found._covariances[0], fresh._covariances[0])


@pytest.mark.parametrize(("rate_Hz", "period_s"), [(100.0, 1e-3), (1000.0, 1e-3), (400.0, 4e-3)])
def test_wrench_sensor_is_late_after_missing_samples_at_its_own_rate(rate_Hz, period_s):
    wrench = ExternalWrench(None, rate_Hz, period_s)
    wrench._record["read_at"] = 10
    late = []
    for tick in range(10, 60):
        late.append(wrench.fill(record_of(tick=tick), fusing=False))
    patience = SENSOR_PATIENCE / rate_Hz / period_s
    assert late == [tick - 10 > patience + 1e-9 for tick in range(10, 60)]


def test_each_setting_of_the_filter_sets_its_own_constant():
    settings = FusionSettings(
        acceleration_noise_m_s2_sqrtHz=2.0,
        angular_acceleration_noise_rad_s2_sqrtHz=3.0,
        gyro_bias_walk_rad_s_sqrts=5.0,
        accelerometer_bias_walk_m_s2_sqrts=7.0,
        latch_std_us=11.0,
        gate_std=13.0,
    )
    errors = LegErrors(17.0, 19.0, 23.0, 29.0, 31.0, 37.0)
    tracker = TrackerSettings(position_std_m=0.041, orientation_std_deg=0.43)
    imu = ImuSettings(rate_Hz=500.0, angular_rate_std_rad_s=0.047, specific_force_std_m_s2=0.53)
    c = FusedEstimator(PLATFORM, Model(PLATFORM), settings, errors, tracker, imu, T).record
    expected = {
        "q_v": 4.0, "q_w": 9.0, "q_gyro_bias": 25.0, "q_force_bias": 49.0, "latch": 121e-12, "gate": 169.0,
        "r_length": 289.0, "r_rate": 361.0, "rate_skew": 529.0, "rate_scale": 841.0,
        "leg_force": 961.0, "leg_force_s": 37.0, "r_position": 0.001681,
        "r_rotation": (0.43 * np.pi / 180.0) ** 2, "r_gyro": 0.002209, "r_force": 0.2809,
        "q_stamp": 1e-10, "q_position": 0.001681 / 200 / 30**2,
        "forces": 18, "offsets": 24, "errors": 31,
    }  # fmt: skip
    assert {name: float(c[name]) for name in expected} == pytest.approx(expected)
    assert c["gravity"].tolist() == PLATFORM.gravity.tolist()


fill = kernel(record(FUSION), record(STEP), MATRIX, record(TICK, *part("estimate", "fusion")))(fill_estimate)


def test_filter_state_with_nan_has_a_nan_residual():
    s = np.zeros((), STEP)
    s["x"][0:3], s["x"][3:12] = np.nan, np.eye(3).ravel()
    s["used"] = 1
    tick = record_of()
    fill(context_of(FUSION, base_joints=A, platform_joints=B, radius=PLATFORM.radius), s, np.eye(12), tick)
    assert np.isnan(tick["fk_residual"])
    assert not tick["condition"] < np.inf
