"""What is configured of an FMU is what is hosted, in the process that is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from plant_fmu.config import FmuPlant
from plant_fmu.fmu import child
from plant_fmu.fmu.check import FmuSpec, fmu_spec
from plant_fmu.fmu.child import fmu_plant

SIX = ("1", "2", "3", "4", "5", "6")
SECTION: dict[str, Any] = {
    "type": "fmu",
    "path": "models/a.fmu",
    **{key: [key + k for k in SIX] for key in ("force", "length", "rate", "brake", "wrench")},
    "parameters": {"m": 1.5, "n": [1.0, 2.0]},
    "assume_unit": {"force": "N", "rate2": "m/s"},
    "allow_execution_tool": True,
    "memory_GB": 2.5,
    "step_us": 250.0,
}


def test_every_setting_of_an_fmu_has_its_place_in_what_is_hosted():
    names = {key: tuple(SECTION[key]) for key in ("force", "length", "rate", "brake", "wrench")}
    assert fmu_spec(FmuPlant.model_validate(SECTION), Path("/etc/robot")) == FmuSpec(
        path=Path("/etc/robot/models/a.fmu"),
        step_s=250e-6,
        **names,
        parameters=SECTION["parameters"],
        assume_unit=SECTION["assume_unit"],
        allow_execution_tool=True,
        memory_GB=2.5,
    )


def test_a_whole_path_stays_where_it_is():
    settings = FmuPlant.model_validate({**SECTION, "path": "/models/a.fmu"})
    assert fmu_spec(settings, Path("/etc/robot")).path == Path("/models/a.fmu")


@pytest.mark.parametrize(("isolation", "where"), [("in_process", "here"), ("child_process", "apart")])
def test_an_fmu_runs_in_the_process_that_is_asked_for(monkeypatch, isolation, where):
    monkeypatch.setattr(child, "FmuHost", lambda spec: ("here", spec))
    monkeypatch.setattr(child, "ChildHost", lambda spec: ("apart", spec))
    settings = FmuPlant.model_validate({**SECTION, "isolation": isolation, "allow_execution_tool": False})
    folder = Path("/etc")
    found: Any = fmu_plant(settings, folder)
    assert found == (where, fmu_spec(settings, folder))
