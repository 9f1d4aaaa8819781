"""Friction and reflected mass in the controller's model against the plant's, which is written on its own."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave

from drivers.errors import ConfigurationError
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from plant_fmu.config import StewartPlant
from plant_fmu.plant import Robot
from plant_fmu.stewart.build import build
from plant_fmu.stewart.plant import stewart_parameters
from tests.loop.bench import changed, succeeded

TRUTH = json.loads((Path(__file__).parents[1] / "data" / "rigid_body_cases.json").read_text())
LOW, HIGH = np.full(6, 1e-3), np.full(6, 1e3)
SPREAD = np.array([1.0, 0.9, 0.8, 0.7, 0.6, 0.5])
VISCOUS, COULOMB, REFLECTED = 2000.0 * SPREAD, 150.0 * SPREAD, 500.0 * SPREAD[::-1]
MOVING = [c for c in TRUTH["cases"] if np.abs(c["expected"]["rates"]).min() > 1e-3]
"""All legs slide: no stiction in the plant, no slope in the model."""


@pytest.fixture(scope="module")
def acceleration(tmp_path_factory):
    """The built FMU's acceleration for parameters and leg forces, before anything moves."""
    folder = tmp_path_factory.mktemp("stewart")
    archive = build("3.0")
    with zipfile.ZipFile(archive) as files:
        files.extractall(folder)
    description = fmpy.read_model_description(str(archive))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    fmu = FMU3Slave(
        guid=description.guid, unzipDirectory=str(folder), modelIdentifier="stewart", instanceName="friction"
    )
    fmu.instantiate()

    def of(parameters, force):
        fmu.reset()
        for name, value in parameters.items():
            if name == "leg_spin":
                fmu.setInt64([reference[name]], [{"none": 1, "universal": 2}[value]])
            else:
                fmu.setFloat64([reference[name]], [float(x) for x in np.ravel(value)])
        fmu.enterInitializationMode()
        fmu.setFloat64([reference["brake"]], [0.0] * 6)
        fmu.setFloat64([reference["force"]], list(force))
        fmu.exitInitializationMode()
        return np.array(fmu.getFloat64([reference["acceleration"]], nValues=6))

    yield of
    fmu.freeInstance()


@pytest.mark.parametrize("spin", ["none", "universal"])
def test_the_plant_accelerates_as_the_model_says_in_every_moving_state(acceleration, spin):
    settings = StewartPlant(type="stewart", force_bandwidth_Hz=0.0)
    drives = {"viscous_friction": VISCOUS, "coulomb_friction": COULOMB, "reflected_mass": REFLECTED}
    worst = bare = 0.0
    for case in MOVING:
        s, geometry = case["state"], TRUTH["geometries"][case["geometry"]]
        p, R, twist = np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"])
        parameters = stewart_parameters(settings, Robot({**geometry, "leg_spin": spin}, LOW, HIGH, p, R))
        plant = acceleration(parameters | drives | {"initial_twist": twist}, s["f"])
        platform, size = Platform.from_dict(geometry), max(np.abs(plant).max(), 1.0)
        model = Model(platform, leg_spin=spin, reflected_mass=REFLECTED, viscous=VISCOUS, coulomb=COULOMB)
        off, rigid = (
            float(np.abs(each.forward_dynamics(p, R, twist, s["f"]) - plant).max()) / size
            for each in (model, Model(platform, leg_spin=spin))
        )
        worst, bare = max(worst, off), max(bare, rigid)
    assert worst <= 1e-9
    assert bare > 0.1, "the drives matter in these states"
    assert len(MOVING) >= 20


BOTH = {"viscous_friction_N_s_m": 2000, "reflected_mass_kg": 500}
DRY = {"coulomb_friction_N": 200}


@pytest.mark.parametrize(
    ("model", "plant", "least_mm", "most_mm"),
    [
        (BOTH, BOTH, 0.015, 0.035),  # 0.026: sampling, as without either (0.032)
        ({}, BOTH, 20.0, 25.0),  # 22.7
        (DRY, DRY, 0.03, 0.1),  # 0.073: the reversals
        (DRY | {"sliding_speed_m_s": 0}, DRY, 0.3, 0.4),  # 0.34: legs stick
        ({}, DRY, 1.5, 2.0),  # 1.79
    ],
)
def test_the_error_is_that_of_sampling_if_the_model_knows_the_drives(model, plant, least_mm, most_mm):
    ran = succeeded(changed("ideal", controller={"model": model}, plant={"model": plant}))
    assert least_mm < ran.summary["tracking"]["peak_leg_error_mm"] < most_mm


@pytest.mark.parametrize(
    ("key", "value"),
    [("reflected_mass_kg", -1), ("viscous_friction_N_s_m", [1, 2]), ("coulomb_friction", 1)],
)
def test_drives_without_meaning_are_refused(key, value):
    with pytest.raises(ConfigurationError, match=rf"controller\.model\.{key}\b"):
        changed("ideal", controller={"model": {key: value}})
