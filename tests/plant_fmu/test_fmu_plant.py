"""What is configured of an FMU is what is hosted, in the process that is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from plant_fmu.config import FmuPlant
from plant_fmu.fmu import child
from plant_fmu.fmu.check import fmu_spec

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


def test_what_is_configured_is_hosted_with_a_path_from_the_folder() -> None:
    settings = FmuPlant.model_validate(SECTION)
    spec = fmu_spec(settings, Path("/etc/robot"))
    assert spec.model_dump() == {**settings.model_dump(), "path": "/etc/robot/models/a.fmu", "truth": []}
    assert spec.step_s == 250e-6


def test_a_whole_path_stays_where_it_is() -> None:
    settings = FmuPlant.model_validate({**SECTION, "path": "/models/a.fmu"})
    assert fmu_spec(settings, Path("/etc/robot")).path == "/models/a.fmu"


@pytest.mark.parametrize(("isolation", "where"), [("in_process", "here"), ("child_process", "apart")])
def test_an_fmu_runs_in_the_process_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, isolation: str, where: str
) -> None:
    monkeypatch.setattr(child, "FmuHost", lambda spec: ("here", spec))
    monkeypatch.setattr(child, "ChildHost", lambda spec: ("apart", spec))
    settings = FmuPlant.model_validate({**SECTION, "isolation": isolation, "allow_execution_tool": False})
    spec = fmu_spec(settings, Path("/etc"))
    found: Any = child.host(spec)
    assert found == (where, spec)
