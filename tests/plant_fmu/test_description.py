"""Both descriptions of our FMU: valid, equivalent, and in agreement with the binary."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from lxml import etree  # type: ignore[import-untyped]

from plant_fmu.stewart.build import build
from plant_fmu.stewart.variables import VARIABLES

VERSIONS = pytest.mark.parametrize("version", ["2.0", "3.0"])
SCHEMA = Path(fmpy.__file__).parent / "schema"
UNITS = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "N/m": {"kg": 1, "s": -2},
    "N.s/m": {"kg": 1, "s": -1},
    "kg": {"kg": 1},
    "kg.m2": {"kg": 1, "m": 2},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "Hz": {"s": -1},
    "s": {"s": 1},
    "J": {"kg": 1, "m": 2, "s": -2},
}
"""BIPM, The International System of Units (2019), table 4."""
BOOK = {
    "mass": [1150.0],
    "inertia": [570.0, 0.0, 0.0, 0.0, 285.0, 0.0, 0.0, 0.0, 285.0],
    "cylinder_mass": [85.0],
    "cylinder_com": [0.75],
    "cylinder_inertia": [0.0, 16.0],
    "rod_mass": [22.0],
    "rod_com": [0.75],
    "rod_inertia": [0.0, 4.1],
    "gravity": [0.0, 0.0, -9.81],
    "brake": [1.0] * 6,
    "initial_position": [0.0, 0.0, 1.0],
}
"""Taghirad, Parallel Robots (2013), chapter 5; brakes are engaged."""


def described(version: str) -> Any:
    return fmpy.read_model_description(str(build(version)))  # type: ignore[arg-type]


def test_fmi_build_description_follows_its_schema():
    with zipfile.ZipFile(build("3.0")) as archive:
        root = etree.fromstring(archive.read("sources/buildDescription.xml"))
    etree.XMLSchema(file=str(SCHEMA / "fmi3" / "fmi3BuildDescription.xsd")).assertValid(root)


def elements(version: str) -> list[tuple[Any, ...]]:
    """Name, causality, start value and unit of each element; in FMI 3 those of its array."""
    found = []
    for v in described(version).modelVariables:
        count = int(np.prod(v.shape)) if v.shape else 1
        starts: list[float | None] = [None] * count
        if v.start is not None:
            starts = [float(x) for x in str(v.start).split()]
        assert len(starts) == count, v.name
        found += [(v.name.split("[")[0], v.causality, start, v.unit) for start in starts]
    return found


def test_fmi_2_and_fmi_3_descriptions_state_the_same_values_and_units():
    two, three = elements("2.0"), elements("3.0")
    # arrays of two units each, which FMI 3 cannot state
    mixed = {"initial_twist", "wrench", "twist", "acceleration"}
    assert [each[:3] for each in two] == [each[:3] for each in three]
    assert [each for each in two if each[0] not in mixed] == [each for each in three if each[0] not in mixed]
    for name, line, turn in (("wrench", "N", "N.m"), ("twist", "m/s", "rad/s")):
        assert [each[3] for each in two if each[0] == name] == [line] * 3 + [turn] * 3
    for name, values in BOOK.items():
        assert [each[2] for each in two if each[0] == name] == values, name
    outputs = {v.name for v in VARIABLES if v.causality == "output"}
    for version in ("2.0", "3.0"):
        assert {u.variable.name.split("[")[0] for u in described(version).outputs} == outputs


def test_fmu_binary_has_the_start_values_of_its_model_description(direct):
    plant = direct()
    for v in described("3.0").modelVariables:
        if v.causality in {"parameter", "input"} and v.type == "Float64":
            np.testing.assert_array_equal(plant.get(v.name), [float(x) for x in str(v.start).split()], v.name)


@VERSIONS
def test_units_in_the_model_description_have_the_si_exponents_of_their_names(version):
    base = ("kg", "m", "s", "rad", "A", "K", "mol", "cd")
    found = {unit.name: unit.baseUnit for unit in described(version).unitDefinitions}
    assert {name: {k: n for k in base if (n := getattr(unit, k))} for name, unit in found.items()} == UNITS
    assert all((unit.factor, unit.offset) == (1.0, 0.0) for unit in found.values())


def test_model_description_lists_the_direct_feedthrough_of_each_output():
    depends = {u.variable.name: {d.name for d in u.dependencies} for u in described("3.0").outputs}
    assert depends["acceleration"] == {"force", "brake", "wrench"}
    assert depends["applied_force"] == {"force"}
    assert depends["length"] == depends["twist"] == depends["kinetic_energy"] == set()
    first = {u.variable.name: {d.name for d in u.dependencies} for u in described("3.0").initialUnknowns}
    assert first["length"] == {"base_joints", "platform_joints", "initial_position", "initial_rotation"}
