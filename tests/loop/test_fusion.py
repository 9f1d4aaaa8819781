"""The fused pose in the loop: legs, model, and a tracker of 1 mm and 0.1 deg, 200 Hz, 5 ms late, 5 % lost.

The platform's true pose is the plant's, at the instant at which the drives latch.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.can.bus_time import BitTiming
from drivers.errors import ConfigurationError
from drivers.signals import Fault, Mode, Warn
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load, loads
from hil.app.sim.command import simulate
from hil.app.sim.lockstep import Lockstep
from hil.record.log import Log
from hil.signals import Operator
from plant_fmu.faults.kinds import DriveSilence, EncoderFreeze, EncoderJump, EncoderLost, WrenchStep
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad
from tests.loop.tracked import track

TRACKER = "  tracker: {rate_Hz: 200, position_std_m: 1e-3, orientation_std_deg: 0.1}\n"
FUSED = "estimation:\n  pose: fused\n"
ANY_LEG = "  fusion: {may_lose_legs: [0, 1, 2, 3, 4, 5]}\n"
SOON = (
    ("force_ramp_s: 0.3", "force_ramp_s: 0.05"),
    ("brake_release_s: 0.1", "brake_release_s: 0.02"),
    ("brake_open_ms: 50", "brake_open_ms: 20"),
    ("brake_close_ms: 30", "brake_close_ms: 20"),
    ("blend_s: 0.5", "blend_s: 0.1"),
)
"""The book's path begins at home: less waiting before it."""
WIDE = (*SOON, ("max_load_percent: 70", "max_load_percent: 90"))
"""Room on the bus for a wrench sensor."""
PUSH = (1500.0, -1000.0, -2000.0, 0.0, 300.0, 0.0)
"""N, N m."""
MOVING_S = 0.5
"""By then it is on its path."""


def bench(*, sensors=TRACKER, estimation=FUSED + ANY_LEG, changes=SOON):
    """Return the virtual bench on one period of the book's path."""
    text = load("virtual").text
    for old, new in (("periods: 10", "periods: 1"), *changes):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    added = f"sensors:\n{sensors}\n" if sensors else ""
    text = text.replace("\nloop:\n", f"\n{added}{estimation}\nloop:\n")
    noise = "{position_noise_m: 1e-3, orientation_noise_deg: 0.1, latency_ms: 5, lost_percent: 5}"
    return loads(f"{text}  sensors:\n    tracker: {noise}\n", "fused.yaml", Path())


UNPROVEN = Mode.HELD, Fault.STALE
"""How a run ends without one encoder: on its path to the end, and then no estimate proves that leg's brake."""


class Run(NamedTuple):
    """One run in lockstep, without a log."""

    mode: Mode
    faults: Fault
    text: str
    rows: np.ndarray
    """While tracking."""
    error: np.ndarray
    """(n, 6) m, rad: estimate less truth, while tracking."""
    warned: int
    """All warnings from the brakes' opening on."""

    @property
    def position_mm(self):
        return 1e3 * np.linalg.norm(self.error[:, :3], axis=1)

    @property
    def rms_mm(self):
        return float(np.sqrt(np.mean(self.position_mm**2)))


def run(configuration, *faults, seed=1):
    warned = 0

    def seen(cycle, row):
        nonlocal warned
        if cycle.mode >= Mode.RELEASING:
            warned |= int(row["warnings"])

    ending, cycle, rows, truths = track(configuration, *faults, seed=seed, seen=seen)
    return Run(ending.mode, cycle.faults, ending.reason, rows, error_of(rows, truths), warned)


def error_of(rows, truths):
    """Return rows less truths, (n, 6) m, rad; a truth is the instant asked for (ns) and what was known then."""
    dt = np.array([[(t_ns - snapshot.t_ns) * 1e-9] for t_ns, snapshot in truths])
    p, R, twist = (
        np.array([getattr(snapshot.truth, name) for _, snapshot in truths]) for name in ("p", "R", "twist")
    )
    there = Rotation.from_rotvec(twist[:, 3:] * dt) * Rotation.from_matrix(R)
    turned = Rotation.from_matrix(rows["R"].reshape(-1, 3, 3)) * there.inv()
    return np.hstack((rows["p"] - p - twist[:, :3] * dt, turned.as_rotvec()))


