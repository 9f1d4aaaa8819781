"""Faults on demand in whole runs, and the matrix that judges them: a slice here, all of it in `make long`."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from drivers.signals import Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.fault_words import read_fault, show_fault, with_faults
from hil.app.sim.build import build_lockstep
from hil.cli import main
from hil.loop.run_end import Course
from hil.study.faults import case_run
from hil.study.faults.case_run import Job, run_case
from hil.study.faults.cases import LEG, MATRIX, cases
from hil.study.faults.command import run_matrix
from hil.study.faults.verdict import Bounds, Seen, Trace, see
from plant_fmu.faults import FAULTS
from plant_fmu.faults.kinds import PayloadStep
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad

BOUNDS = Bounds(stopping_m=0.163, controlled_m=0.283, harmless_m=0.01, harmless_s=0.01)


def one(pattern: str, configuration: str = "virtual") -> dict[str, Any]:
    (case,) = cases(load(configuration), [pattern])
    return run_case(Job(case, BOUNDS))


def test_the_matrix_has_each_kind_at_each_moment_and_none_of_the_process():
    found = cases(load("virtual"))
    names = {case.name for case in found}
    assert len(names) == len(found)
    assert names == {f"{k}/{m}" for k in FAULTS if not k.startswith("process") for m in MATRIX}
    assert {case.fault.leg for case in found if hasattr(case.fault, "leg")} == {LEG}


def test_a_bench_gets_drive_and_frame_faults():
    kinds = {str(case.fault.kind) for case in cases(load("bench"))}
    assert kinds == {k for k in FAULTS if k.startswith(("drive_", "frames_"))}


def test_a_reference_that_waits_for_set_points_has_no_matrix():
    text = load("virtual").text
    a, b = text.index("\nreference:") + 1, text.index("\nlimits:") + 1
    limits = (
        "{velocity_m_s: 0.1, acceleration_m_s2: 0.5, jerk_m_s3: 5, velocity_deg_s: 5, "
        "acceleration_deg_s2: 20, jerk_deg_s3: 200}"
    )
    live = loads(f"{text[:a]}reference: {{type: live, limits: {limits}}}\n\n{text[b:]}", "live.yaml")
    with pytest.raises(ConfigurationError, match="waits for set-points"):
        cases(live)


def test_each_legs_fault_comes_once_for_each_leg_that_is_asked_for():
    found = cases(load("virtual"), ["drive_silence", "drive_saturation/HOLD", "bus_off"], legs=[0, 5])
    legs = [getattr(case.fault, "leg", None) for case in found]
    assert legs == [*(0, 5) * len(MATRIX), 0, 5, *[None] * len(MATRIX)]
    assert len({(case.name, case.given) for case in found}) == len(found)
    with pytest.raises(ConfigurationError, match="--legs: 6 is no leg, allowed: 0 to 5"):
        cases(load("virtual"), legs=[6])


def test_a_seed_draws_leg_size_and_sign_and_always_the_same():
    c = load("virtual")
    drawn: list[Any] = [
        case.fault for seed in range(40) for case in cases(c, ["encoder_jump/HOLD"], seed=seed)
    ]
    assert {fault.leg for fault in drawn} == set(range(6))
    sizes = np.array([fault.by_m for fault in drawn])
    assert (sizes > 0).any()
    assert (sizes < 0).any()
    assert np.abs(sizes).min() >= 1e-3
    assert np.abs(sizes).max() <= 0.5
    assert (np.abs(sizes) > 0.05).sum() >= 5, "large ones, too"
    alone, among = cases(c, ["encoder_jump/HOLD"], seed=7), cases(c, ["encoder_*"], seed=7)
    assert alone[0].fault in [case.fault for case in among]
    given: list[Any] = [case.fault for case in cases(c, ["drive_*"], legs=[1, 4], seed=7)]
    assert {fault.leg for fault in given} == {1, 4}


@pytest.mark.parametrize("seed", range(5))
def test_what_is_drawn_is_a_fault_whose_words_repeat_it(seed):
    found = cases(load("virtual"), seed=seed)
    assert {case.name for case in found} == {case.name for case in cases(load("virtual"))}
    for case in found:
        again = read_fault(show_fault(case.fault))
        assert again.model_copy(update={"at_s": case.fault.at_s}) == case.fault


def test_a_load_of_the_matrix_weighs_what_the_configuration_says():
    c = load("virtual")
    light = c.model_copy(
        update={"platform": c.platform.model_copy(update={"gravity_m_s2": (0.0, 0.0, -1.62)})}
    )
    nodes, plant = build_nodes(light, FaultPlan([PayloadStep(mass_kg=100.0)]))
    nodes.step(1_000_000, [])
    snapshot = nodes.snapshot()
    plant.close()
    assert snapshot.wrench[2] == pytest.approx(-162.0)


def test_a_held_platform_is_watched_for_three_seconds(monkeypatch):
    seen: list[Trace] = []

    def keep(kind: str, trace: Trace) -> Seen:
        seen.append(trace)
        return see(kind, trace)

    monkeypatch.setattr(case_run, "see", keep)
    found = one("drive_silence/HOLD")
    assert found["ended"] == "HELD"
    assert found["last_mm"] <= 0.05
    assert (seen[0].mode == Mode.HELD).sum() >= 3000


def test_a_brake_that_does_not_close_is_held_and_its_leg_named():
    found = one("brake_stuck_open/PARKING")
    assert found["success"], found
    assert (found["ended"], found["causes"], found["legs"]) == ("HELD", {"BRAKE": [LEG]}, [LEG])
    assert 0.1 < found["motion_mm"] <= 10


@pytest.mark.parametrize("moment", broad(["PARKING", "TRACKING"], quick=1))
def test_swapped_wires_do_not_drive_a_leg_through_its_brake(moment):
    """Where it is fastest, and where the law still holds while the brakes close: it went 0.68 and 0.87 m."""
    found = one(f"drive_sign/{moment}")
    assert found["ended"] in {"PARKED", "HELD"}
    assert "DRIVE" in found["faults"]
    assert f"drive {LEG} does not obey" in found["reason"]
    assert found["success"], found


def test_a_silent_drive_is_declared_in_the_fifth_tick():
    found = one("drive_silence/TRACKING")
    assert (found["ended"], found["faults"], found["legs"]) == ("HELD", ["STALE"], [LEG])
    assert found["after_ms"] == pytest.approx(4)
    assert found["success"], found


def test_a_forged_command_is_declared_within_two_ticks():
    found = one("frames_forged_command/APPROACH")
    assert found["faults"] == ["SECOND_CONTROLLER"]
    assert found["after_ms"] <= 2
    assert found["success"], found


def test_a_duplicate_node_is_declared_within_two_ticks_and_named():
    found = one("frames_forged_feedback/HOLD")
    assert (found["faults"], found["legs"]) == (["DUPLICATE_NODE"], [LEG])
    assert found["success"], found


@pytest.mark.long
def test_a_flooded_bus_ends_the_run_although_no_sync_gets_through():
    found = one("bus_flood/HOLD")
    assert (found["ended"], found["faults"], found["legs"]) == ("FAULT", ["STALE"], [])
    assert found["success"], found


def test_what_no_encoder_can_see_is_said_to_be_so():
    found = one("encoder_scale/HOLD")
    assert (found["ended"], found["faults"]) == ("PARKED", [])
    assert found["verdict"].startswith("not observable with these sensors: leaves ")
    assert found["success"]


def test_a_case_is_the_same_each_time():
    first, second = (one("frames_loss/LOADING") for _ in range(2))
    assert {**first, "wall_s": 0} == {**second, "wall_s": 0}


@pytest.mark.long
def test_a_case_whose_brake_tests_never_end_is_held_and_judged_within_half_a_minute():
    """Lost frames: the platform stands on closed brakes, and the force that holds it never goes."""
    found = one("frames_loss/TRACKING", "desktop")
    assert (found["ended"], found["faults"]) == ("HELD", ["STALE"])
    assert found["success"], found["verdict"]


def modes_at_fault(words: str) -> tuple[Mode, float]:
    """Return the mode in which a fault begins and how long after that was reached, s."""
    c = with_faults(load("virtual"), [words])
    cycle = build_cycle(c, 1000.0, 0.01)
    nodes, plant = build_nodes(c)
    fault = read_fault(words)
    lockstep, course = build_lockstep(c, cycle, nodes), Course(cycle, 2.5)
    entered, mode = 0, Mode.WAITING
    try:
        while course.ending(lockstep.tick) is None:
            lockstep.step(course.commands(lockstep.tick + 1))
            if cycle.mode is not mode:
                entered, mode = lockstep.tick, cycle.mode
            if nodes.schedule.starts_ns(fault) < 1e9 * (lockstep.tick + 1) * 1e-3:
                return mode, 1e-9 * nodes.schedule.starts_ns(fault) - 1e-3 * entered
    finally:
        plant.close()
    raise AssertionError(words)


@pytest.mark.parametrize("mode", [Mode.LOADING, Mode.APPROACH, Mode.TRACKING, Mode.PARKING])
def test_a_fault_of_a_mode_begins_in_it_and_counts_from_there(mode):
    at_s = 0.02
    found, after_s = modes_at_fault(f"encoder_noise leg=0 sigma=0 mode={mode.name} at={at_s:g}")
    assert found is mode
    assert after_s == pytest.approx(at_s, abs=1e-3)


def test_a_reference_that_stands_is_at_hold_a_tenth_of_a_second_later():
    c = cases(load("virtual"), ["encoder_noise/HOLD"])[0].configuration
    cycle = build_cycle(c, 1000.0, 0.01)
    nodes, plant = build_nodes(with_faults(c, ["encoder_noise leg=0 sigma=0 mode=HOLD"]))
    lockstep, course = build_lockstep(c, cycle, nodes), Course(cycle)
    while nodes.waiting:
        lockstep.step(course.commands(lockstep.tick + 1))
        assert lockstep.tick < 3000
    plant.close()
    assert cycle.mode is Mode.TRACKING
    assert lockstep.tick - cycle.mode_tick == pytest.approx(100, abs=1)


class Stirred:
    """The cycle, whose reference moves in this tick."""

    def __init__(self, cycle):
        self._cycle = cycle

    def __getattr__(self, name):
        return getattr(self._cycle, name)

    @property
    def tick(self):
        moving = self._cycle.tick.copy()
        moving["dq_d"] = [0, 0, 0, 0, 0, -1e-3]
        return moving


def test_rests_between_which_the_reference_moves_are_not_added_up():
    c = cases(load("virtual"), ["encoder_noise/HOLD"])[0].configuration
    cycle = build_cycle(c, 1000.0, 0.01)
    nodes, plant = build_nodes(with_faults(c, ["encoder_noise leg=0 sigma=0 mode=HOLD"]))
    lockstep, course = build_lockstep(c, cycle, nodes), Course(cycle)
    moved = 0
    while nodes.waiting:
        at_rest = lockstep.tick - cycle.mode_tick if cycle.mode is Mode.TRACKING else 0
        if not moved and at_rest == 60:
            stirred: Any = Stirred(cycle)
            lockstep.cycle, moved = stirred, lockstep.tick + 1
        else:
            lockstep.cycle = cycle
        lockstep.step(course.commands(lockstep.tick + 1))
        assert lockstep.tick < 3000
    plant.close()
    assert lockstep.tick - moved == pytest.approx(100, abs=1)


def test_the_shipped_path_never_stands_still_and_the_run_says_so(tmp_path):
    arguments = [
        "sim",
        "virtual",
        "--duration",
        "1.2",
        "--log",
        tmp_path / "a.mcap",
        "--json",
        tmp_path / "a.json",
    ]
    faults = (
        "encoder_freeze leg=0 mode=HOLD",
        "encoder_noise leg=1 sigma=1e-6 at=1",
        "encoder_jump leg=2 at=99 by=1e-3",
        "encoder_drift leg=3 mode=LOADING at=98 by=1e-3",
    )
    words = [word for fault in faults for word in ("--fault", fault)]
    result = CliRunner().invoke(main, [str(word) for word in (*arguments, *words)])
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "a.json").read_text())
    assert summary["mode_not_reached"] == ["encoder_freeze mode=HOLD leg=0"]
    assert summary["injected"] == ["encoder_noise at=1 leg=1 sigma=1e-06"]
    assert [each.split()[0] for each in summary["time_not_reached"]] == ["encoder_jump", "encoder_drift"]
    assert "time not reached" in result.output
    assert summary["replay"]["agrees"], "faults are in the frames, which the log has"


def test_the_command_prints_a_table_and_writes_json_and_junit(tmp_path):
    files = ["--json", tmp_path / "a.json", "--junit", tmp_path / "a.xml"]
    only = ["--only", "drive_reset/LOADING", "--only", "plant_crash/LOADING", "--legs", "3,0,3"]
    result = CliRunner().invoke(main, ["faults", "virtual", "--jobs", "1", *only, *map(str, files)])
    summary = json.loads((tmp_path / "a.json").read_text())
    assert result.exit_code == (0 if summary["success"] else 1), result.output
    assert [f"{case['kind']}/{case['when']} {case['given']}" for case in summary["matrix"]] == [
        "drive_reset/LOADING leg=3",
        "drive_reset/LOADING leg=0",
        "plant_crash/LOADING ",
    ]
    suite = ET.parse(tmp_path / "a.xml").getroot()
    assert (suite.tag, suite.get("tests"), suite.get("failures")) == (
        "testsuite",
        "3",
        str(summary["failed"]),
    )
    assert [entry.get("name") for entry in suite] == ["LOADING leg=3", "LOADING leg=0", "LOADING"]
    for case, entry in zip(summary["matrix"], suite, strict=True):
        assert entry.get("classname") == case["kind"]
        assert (entry.find("failure") is None) == case["success"]
        assert case["kind"] in result.output
        assert case["verdict"] in " ".join(result.output.split())


@pytest.mark.long
@pytest.mark.parametrize("name", ["virtual", "lab", "bench"])
def test_every_fault_at_every_moment_is_within_its_bound(name, capsys):
    """Each ends held, or with the printed words."""
    found = run_matrix(load(name))["matrix"]
    failed = {f"{case['kind']}/{case['when']}": case["verdict"] for case in found if not case["success"]}
    with capsys.disabled():
        print(f"\n{name}: {len(found)} cases, {len(failed)} outside their bound")
    assert not failed
    moved = [case["motion_mm"] for case in found if "motion_mm" in case]
    assert np.isfinite(moved).all()
