"""The fused pose in the loop, compared with the plant's true pose at the instant of latching.

With e the error of pose and twist and P its covariance, e^T P^-1 e / 12 has the mean 1 where P is right
(NEES; Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 5.4).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.signals import LEGS, Fault, Mode, Warn
from hil.app.derive_encoder_limits import leg_errors
from hil.app.sim.command import simulate
from hil.app.sim.lockstep import Lockstep
from hil.record.log import Log
from plant_fmu.faults.kinds import DriveSilence, EncoderFreeze, EncoderJump, EncoderLost, WrenchStep
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad
from tests.loop.bench import bench, changed, until
from tests.loop.fusion_runs import ANY_LEG, SOON, TRACKER, UNPROVEN, Tracked, fused, seen, track

PUSH = WrenchStep(at_s=0.8, force_N=(1500.0, -1000.0, -2000.0), moment_N_m=(0.0, 300.0, 0.0))
MOVING_S = 0.5
"""By this tick the platform is on its path."""
NO_LEG = {"pose": "fused"}
WIDE = {"max_load_percent": 90}
"""Section bus with room for a wrench sensor."""


def assert_near(found: Tracked) -> None:
    """Assert that without one leg the pose is as good as tracker and model allow."""
    assert found.rms_mm < 0.4
    assert found.position_mm.max() < 1.5


@pytest.fixture(scope="module")
def good() -> Tracked:
    return track(fused())


@pytest.mark.long
def test_fused_pose_of_precise_encoders_and_a_coarse_tracker_is_as_precise_as_the_encoders(good):
    alone = track(changed("virtual", **SOON))
    assert alone.ending.mode is good.ending.mode is Mode.PARKED
    assert good.rms_mm <= 1.05 * alone.rms_mm
    rotation = [np.sqrt(np.mean(r.e[:, 3:6] ** 2)) for r in (good, alone)]
    assert rotation[0] <= 1.05 * rotation[1]
    assert np.all(good.rows["legs_used"] == 63)
    assert good.warned == 0


def test_late_tracker_samples_are_fused_at_the_time_of_their_stamp(good):
    """At up to 1.1 m/s a sample dated 5 ms too late would be off by 5 mm."""
    came = good.rows["tracker"] != 0
    assert 0.15 < came.mean() < 0.2
    assert np.all(good.rows["tracker"][came] == 1)
    innovation = good.rows["innovation_tracker"][came]
    assert np.std(innovation[:, :3]) == pytest.approx(1e-3, rel=0.1)
    assert np.std(innovation[:, 3:]) == pytest.approx(np.deg2rad(0.1), rel=0.1)
    mean, std = innovation.mean(axis=0), innovation.std(axis=0)
    assert np.abs(mean / std).max() < 4 / np.sqrt(came.sum())


@pytest.mark.parametrize("leg", broad([3, 0], quick=1))
def test_encoder_that_slips_by_2_mm_is_reported_and_excluded_from_the_fused_pose(leg):
    found = track(fused(), EncoderJump(leg=leg, at_s=MOVING_S, by_m=2e-3))
    assert found.end == UNPROVEN
    slipped = found.rows["legs_slipped"]
    assert set(slipped.tolist()) == {0, 1 << leg}
    first = int(np.argmax(slipped != 0))
    jumped = int(np.argmax(np.abs(found.rows["innovation_q"][:, leg]) > 1e-3))
    assert 0 <= first - jumped <= 3, "ticks from the slip to its name"
    assert found.rows["warnings"][first] & Warn.ENCODER
    assert_near(found)


def test_encoder_slip_is_a_fault_if_the_configuration_allows_no_lost_encoder():
    found = track(fused(estimation=NO_LEG), EncoderJump(leg=2, at_s=MOVING_S, by_m=2e-3))
    assert found.ending.mode is Mode.HELD
    assert Fault.ENCODER in found.faults
    assert "encoder of leg 2" in found.ending.reason


def test_fused_pose_stays_constant_on_closed_brakes_and_no_other_encoder_is_excluded():
    """A slip in motion faults; the brakes stop the platform from 1 m/s with one leg missing."""
    with bench(fused(estimation=NO_LEG), EncoderJump(leg=2, at_s=MOVING_S, by_m=2e-3), seed=1) as lockstep:
        until(lockstep, Mode.HELD)
        for _ in range(600):
            row = lockstep.step()[2].row
        truth = lockstep.nodes.snapshot().truth
        assert lockstep.cycle.mode is Mode.HELD
    assert truth is not None
    assert row["legs_slipped"] == 1 << 2
    assert np.linalg.norm(row["p"] - truth.p) < 1.5e-3


@pytest.mark.long
def test_run_with_pose_fusion_continues_after_the_loss_of_any_single_encoder():
    """The pose stays within 0.4 mm RMS and 1.5 mm, and the loop stays closed on it."""
    errors, beside = [], []
    for seed in range(12):
        found = track(fused(), EncoderLost(leg=seed % 6, at_s=0.3), seed=seed)
        assert found.end == UNPROVEN, seed
        assert np.all(found.rows["legs_lost"][150:] == 1 << seed % 6)
        assert found.rms_mm <= 0.4, seed
        errors.append(found.position_mm)
        true = found.rows["p"] + found.e[:, :3]
        beside.append(1e3 * np.linalg.norm(found.rows["p_d"] - true, axis=1).max())
    assert np.max(errors) <= 1.5
    assert np.max(beside) <= 3.0, "the platform itself, not only its estimate, stays near the path"


@pytest.mark.parametrize(
    ("fault", "end"), broad([(EncoderFreeze, UNPROVEN), (DriveSilence, (Mode.PARKED, Fault.NONE))], quick=1)
)
def test_run_with_pose_fusion_continues_with_a_frozen_encoder_or_silent_drive_in_motion(fault, end):
    found = track(fused(), fault(leg=1, at_s=0.8, for_s=0.8))
    assert found.end == end
    assert found.rows["legs_lost"].max() == 2
    assert_near(found)


@pytest.mark.parametrize(
    ("fusion", "faults"),
    [
        ({}, [EncoderLost(leg=4, at_s=MOVING_S)]),
        ({"may_lose_legs": [0, 1, 2, 3, 5]}, [EncoderLost(leg=4, at_s=MOVING_S)]),
        (ANY_LEG, [EncoderLost(leg=4, at_s=MOVING_S), DriveSilence(leg=1, at_s=MOVING_S)]),
    ],
)
def test_encoder_loss_without_permission_to_continue_faults_after_five_periods(fusion, faults):
    found = track(fused(estimation={"pose": "fused", "fusion": fusion}), *faults)
    assert (found.ending.mode, found.faults & Fault.STALE) == UNPROVEN
    assert found.rows["age"][-1].max() == 4, "the tick after is no longer tracking"


def test_lost_encoder_without_a_tracker_ends_in_a_fault():
    blind = changed(fused(), plant={"sensors": {"tracker": {"lost_percent": 100}}})
    found = track(blind, EncoderLost(leg=4, at_s=MOVING_S))
    assert found.ending.mode is Mode.HELD
    assert Fault.UNCERTAIN in found.faults
    assert found.warned & Warn.SENSOR
    assert found.position_mm.max() < 1.5


def test_push_on_the_platform_is_not_taken_for_an_encoder_slip():
    found = track(fused(), PUSH)
    assert found.ending.mode is Mode.PARKED
    assert found.rows["legs_slipped"].max() == 0
    assert found.rms_mm < 0.02, "an unmodelled load makes the platform lag by as much"


@pytest.mark.long
def test_wrench_observer_does_not_drift_if_a_lost_encoder_leaves_a_direction_unmeasured():
    """In the direction that no leg measures, filter and observer would confirm each other."""
    observer = {"source": "observer", "bus_ms": 0.5, "drive_lag_ms": 0.796}
    c = changed(fused(), estimation={"wrench": observer})
    found = track(c, EncoderLost(leg=4, at_s=MOVING_S))
    assert found.end == UNPROVEN
    assert_near(found)
    lost = found.rows["wrench"][found.rows["legs_lost"] != 0]
    assert len(lost) > 1000
    assert np.all(lost == lost[0]), "held"


@pytest.mark.long
def test_unknown_load_with_a_lost_encoder_shifts_the_fused_pose_in_the_unmeasured_direction():
    lost = EncoderLost(leg=1, at_s=0.3)
    small = track(fused(), lost, WrenchStep(at_s=0.8, force_N=(0.0, 0.0, -300.0), moment_N_m=(0.0, 0.0, 0.0)))
    assert small.end == UNPROVEN
    assert small.position_mm.max() < 1.5
    large = track(fused(), lost, PUSH)
    assert large.ending.mode in {Mode.HELD, Mode.PARKED}
    assert large.faults & (Fault.UNCERTAIN | Fault.FOLLOWING)
    sensed = fused(sensors={"tracker": TRACKER, "wrench": {"rate_Hz": 500}}, bus=WIDE)
    known = track(changed(sensed, estimation={"wrench": {"source": "sensor"}}), lost, PUSH)
    assert known.end == UNPROVEN
    assert_near(known)


def test_run_with_pose_fusion_and_a_lost_encoder_replays_to_the_bit(tmp_path):
    sensors = {"tracker": TRACKER, "imu": {"rate_Hz": 500}, "wrench": {"rate_Hz": 500}}
    push = WrenchStep(at_s=0.8, force_N=(100.0, -200.0, 300.0), moment_N_m=(0.0, 30.0, 0.0))
    faults = FaultPlan([EncoderLost(leg=5, at_s=0.3), push])
    summary = simulate(fused(sensors=sensors, bus=WIDE), log=tmp_path / "fused.mcap", faults=faults)
    assert (summary["final_mode"], summary["faults"]) == ("HELD", ["STALE"])
    assert summary["replay"]["exact"]
    rows = Log.open(tmp_path / "fused.mcap").rows()
    tracking = rows[rows["mode"] == Mode.TRACKING]
    assert (tracking["tracker"] > 0).sum() > 300
    pushed = tracking["wrench_sensor"][tracking["t_ns"] > 810_000_000]
    assert np.abs(pushed - (*push.force_N, *push.moment_N_m)).max() < 1.0, "in the base frame"


CLASSIC = {"layout": "classic"}
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"sensors": None}, r"may_lose_legs: five legs alone do not determine the pose"),
    ({"estimation": {"pose": None, "fusion": {"may_lose_legs": [1]}}}, r"may_lose_legs: .* allowed: none"),
    ({"estimation": {"pose": "fused", "fusion": {"may_lose_legs": [1, 1]}}}, r"a leg twice"),
    (
        {"sensors": {"tracker": {"node_id": 6}}},
        r"tracker\.node_id: 6 is also in drives\.node_ids, allowed: an unused number",
    ),
    ({"sensors": {"tracker": {"rate_Hz": 2000}}}, r"more than one sample a tick"),
    ({"sensors": {"tracker": {"latency_max_ms": 500}}}, r"latency_max_ms: older than"),
    ({"sensors": {"imu": {"rate_Hz": 500}, "wrench": {"rate_Hz": 500}}}, r"do not fit"),
    ({"bus": CLASSIC}, r"sensors\.tracker: .*layout classic"),
    ({"sensors": None, "estimation": {"pose": "fused"}, "bus": CLASSIC}, r"estimation\.pose: .* classic"),
]


@pytest.mark.parametrize(("sections", "message"), REFUSED, ids=str)
def test_invalid_pose_fusion_settings_are_refused_with_a_reason(sections, message):
    with pytest.raises(ConfigurationError, match=message):
        changed(fused() if "estimation" not in sections else fused(estimation=None), **sections)


# -- its errors are as large as it says ----------------------------------------------------------------------


SHORT: dict[str, dict[str, Any]] = {"virtual": {"periods": 1}, "lab": {"duration_s": 6}}
RMS_MM = {"virtual": 0.36e-3, "lab": 0.12e-3}
"""On `virtual` that of the legs alone, whose encoder steps are 1 um; on `lab` the steps are 0.15 um."""


def stated(name: str, fusion: dict[str, Any] | None = None, **sections: Any) -> Any:
    estimation = {"pose": "fused", "fusion": fusion or {}}
    return seen(name, estimation=estimation, **{"reference": SHORT[name]} | sections)


def covariance(lockstep: Lockstep) -> Array:
    estimator: Any = lockstep.cycle.parts.fusion
    return np.asarray(estimator._covariances[estimator.record["newest"]][:12, :12].copy())


def used(found: Tracked) -> Any:
    """Flags (n, 6) of the used legs."""
    return found.rows["legs_used"][:, None] >> np.arange(LEGS) & 1


def assert_consistent(found: Tracked, rms_mm: float) -> None:
    """No case may be overconfident: not over 1.5 even for pose and twist alone."""
    assert found.end == (Mode.PARKED, Fault.NONE)
    assert not found.warned & Warn.SENSOR
    assert 0.5 < found.nees().mean() < 1.5
    assert np.quantile(found.nees(), 0.99) < 3
    assert 0.5 < found.nees(last=6).mean() < 1.5
    assert found.nees(first=6).mean() < 1.5
    assert np.mean(used(found) == 0) < 1e-3
    assert found.rms_mm < rms_mm


RUNS: list[tuple[str, int, dict[str, Any] | None, dict[str, Any]]] = [
    *((name, seed, None, {}) for seed in range(1, 4) for name in ("virtual", "lab")),
    ("lab", 1, None, {"reference": {}}),  # the whole ride
    *(  # friction that is stated three times too large or five times too small
        ("lab", 1, {"leg_force_std_N": 60}, {"plant": {"model": {"coulomb_friction_N": friction_N}}})
        for friction_N in (300, 20)
    ),
]


@pytest.mark.parametrize(("name", "seed", "fusion", "sections"), broad(RUNS, quick=1))
def test_fused_pose_errors_match_the_covariance_with_no_good_encoder_excluded(name, seed, fusion, sections):
    found = track(stated(name, fusion, **sections), seed=seed, covariance=covariance)
    assert_consistent(found, RMS_MM[name])


@pytest.mark.long
@pytest.mark.parametrize("leg", [4, 1])
def test_errors_of_the_fused_pose_with_a_lost_encoder_and_friction_match_its_covariance(leg):
    """In the direction that no leg measures, only the tracker of 1 mm acts against friction: within 1 mm the
    lengths are nonlinear.
    """
    found = track(stated("lab", ANY_LEG), EncoderLost(leg=leg, at_s=3.0), covariance=covariance)
    assert found.end == UNPROVEN
    assert found.rms_mm < 0.4
    assert found.position_mm.max() < 2
    lost = used(found)[:, leg] == 0
    assert lost.sum() > 4000
    assert np.median(found.nees()[lost]) < 1
    assert found.nees()[lost].mean() < 6
    off, said = np.sum(found.e[:, :3] ** 2, axis=1), np.trace(found.P[:, :3, :3], axis1=1, axis2=2)
    assert 0.5 < np.mean((off / said)[lost]) < 2.5


@pytest.mark.parametrize(
    ("name", "seeds"),
    [("virtual", [5]), *(pytest.param(name, range(10), marks=pytest.mark.long) for name in SHORT)],
)
def test_errors_of_the_fused_pose_match_its_covariance_for_any_tracker_time_stamps(name, seeds):
    """Stamps are 0 to 5 ms late; an encoder is lost in the middle of the path."""
    whole, lost = [], []
    for seed in seeds:
        late = changed(stated(name, ANY_LEG), plant={"sensors": {"tracker": {"time_offset_ms": seed % 6}}})
        gone = EncoderLost(leg=(1, 4, 0)[seed % 3], at_s={"virtual": 1.9, "lab": 4.0}[name])
        found = track(late, gone, seed=seed, covariance=covariance)
        assert found.end == UNPROVEN
        assert not found.warned & Warn.SENSOR
        without = found.rows["legs_lost"] != 0
        whole.append(found.nees()[~without].mean())
        lost.append(found.nees()[without].mean())
    assert 0.5 < np.mean(whole) < 1.5
    assert 0.5 < np.mean(lost) < 1.5
    assert np.max(lost) < 1.5


def test_drift_of_the_pose_tracker_is_reported_within_3_s():
    drifts = changed(stated("virtual"), plant={"sensors": {"tracker": {"position_drift_m_s": [0, 1e-3, 0]}}})
    found = track(drifts)
    assert found.rows["tick"][np.argmax(found.rows["warnings"] & Warn.SENSOR != 0)] < 3000
    assert found.warned == Warn.SENSOR


def test_assumed_leg_errors_of_pose_fusion_follow_from_encoder_friction_and_monitor_settings():
    found = leg_errors(stated("lab"))
    steps = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 200_000)) * [[1.5e-7], [1e-7]]
    assert found.length_std_m == pytest.approx(steps.sum(axis=0).std(), rel=0.01)
    assert found.force_std_N == 60.0, "the plant's"
    assert found.rate_skew_std_s == pytest.approx(50e-6 / np.sqrt(3))
    assert found.rate_scale_std == pytest.approx(0.01 / np.sqrt(3))
    assert leg_errors(stated("virtual")).force_std_N == 0.0
    plantless = leg_errors(stated("lab").model_copy(update={"plant": None}))
    assert plantless.force_std_N == pytest.approx(0.05 * 2000), "5 % of the smallest force limit"
    assert plantless.length_std_m == pytest.approx(2e-6 / np.sqrt(12))