def tracked_true_mm(found):
    """Return the largest distance (mm) of the true position from the reference."""
    return 1e3 * np.linalg.norm(found.rows["p_d"] - found.rows["p"] + found.error[:, :3], axis=1).max()


@pytest.fixture(scope="module")
def alone():
    return run(bench(sensors="", estimation=""))


@pytest.fixture(scope="module")
def fused():
    return run(bench())


@pytest.mark.long
def test_a_coarse_tracker_does_not_spoil_precise_legs(alone, fused):
    assert (alone.mode, fused.mode) == (Mode.PARKED, Mode.PARKED)
    assert fused.rms_mm <= 1.05 * alone.rms_mm
    rotation = [np.sqrt(np.mean(r.error[:, 3:] ** 2)) for r in (fused, alone)]
    assert rotation[0] <= 1.05 * rotation[1]
    assert np.all(fused.rows["legs_used"] == 63)
    assert fused.warned == 0


def test_the_tracker_comes_late_and_lossy_and_is_used_at_its_own_instant(fused):
    """At up to 1.1 m/s a sample taken for 5 ms younger than it is would be off by 5 mm."""
    came = fused.rows["tracker"] != 0
    assert 0.15 < came.mean() < 0.2
    assert np.all(fused.rows["tracker"][came] == 1)
    innovation = fused.rows["innovation_tracker"][came]
    assert np.std(innovation[:, :3]) == pytest.approx(1e-3, rel=0.1)
    assert np.std(innovation[:, 3:]) == pytest.approx(np.deg2rad(0.1), rel=0.1)
    mean, std = innovation.mean(axis=0), innovation.std(axis=0)
    assert np.abs(mean / std).max() < 4 / np.sqrt(came.sum())


@pytest.mark.parametrize("leg", broad([3, 0], quick=1))
def test_an_encoder_that_slips_by_2_mm_is_named_and_left_out(leg):
    found = run(bench(), EncoderJump(leg=leg, at_s=MOVING_S, by_m=2e-3))
    assert (found.mode, found.faults) == UNPROVEN
    slipped = found.rows["legs_slipped"]
    assert set(slipped.tolist()) == {0, 1 << leg}
    first = int(np.argmax(slipped != 0))
    jumped = int(np.argmax(np.abs(found.rows["innovation_q"][:, leg]) > 1e-3))
    assert 0 <= first - jumped <= 3, "ticks from the slip to its name"
    assert found.rows["warnings"][first] & Warn.ENCODER
    assert found.rms_mm < 0.4
    assert found.position_mm.max() < 1.5


def test_a_slip_where_no_encoder_may_be_lost_is_a_fault_that_names_the_leg():
    found = run(bench(estimation=FUSED), EncoderJump(leg=2, at_s=MOVING_S, by_m=2e-3))
    assert found.mode is Mode.HELD
    assert Fault.ENCODER in found.faults
    assert "encoder of leg 2" in found.text


def test_on_shut_brakes_the_pose_stays_and_no_further_encoder_is_blamed():
    """A slip in motion faults; the brakes stop the platform from 1 m/s with one leg not heard."""
    c = bench(estimation=FUSED)
    rate = c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    nodes, plant = build_nodes(c, FaultPlan([EncoderJump(leg=2, at_s=MOVING_S, by_m=2e-3)], 1))
    lockstep = Lockstep(cycle, nodes, (BitTiming.of(c.bus),), c.loop.window_s(rate))
    operator: tuple[Operator, ...] = (Operator.RESET,)
    for _ in range(1200):
        row = lockstep.step(operator)[2].row
        operator = (Operator.ENGAGE,) if cycle.mode is Mode.IDLE else ()
    truth = nodes.snapshot().truth
    plant.close()
    assert truth is not None
    assert cycle.mode is Mode.HELD
    assert row["legs_slipped"] == 1 << 2
    assert np.linalg.norm(row["p"] - truth.p) < 1.5e-3


