"""Injected faults in whole runs, and the matrix that judges them: some cases here, the rest in `make long`."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from drivers.signals import Mode
from hil.app.configuration.configuration import load
from hil.app.configuration.fault_words import read_fault, show_fault, with_faults
from hil.cli import main
from hil.loop.run_end import Course
from hil.study.faults.case_run import Job, run_case
from hil.study.faults.cases import LEG, MATRIX, cases
from hil.study.faults.command import run_matrix
from hil.study.faults.verdict import Bounds
from plant_fmu.faults import FAULTS
from tests.broad import broad
from tests.live_reference import LIVE_REFERENCE
from tests.loop.bench import bench, changed

BOUNDS = Bounds(stopping_m=0.163, controlled_m=0.283, harmless_m=0.01, harmless_s=0.01)
KINDS = [name for name in FAULTS if not name.startswith(("process", "sensor"))]


def test_fault_matrix_has_each_kind_of_fault_at_each_moment_for_each_given_leg():
    c = load("virtual")
    found = cases(c)
    assert sorted(case.name for case in found) == sorted(f"{k}/{m}" for k in KINDS for m in MATRIX)
    assert {case.fault.leg for case in found if hasattr(case.fault, "leg")} == {LEG}
    kinds = {str(case.fault.kind) for case in cases(load("bench"))}
    assert kinds == {k for k in KINDS if k.startswith(("drive_", "frames_"))}
    found = cases(c, ["drive_silence", "drive_saturation/HOLD", "bus_off"], legs=[0, 5])
    legs = [getattr(case.fault, "leg", None) for case in found]
    assert legs == [*(0, 5) * len(MATRIX), 0, 5, *[None] * len(MATRIX)]
    with pytest.raises(ConfigurationError, match="--legs: unknown leg 6"):
        cases(c, legs=[6])
    with pytest.raises(ConfigurationError, match="waits for set-points"):
        cases(changed(c, reference=LIVE_REFERENCE))


def test_seed_draws_leg_size_and_sign_of_a_fault_and_the_printed_text_recreates_it():
    c = load("virtual")
    drawn: list[Any] = [
        case.fault for seed in range(40) for case in cases(c, ["encoder_jump/HOLD"], seed=seed)
    ]
    assert {fault.leg for fault in drawn} == set(range(6))
    sizes = np.array([fault.by_m for fault in drawn])
    assert (sizes > 0).any()
    assert (sizes < 0).any()
    assert 1e-3 <= np.abs(sizes).min() <= np.abs(sizes).max() <= 0.5
    assert (np.abs(sizes) > 0.05).sum() >= 5, "large ones, too"
    assert cases(c, ["encoder_jump/HOLD"], seed=7)[0].fault in [each.fault for each in cases(c, seed=7)]
    for case in cases(c, seed=3):
        again = read_fault(show_fault(case.fault))
        assert again.model_copy(update={"at_s": case.fault.at_s}) == case.fault


def one(pattern: str, configuration: str = "virtual") -> dict[str, Any]:
    (case,) = cases(load(configuration), [pattern])
    found = run_case(Job(case, BOUNDS))
    assert found["success"], found
    return found


@pytest.mark.parametrize(
    ("pattern", "ended", "faults", "legs"),
    [
        ("brake_stuck_open/PARKING", "HELD", ["BRAKE"], [LEG]),
        ("drive_silence/TRACKING", "HELD", ["STALE"], [LEG]),
        ("frames_forged_feedback/HOLD", None, ["DUPLICATE_NODE"], [LEG]),
        ("frames_forged_command/APPROACH", None, ["SECOND_CONTROLLER"], None),
        pytest.param("bus_flood/HOLD", "FAULT", ["STALE"], [], marks=pytest.mark.long),
    ],
)
def test_fault_matrix_case_ends_in_the_expected_mode_and_reports_fault_and_leg(pattern, ended, faults, legs):
    found = one(pattern)
    assert found["faults"] == faults
    assert ended in {None, found["ended"]}
    assert legs is None or found["legs"] == legs
    assert "motion_mm" not in found or found["motion_mm"] <= 10 or not pattern.startswith("brake")
    assert found["after_ms"] <= 4 or pattern.startswith(("brake", "bus"))


@pytest.mark.parametrize("moment", broad(["PARKING", "TRACKING"], quick=1))
def test_swapped_wires_do_not_drive_a_leg_through_its_brake(moment):
    """Where it is fastest, and where the law still acts while the brakes close: without the rule it moved
    0.68 and 0.87 m.
    """
    found = one(f"drive_sign/{moment}")
    assert found["ended"] in {"PARKED", "HELD"}
    assert "DRIVE" in found["faults"]
    assert f"drive {LEG} does not obey" in found["reason"]


def test_fault_that_no_measurement_shows_is_classified_as_not_observable():
    found = one("encoder_scale/HOLD")
    assert (found["ended"], found["faults"]) == ("PARKED", [])
    assert found["verdict"].startswith("not observable with these sensors")


def test_fault_matrix_case_repeated_with_its_seed_gives_the_same_result():
    first, second = (one("frames_loss/LOADING") for _ in range(2))
    assert {**first, "wall_s": 0} == {**second, "wall_s": 0}


@pytest.mark.long
def test_fault_matrix_case_with_endless_brake_tests_is_classified_within_30_s():
    """Lost frames: the platform stands on closed brakes, and its holding force stays on."""
    found = one("frames_loss/TRACKING", "desktop")
    assert (found["ended"], found["faults"]) == ("HELD", ["STALE"])


@pytest.mark.parametrize("mode", [Mode.LOADING, Mode.APPROACH, Mode.TRACKING, Mode.PARKING])
def test_time_of_a_fault_tied_to_a_mode_counts_from_the_entry_into_that_mode(mode):
    words = f"encoder_noise leg=0 sigma=0 mode={mode.name} at=0.02"
    fault = read_fault(words)
    with bench(with_faults(load("virtual"), [words])) as lockstep:
        course, entered, now = Course(lockstep.cycle, 2.5), 0, Mode.WAITING
        begins_ns = lockstep.nodes.schedule.starts_ns
        while begins_ns(fault) >= (lockstep.tick + 1) * 1e6:
            lockstep.step(course.commands(lockstep.tick + 1))
            assert course.ending(lockstep.tick) is None
            if lockstep.cycle.mode is not now:
                entered, now = lockstep.tick, lockstep.cycle.mode
        assert now is mode
        assert 1e-9 * begins_ns(fault) - 1e-3 * entered == pytest.approx(0.02, abs=1e-3)


def test_run_summary_lists_injected_faults_and_faults_whose_time_was_not_reached(tmp_path):
    """The shipped path never stands still, so the HOLD moment is not reached."""
    faults = ("freeze leg=0 mode=HOLD", "noise leg=1 sigma=1e-6 at=1", "jump leg=2 at=99 by=1e-3")
    words = [word for fault in faults for word in ("--fault", f"encoder_{fault}")]
    files = ["--log", str(tmp_path / "a.mcap"), "--json", str(tmp_path / "a.json")]
    result = CliRunner().invoke(main, ["sim", "virtual", "--duration", "1.2", *files, *words])
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "a.json").read_text())
    assert summary["mode_not_reached"] == ["encoder_freeze mode=HOLD leg=0"]
    assert summary["injected"] == ["encoder_noise at=1 leg=1 sigma=1e-06"]
    assert [each.split()[0] for each in summary["time_not_reached"]] == ["encoder_jump"]
    assert summary["replay"]["agrees"], "faults are in the frames, which the log has"


def test_fault_matrix_command_prints_a_table_and_writes_json_and_junit_files(tmp_path):
    files = ["--json", str(tmp_path / "a.json"), "--junit", str(tmp_path / "a.xml")]
    only = ["--only", "drive_reset/LOADING", "--only", "plant_crash/LOADING", "--legs", "3,0,3"]
    result = CliRunner().invoke(main, ["faults", "virtual", "--jobs", "1", *only, *files])
    summary = json.loads((tmp_path / "a.json").read_text())
    assert result.exit_code == (0 if summary["success"] else 1), result.output
    found = [(case["kind"], case["given"]) for case in summary["matrix"]]
    assert found == [("drive_reset", "leg=3"), ("drive_reset", "leg=0"), ("plant_crash", "")]
    suite = ET.parse(tmp_path / "a.xml").getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("3", str(summary["failed"]))
    for case, entry in zip(summary["matrix"], suite, strict=True):
        assert entry.get("classname") == case["kind"]
        assert (entry.find("failure") is None) == case["success"]
        assert case["verdict"] in " ".join(result.output.split())


BENCHES = ("virtual", "lab", "bench")
SHARES: dict[str, list[str]] = {name: [] for name in BENCHES}
"""Every kind at every moment, alternating over the benches that have it; each bench gets each of its kinds."""
for _n, _kind in enumerate(KINDS):
    _fit = BENCHES if _kind.startswith(("drive_", "frames_")) else BENCHES[:2]
    for _m, _moment in enumerate(MATRIX):
        SHARES[_fit[(_n + _m) % len(_fit)]].append(f"{_kind}/{_moment}")


@pytest.mark.long
@pytest.mark.parametrize("name", BENCHES)
def test_leg_motion_after_every_fault_at_every_moment_is_within_its_bound(name):
    """Each case ends held, or with its printed verdict."""
    found = run_matrix(load(name), only=SHARES[name])["matrix"]
    assert len(found) == len(SHARES[name])
    assert not {f"{case['kind']}/{case['when']}": case["verdict"] for case in found if not case["success"]}
    assert np.isfinite([case["motion_mm"] for case in found if "motion_mm" in case]).all()
