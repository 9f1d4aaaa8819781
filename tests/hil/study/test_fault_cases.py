"""A case of the fault matrix whose plant fails by itself, before or after the fault has begun."""

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
from hil.study.faults.expected import PLANT_FAILS
from hil.study.faults.verdict import Bounds
from tests.hil.lab.bringup.families import family

BOUNDS = Bounds(stopping_m=0.163, controlled_m=0.283, harmless_m=0.01, harmless_s=0.01)
DESKTOP = Bounds(20e-3, 18e-3, 2e-3, 0.02)
REFUSED = "the FMU refused to step"


@pytest.fixture
def refuses(monkeypatch):
    """Let the plant of a case refuse every step once it has lived for so long, s, or since its fault began."""
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
    """Run a case of a configuration that has faults of its own."""
    (case,) = cases(with_faults(load("virtual"), own), [name])
    return run_case(Job(case, BOUNDS))


@pytest.mark.parametrize("kind", [*PLANT_FAILS, "encoder_jump"])
@pytest.mark.parametrize("at_s", [0.0, 0.02], ids=["in the first tick", "later"])
def test_a_plant_that_fails_before_the_fault_has_begun_is_not_judged_as_that_fault(refuses, kind, at_s):
    refuses(at_s)
    found = run(f"{kind}/LOADING")
    assert not found["success"]
    assert found["verdict"].startswith("could not be run: the fault did not begin")
    assert found["verdict"].endswith(REFUSED)


@pytest.mark.parametrize("kind", PLANT_FAILS)
def test_a_plant_that_fails_by_its_fault_has_said_so(kind):
    found = run(f"{kind}/LOADING")
    assert found["success"], found
    assert (found["ended"] == "plant failed") is (kind != "plant_hang")


def test_a_plant_that_fails_after_a_fault_of_another_kind_has_begun_is_a_failure(refuses):
    refuses(None)
    found = run("encoder_jump/LOADING")
    assert not found["success"]
    assert found["verdict"].startswith("the plant failed, allowed of ")
    assert found["reason"].startswith(REFUSED)


@pytest.mark.parametrize("own", ["encoder_noise leg=1 sigma=1e-9", "payload_step mass=10"])
def test_a_case_is_dated_by_its_own_fault_and_not_by_those_of_the_configuration(refuses, own):
    found = run("drive_silence/LOADING", own)
    assert found["after_ms"] == pytest.approx(4), found
    assert found["success"], found
    refuses(0.02)
    unbegun = run("plant_crash/LOADING", own)
    assert unbegun["verdict"].startswith("could not be run: the fault did not begin"), unbegun


LEARNED = {"file": "learned.csv", "limit_N": 500.0}


def test_the_reference_that_stands_serves_forces_learned_on_another_reference():
    c = loads(with_changes(load("virtual").text, {"feedforward": LEARNED}), "my.yaml")
    (case,) = cases(c, ["plant_crash/HOLD"])
    assert run_case(Job(case, BOUNDS))["verdict"] == "the plant failed and said so"


@pytest.mark.parametrize("moment", ["LOADING", "UNLOADING"])
def test_a_reference_that_is_fastest_at_once_is_followed_before_the_run_is_stopped(moment):
    """One that stands, for example: no instant of it is faster than the first."""
    c = load("virtual")
    held = c.model_copy(update={"reference": HoldReference(type="hold", duration_s=10.0)})
    (case,) = cases(held, [f"plant_crash/{moment}"])
    assert run_case(Job(case, BOUNDS))["verdict"] == "the plant failed and said so"


@pytest.mark.parametrize(
    ("name", "watched"), [("cubemars", False), pytest.param("damiao", True, marks=pytest.mark.long)]
)
def test_a_dead_bus_in_motion_is_a_failure_of_drives_without_a_watchdog_and_says_why(name, watched):
    (case,) = cases(family(name), ["bus_off/TRACKING"])
    found = run_case(Job(case, DESKTOP))
    assert found["faults"] == ["BUS"]
    assert found["success"] is watched, found["verdict"]
    told = (
        "the platform moves at the end" in found["verdict"]
        and "they keep the last torque" in found["verdict"]
    )
    assert told is not watched
    assert watched or "have no watchdog that is set from here" in found["verdict"]


@pytest.mark.long
@pytest.mark.parametrize(("name", "stands"), [("moteus_stopped", False), ("damiao", True)])
def test_drives_that_a_strangers_torque_enables_again_are_a_failure_and_it_says_why(name, stands):
    (case,) = cases(family(name), ["frames_forged_command/HOLD"])
    found = run_case(Job(case, DESKTOP))
    assert found["faults"] == ["SECOND_CONTROLLER"]
    assert found["success"] is stands, found["verdict"]
    assert ("obey whoever commands" in found["verdict"]) is not stands
