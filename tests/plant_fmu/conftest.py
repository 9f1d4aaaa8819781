"""Access to our FMU, variable by variable, through fmpy's own functions."""

import json
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave

from plant_fmu.stewart.build import build

DATA = Path(__file__).parent.parent / "data"


class Direct:
    """One instance of our FMI 3.0 FMU: set and get arrays by name."""

    def __init__(self, folder, description):
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.size = {v.name: int(np.prod(v.shape)) if v.shape else 1 for v in description.modelVariables}
        self.messages: list[str] = []
        self.fmu = FMU3Slave(
            guid=description.guid, unzipDirectory=str(folder), modelIdentifier="stewart", instanceName="t"
        )
        self.fmu.instantiate(
            logMessage=lambda env, status, category, message: self.messages.append(message.decode())
        )
        self.time = 0.0

    def set(self, **values):
        for name, value in values.items():
            if name == "leg_spin":
                self.fmu.setInt64([self.reference[name]], [{"none": 1, "universal": 2}[value]])
            else:
                self.fmu.setFloat64([self.reference[name]], [float(x) for x in np.ravel(value)])

    def get(self, name):
        return np.array(self.fmu.getFloat64([self.reference[name]], nValues=self.size[name]))

    def platform(self, g, leg_spin="none"):
        self.set(
            base_joints=g["base_joints"],
            platform_joints=g["platform_joints"],
            gravity=g["gravity"],
            leg_spin=leg_spin,
        )
        self.set(mass=g["platform"]["mass"], com=g["platform"]["com"], inertia=g["platform"]["inertia"])
        for half in ("cylinder", "rod"):
            part = g[half]
            inertia = [part["inertia_axial"] or 0.0, part["inertia_transverse"]]
            self.set(**{f"{half}_mass": part["mass"], f"{half}_com": part["com"], f"{half}_inertia": inertia})
        if "universal_joint_base_axes" in g:
            self.set(universal_joint_base_axes=g["universal_joint_base_axes"])

    def start(self, **inputs):
        self.fmu.enterInitializationMode()
        self.set(**inputs)
        self.fmu.exitInitializationMode()
        self.time = 0.0

    def step(self, dt, n=1):
        for _ in range(n):
            self.fmu.doStep(self.time, dt)
            self.time = round((self.time + dt) / 1e-9) * 1e-9


@pytest.fixture(scope="session")
def unpacked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu3")
    with zipfile.ZipFile(build("3.0")) as archive:
        archive.extractall(folder)
    return folder, fmpy.read_model_description(str(build("3.0")))


@pytest.fixture
def direct(unpacked):
    """Factory of instances; all are freed at the end."""
    made = []

    def make():
        made.append(Direct(*unpacked))
        return made[-1]

    yield make
    for instance in made:
        instance.fmu.fmi3FreeInstance(instance.fmu.component)


@pytest.fixture(scope="session")
def truth():
    return json.loads((DATA / "rigid_body_cases.json").read_text())
