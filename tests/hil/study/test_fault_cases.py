"""Cases of the fault matrix whose plant fails by itself, before or after the fault begins."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.errors import PlantError
from hil.app import compose
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.fault_words import with_faults
from hil.config.reference import HoldReference
from hil.study.faults import case_run
from hil.study.faults.case_run import Job, run_case
from hil.study.faults.cases import cases
from hil.study.faults.diagnoses import PLANT_FAILS
from hil.study.faults.sizes import robot_of, size_of
from hil.study.faults.verdict import Bounds
from tests.hil.lab.bringup.families import family

BOUNDS = Bounds(stopping_m=0.163, controlled_m=0.283, harmless_m=0.01, harmless_s=0.01)
DESKTOP = Bounds(20e-3, 18e-3, 2e-3, 0.02)
REFUSED = "the FMU refused to step"


@pytest.fixture
def refuses(monkeypatch):
    """Make the plant of a case refuse every step after a time, s, or after the fault's beginning."""
    build = compose.build_nodes

    def from_s(at_s: float | None) -> None:
        def built(*arguments: Any) -> Any:
            nodes, physics = build(*arguments)
            plant: Any = physics
            step, moved = plant.step, plant.moved

            def refuse(*given: Any) -> Any:
                if nodes.schedule.begun(nodes.now_ns) if at_s is None else nodes.now_ns >= 1e9 * at_s:
                    raise PlantError(REFUSED)
                plant.moved = moved
                answer = step(*given)
                plant.moved = None
                return answer

            plant.step, plant.moved = refuse, None  # not by the address of its function
            return nodes, physics

        monkeypatch.setattr(case_run, "build_nodes", built)

    return from_s


def run(name: str, *own: str) -> dict[str, Any]:
    """Run a case of a configuration with faults of its own."""
    (case,) = cases(with_faults(load("virtual"), own), [name])
    return run_case(Job(case, BOUNDS))


@pytest.mark.parametrize("kind", [*PLANT_FAILS, "encoder_jump"])
@pytest.mark.parametrize("at_s", [0.0, 0.02], ids=["in the first tick", "later"])
def test_fault_case_whose_plant_fails_before_the_fault_is_reported_as_not_run(refuses, kind, at_s):
    refuses(at_s)
    found = run(f"{kind}/LOADING")
    assert not found["success"]
    assert found["verdict"].startswith("could not be run: the fault did not begin")
    assert found["verdict"].endswith(REFUSED)


@pytest.mark.parametrize("kind", PLANT_FAILS)
def test_fault_case_whose_fault_makes_the_plant_fail_passes(kind):
    found = run(f"{kind}/LOADING")
    assert found["success"], found
    assert (found["ended"] == "plant failed") is (kind != "plant_hang")


def test_fault_case_fails_if_the_plant_fails_after_a_fault_kind_that_does_not_allow_it(refuses):
    refuses(None)
    found = run("encoder_jump/LOADING")
    assert not found["success"]
    assert found["verdict"].startswith("the plant failed, allowed only for ")
    assert found["reason"].startswith(REFUSED)


@pytest.mark.parametrize("own", ["encoder_noise leg=1 sigma=1e-9", "payload_step mass=10"])
def test_reaction_time_counts_from_the_fault_of_the_case_not_from_configured_faults(refuses, own):
    found = run("drive_silence/LOADING", own)
    assert found["after_ms"] == pytest.approx(4), found
    assert found["success"], found
    refuses(0.02)
    unbegun = run("plant_crash/LOADING", own)
    assert unbegun["verdict"].startswith("could not be run: the fault did not begin"), unbegun


LEARNED = {"file": "learned.csv", "limit_N": 500.0}


def test_fault_case_on_hold_ignores_a_feedforward_file_learned_on_the_path():
    c = loads(with_changes(load("virtual").text, {"feedforward": LEARNED}), "my.yaml")
    (case,) = cases(c, ["plant_crash/HOLD"])
    assert run_case(Job(case, BOUNDS))["verdict"] == "the plant failed and reported it"


@pytest.mark.parametrize("moment", ["LOADING", "UNLOADING"])
def test_fault_case_tracks_a_reference_that_is_fastest_at_its_start_before_it_stops(moment):
    """For example a constant reference, which is nowhere faster than at its start."""
    c = load("virtual")
    held = c.model_copy(update={"reference": HoldReference(type="hold", duration_s=10.0)})
    (case,) = cases(held, [f"plant_crash/{moment}"])
    assert run_case(Job(case, BOUNDS))["verdict"] == "the plant failed and reported it"


@pytest.mark.parametrize(
    ("name", "watched"), [("cubemars", False), pytest.param("damiao", True, marks=pytest.mark.long)]
)
def test_fault_case_of_a_dead_bus_in_motion_fails_for_drives_without_a_watchdog(name, watched):
    (case,) = cases(family(name), ["bus_off/TRACKING"])
    found = run_case(Job(case, DESKTOP))
    assert found["faults"] == ["BUS"]
    assert found["success"] is watched, found["verdict"]
    reported = (
        "the platform moves at the end" in found["verdict"]
        and "they keep the last torque" in found["verdict"]
    )
    assert reported is not watched
    assert watched or "have no watchdog that this program sets" in found["verdict"]


@pytest.mark.long
@pytest.mark.parametrize(("name", "stands"), [("moteus_stopped", False), ("damiao", True)])
def test_fault_case_of_a_forged_command_fails_for_drives_that_it_enables_again(name, stands):
    (case,) = cases(family(name), ["frames_forged_command/HOLD"])
    found = run_case(Job(case, DESKTOP))
    assert found["faults"] == ["SECOND_CONTROLLER"]
    assert found["success"] is stands, found["verdict"]
    assert ("obey commands of any sender" in found["verdict"]) is not stands


def test_default_wrench_step_is_a_quarter_of_the_weight_along_gravity():
    """A quarter of the weight of 10 kg on a wall: 24.525 N."""
    c = loads(with_changes(load("desktop").text, {"platform": {"gravity_m_s2": [-9.81, 0, 0]}}), "wall.yaml")
    assert size_of("wrench_step", robot_of(c), 0, None)["force_N"] == pytest.approx((-24.525, 0, 0))
