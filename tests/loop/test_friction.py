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
from hil.app.configuration.configuration import load, loads
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from plant_fmu.config import StewartPlant
from plant_fmu.plant import Robot
from plant_fmu.stewart.build import build
from plant_fmu.stewart.plant import stewart_parameters
from tests.loop import unrecorded

TRUTH = json.loads((Path(__file__).parents[1] / "data" / "rigid_body_cases.json").read_text())
LOW, HIGH = np.full(6, 1e-3), np.full(6, 1e3)
SPREAD = np.array([1.0, 0.9, 0.8, 0.7, 0.6, 0.5])
VISCOUS, COULOMB, REFLECTED = 2000.0 * SPREAD, 150.0 * SPREAD, 500.0 * SPREAD[::-1]


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


MOVING = [c for c in TRUTH["cases"] if np.abs(c["expected"]["rates"]).min() > 1e-3]
"""All legs slide: no stiction in the plant, no slope in the model."""


@pytest.mark.parametrize("spin", ["none", "universal"])
def test_the_plant_accelerates_as_the_model_says_in_every_moving_state(acceleration, spin):
    settings = StewartPlant(type="stewart", force_bandwidth_Hz=0.0)
    worst = bare = 0.0
    for case in MOVING:
        s, geometry = case["state"], TRUTH["geometries"][case["geometry"]]
        p, R, twist = np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"])
        parameters = stewart_parameters(settings, Robot({**geometry, "leg_spin": spin}, LOW, HIGH, p, R))
        drives = {
            "initial_twist": twist,
            "viscous_friction": VISCOUS,
            "coulomb_friction": COULOMB,
            "reflected_mass": REFLECTED,
        }
        plant = acceleration(parameters | drives, s["f"])
        platform = Platform.from_dict(geometry)
        model = Model(platform, leg_spin=spin, reflected_mass=REFLECTED, viscous=VISCOUS, coulomb=COULOMB)
        size = max(np.abs(plant).max(), 1.0)
        own = model.forward_dynamics(p, R, twist, s["f"])
        worst = max(worst, float(np.abs(own - plant).max()) / size)
        rigid = Model(platform, leg_spin=spin).forward_dynamics(p, R, twist, s["f"])
        bare = max(bare, float(np.abs(rigid - plant).max()) / size)
    assert worst <= 1e-9
    assert bare > 0.1  # the drives matter in these states
    assert len(MOVING) >= 20


def bench(model="", plant=""):
    """configs/ideal.yaml with further keys of the controller's model and of the plant's."""
    ideal = load("ideal")
    text = ideal.text
    for line, keys in (("    variant: full\n", model), ("    internal_step_us: 100\n", plant)):
        assert text.count(line) == 1
        text = text.replace(line, line + "".join(f"    {key}\n" for key in keys.split("; ") if key))
    return loads(text, "ideal with drives", ideal.folder)


FRICTION_AND_MASS = "viscous_friction_N_s_m: 2000; reflected_mass_kg: 500"
COULOMB_FRICTION = "coulomb_friction_N: 200"


@pytest.mark.parametrize(
    ("model", "plant", "least_mm", "most_mm"),
    [
        (FRICTION_AND_MASS, FRICTION_AND_MASS, 0.015, 0.035),  # 0.026: sampling, as without either (0.032)
        ("", FRICTION_AND_MASS, 20.0, 25.0),  # 22.7
        (COULOMB_FRICTION, COULOMB_FRICTION, 0.03, 0.1),  # 0.073: the reversals
        (COULOMB_FRICTION + "; sliding_speed_m_s: 0", COULOMB_FRICTION, 0.3, 0.4),  # 0.34: legs stick
        ("", COULOMB_FRICTION, 1.5, 2.0),  # 1.79
    ],
)
def test_the_error_is_that_of_sampling_if_the_model_knows_the_drives(model, plant, least_mm, most_mm):
    summary, _ = unrecorded.run(bench(model, plant))
    assert summary["success"], summary
    assert not any(summary["limited_ticks"].values()), summary["limited_ticks"]
    assert least_mm < summary["tracking"]["peak_leg_error_mm"] < most_mm


@pytest.mark.parametrize(
    ("keys", "path"),
    [
        ("reflected_mass_kg: -1", "reflected_mass_kg"),
        ("viscous_friction_N_s_m: [1, 2]", "viscous_friction_N_s_m"),
        ("coulomb_friction_N: .nan", "coulomb_friction_N"),
        ("coulomb_friction: 1", "coulomb_friction"),
        ("sliding_speed_m_s: [1, 1, 1, 1, 1, 1]", "sliding_speed_m_s"),
    ],
)
def test_drives_without_meaning_are_refused_at_their_line(keys, path):
    with pytest.raises(ConfigurationError, match=rf"controller\.model\.{path}\b"):
        bench(keys)
