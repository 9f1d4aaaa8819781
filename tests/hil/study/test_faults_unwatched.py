"""What `hil faults` says of drives that nothing stops: which hear no frame, or obey a stranger."""

from __future__ import annotations

import pytest

from hil.study.faults.case_run import Job, run_case
from hil.study.faults.cases import cases
from hil.study.faults.verdict import Bounds
from tests.hil.lab.bringup.families import family

BOUNDS = Bounds(20e-3, 18e-3, 2e-3, 0.02)


@pytest.mark.parametrize(
    ("name", "watched"), [("cubemars", False), pytest.param("damiao", True, marks=pytest.mark.long)]
)
def test_a_dead_bus_in_motion_is_a_failure_of_drives_without_a_watchdog_and_says_why(name, watched):
    (case,) = cases(family(name), ["bus_off/TRACKING"])
    found = run_case(Job(case, BOUNDS))
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
    found = run_case(Job(case, BOUNDS))
    assert found["faults"] == ["SECOND_CONTROLLER"]
    assert found["success"] is stands, found["verdict"]
    assert ("obey whoever commands" in found["verdict"]) is not stands
