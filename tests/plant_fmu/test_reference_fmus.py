"""The Reference FMUs of the Modelica Association, from the folder that HIL_REFERENCE_FMUS names.

github.com/modelica/Reference-FMUs, built with cmake, as FMI 2.0 and 3.0: every *.fmu below the folder.
"""

import contextlib
import os
from pathlib import Path

import fmpy
import numpy as np
import pytest

from drivers.errors import PlantError
from hil.app.fmu import show_fmu
from plant_fmu.fmu import call as fmu_call
from plant_fmu.fmu import host
from plant_fmu.fmu.archive import open_archive
from plant_fmu.fmu.check import FmuSpec, Interface, library_candidates
from plant_fmu.fmu.host import FmuHost

FOLDER = os.environ.get("HIL_REFERENCE_FMUS", "")
PATHS = sorted(Path(FOLDER).rglob("*.fmu")) if FOLDER else []
pytestmark = pytest.mark.skipif(not PATHS, reason="HIL_REFERENCE_FMUS names no folder with *.fmu")
NOTHING = np.zeros(6)


def mapped_by_its_own_names(members, spec):
    """Take the first inputs and outputs for forces and lengths, however many there are."""
    description = fmpy.read_model_description(str(spec.path))
    major = int(description.fmiVersion[0])
    reals = [v for v in description.modelVariables if v.type in {"Real", "Float64"} and not v.shape]
    outputs = [int(v.valueReference) for v in reals if v.causality in {"output", "local"}][:1]
    found = tuple(outputs)
    (library,) = [
        n for n in library_candidates(major, description.coSimulation.modelIdentifier) if n in members
    ]
    return Interface(description, major, library, {}, {"length": found}, (), {})


@pytest.mark.parametrize("path", PATHS, ids=lambda path: f"{path.parent.parent.name}/{path.stem}")
def test_a_reference_fmu_is_read_shown_loaded_and_stepped(path, monkeypatch):
    with open_archive(path) as archive:
        assert "modelDescription.xml" in archive.namelist()
    if fmpy.read_model_description(str(path)).coSimulation is None:
        with pytest.raises(PlantError, match="no co-simulation interface"):
            show_fmu(path)
        return
    lines, summary = show_fmu(path)
    assert summary["missing"], "no hexapod is among them"
    assert len(lines) > 5
    spec = FmuSpec(path=str(path), force=["force"], length=["length"], rate=["rate"], step_us=10000)
    with pytest.raises(PlantError, match="no variable 'force'"):
        FmuHost(spec)
    monkeypatch.setattr(host, "read_interface", mapped_by_its_own_names)
    monkeypatch.setattr(fmu_call, "MEASURED", 1)
    with contextlib.closing(FmuHost(spec)) as plant:
        for _ in range(10):
            plant.step(NOTHING, NOTHING, NOTHING, 0.01)
        assert np.isfinite(plant._outputs).all()
        plant.reset()