@pytest.mark.long
def test_one_lost_encoder_whichever_leg_it_is():
    """The pose stays within 0.4 mm RMS and 1.5 mm, and the loop stays closed on it."""
    configuration = bench()
    errors, beside = [], []
    for seed in range(20):
        found = run(configuration, EncoderLost(leg=seed % 6, at_s=0.3), seed=seed)
        assert (found.mode, found.faults) == UNPROVEN, seed
        assert np.all(found.rows["legs_lost"][150:] == 1 << seed % 6)
        assert found.rms_mm <= 0.4, seed
        errors.append(found.position_mm)
        beside.append(tracked_true_mm(found))
    assert np.sqrt(np.mean(np.square(errors))) <= 0.4
    assert np.max(errors) <= 1.5
    assert np.max(beside) <= 3.0, "the platform itself, not only its estimate, stays near the path"


@pytest.mark.parametrize(
    ("fault", "ending"),
    broad([(EncoderFreeze, UNPROVEN), (DriveSilence, (Mode.PARKED, Fault.NONE))], quick=1),
)
def test_a_frozen_encoder_and_a_silent_drive_are_survived_in_motion(fault, ending):
    found = run(bench(), fault(leg=1, at_s=0.8, for_s=0.8))
    assert (found.mode, found.faults) == ending
    assert found.rows["legs_lost"].max() == 2
    assert found.rms_mm < 0.4
    assert found.position_mm.max() < 1.5


@pytest.mark.parametrize(
    ("estimation", "faults"),
    [
        (FUSED, [EncoderLost(leg=4, at_s=MOVING_S)]),
        (FUSED + "  fusion: {may_lose_legs: [0, 1, 2, 3, 5]}\n", [EncoderLost(leg=4, at_s=MOVING_S)]),
        (FUSED + ANY_LEG, [EncoderLost(leg=4, at_s=MOVING_S), DriveSilence(leg=1, at_s=MOVING_S)]),
        ("", [EncoderLost(leg=4, at_s=MOVING_S)]),
    ],
)
def test_a_leg_that_may_not_be_lost_and_a_second_one_fault_after_five_stale_ticks(estimation, faults):
    found = run(bench(estimation=estimation), *faults)
    assert (found.mode, found.faults & Fault.STALE) == (Mode.HELD, Fault.STALE)
    assert found.rows["age"][-1].max() == 4, "the tick after is no longer tracking"


def test_without_the_tracker_a_lost_leg_ends_in_a_fault_and_not_in_a_guess():
    blind = bench()
    sensors = blind.plant.sensors
    never = sensors.model_copy(update={"tracker": sensors.tracker.model_copy(update={"lost_percent": 100.0})})
    blind = blind.model_copy(update={"plant": blind.plant.model_copy(update={"sensors": never})})
    found = run(blind, EncoderLost(leg=4, at_s=MOVING_S))
    assert found.mode is Mode.HELD
    assert Fault.UNCERTAIN in found.faults
    assert found.warned & Warn.SENSOR
    assert found.position_mm.max() < 1.5


def test_a_push_on_the_platform_is_no_slip():
    found = run(bench(), WrenchStep(at_s=0.8, force_N=PUSH[:3], moment_N_m=PUSH[3:]))
    assert found.mode is Mode.PARKED
    assert found.rows["legs_slipped"].max() == 0
    assert found.rms_mm < 0.02, "a load that the model does not know of makes it lag by as much"


@pytest.mark.long
def test_the_observer_does_not_learn_from_a_pose_that_its_own_estimate_carries_on():
    """In the direction that no leg sees, filter and observer would confirm each other."""
    observer = "  wrench: {source: observer, bus_ms: 0.5, drive_lag_ms: 0.796}\n"
    found = run(bench(estimation=FUSED + ANY_LEG + observer), EncoderLost(leg=4, at_s=MOVING_S))
    assert (found.mode, found.faults) == UNPROVEN
    assert found.rms_mm < 0.4
    assert found.position_mm.max() < 1.5
    lost = found.rows["wrench"][found.rows["legs_lost"] != 0]
    assert len(lost) > 1000
    assert np.all(lost == lost[0]), "held"


@pytest.mark.long
def test_a_load_that_the_filter_is_not_told_of_moves_the_pose_where_no_leg_sees_it():
    lost = EncoderLost(leg=1, at_s=0.3)
    small = run(bench(), lost, WrenchStep(at_s=0.8, force_N=(0.0, 0.0, -300.0), moment_N_m=(0.0, 0.0, 0.0)))
    assert (small.mode, small.faults) == UNPROVEN
    assert small.position_mm.max() < 1.5
    large = run(bench(), lost, WrenchStep(at_s=0.8, force_N=PUSH[:3], moment_N_m=PUSH[3:]))
    assert large.mode in {Mode.HELD, Mode.PARKED}
    assert large.faults & (Fault.UNCERTAIN | Fault.FOLLOWING)
    sensors = TRACKER + "  wrench: {rate_Hz: 500}\n"
    estimation = FUSED + ANY_LEG + "  wrench: {source: sensor}\n"
    told = run(
        bench(sensors=sensors, estimation=estimation, changes=WIDE),
        lost,
        WrenchStep(at_s=0.8, force_N=PUSH[:3], moment_N_m=PUSH[3:]),
    )
    assert (told.mode, told.faults) == UNPROVEN
    assert told.rms_mm < 0.4
    assert told.position_mm.max() < 1.5


def test_a_fused_run_with_a_lost_leg_replays_to_the_bit(tmp_path):
    sensors = TRACKER + "  imu: {rate_Hz: 500}\n  wrench: {rate_Hz: 500}\n"
    push = WrenchStep(at_s=0.8, force_N=(100.0, -200.0, 300.0), moment_N_m=(0.0, 30.0, 0.0))
    summary = simulate(
        bench(sensors=sensors, changes=WIDE),
        log=tmp_path / "fused.mcap",
        faults=FaultPlan([EncoderLost(leg=5, at_s=0.3), push]),
    )
    assert (summary["final_mode"], summary["faults"]) == ("HELD", ["STALE"])
    assert summary["replay"]["exact"]
    rows = Log.open(tmp_path / "fused.mcap").rows()
    tracking = rows[rows["mode"] == Mode.TRACKING]
    assert (tracking["tracker"] > 0).sum() > 300
    pushed = tracking["wrench_sensor"][tracking["t_ns"] > 810_000_000]
    assert np.abs(pushed - (*push.force_N, *push.moment_N_m)).max() < 1.0, "in the base frame"


# -- configurations that cannot work ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sensors": ""}, r"estimation\.fusion\.may_lose_legs: without the pose from outside"),
        (
            {"estimation": "estimation:\n  fusion: {may_lose_legs: [1]}\n"},
            r"may_lose_legs: .* allowed: none, or",
        ),
        ({"estimation": FUSED + "  fusion: {may_lose_legs: [1, 1]}\n"}, r"a leg twice"),
        ({"estimation": FUSED + "  fusion: {may_lose_legs: [6]}\n"}, r"may_lose_legs"),
        ({"sensors": "  tracker: {node_id: 6}\n"}, r"tracker\.node_id: already .* drives\.node_ids"),
        (
            {"sensors": "  tracker: {node_id: 9}\n  wrench: {rate_Hz: 100}\n"},
            r"wrench\.node_id: already .* sensors\.tracker\.node_id",
        ),
        ({"sensors": "  tracker: {rate_Hz: 2000}\n"}, r"more than one sample a tick, allowed: at most 1000"),
        ({"sensors": "  tracker: {latency_max_ms: 500}\n"}, r"latency_max_ms: older than .* at most 126"),
        ({"sensors": "  tracker: {position_std_m: 0}\n"}, r"sensors\.tracker\.position_std_m"),
        ({"sensors": TRACKER + "  imu: {rate_Hz: 500}\n  wrench: {rate_Hz: 500}\n"}, r"do not fit .*\n.*\n"),
        (
            {"changes": [("layout: fd", "layout: classic")]},
            r"bus\.layout: classic carries 8 bytes a frame .*sensors\.tracker",
        ),
        (
            {"sensors": "", "estimation": FUSED, "changes": [("layout: fd", "layout: classic")]},
            r"estimation\.pose: .* classic carries none, allowed with it: legs",
        ),
    ],
)
def test_what_cannot_work_is_refused_with_a_reason(arguments, message):
    with pytest.raises(ConfigurationError, match=message):
        bench(**arguments)


def test_sensors_need_a_plant_that_knows_its_pose():
    text = load("bench").text.replace("\nloop:\n", f"\nsensors:\n{TRACKER}\nloop:\n")
    with pytest.raises(ConfigurationError, match=r"plant\.model\.type: knows no pose that sensors\.tracker"):
        loads(text, "my.yaml", Path())
