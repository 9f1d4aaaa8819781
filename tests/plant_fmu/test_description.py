"""What our FMU says of its outputs and its terminals: what each depends on, and what belongs to which leg."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import fmpy
import pytest

from plant_fmu.stewart.build import build
from plant_fmu.stewart.description import terminals
from plant_fmu.stewart.variables import TYPES, VARIABLES

VERSIONS = pytest.mark.parametrize("version", ["2.0", "3.0"])
ALL = {v.name for v in VARIABLES if v.causality == "parameter"}
JOINTS = {"base_joints", "platform_joints"}
POSE = {"initial_position", "initial_rotation"}
BEHIND: dict[str, tuple[set[str], set[str]]] = {
    "length": (set(), JOINTS | POSE),
    "rate": (set(), JOINTS | POSE | {"initial_twist"}),
    "applied_force": ({"force"}, {"force_bandwidth"}),
    "position": (set(), {"initial_position"}),
    "rotation": (set(), {"initial_rotation"}),
    "twist": (set(), {"initial_twist"}),
    "acceleration": ({"force", "brake", "wrench"}, ALL),
    "kinetic_energy": (set(), ALL),
    "potential_energy": (set(), ALL),
}
"""Output -> inputs that it depends on at any time, and parameters that its first value depends on."""


def base(name: str) -> str:
    return name.split("[", maxsplit=1)[0]


@VERSIONS
def test_outputs_depend_on_their_inputs_and_first_values_on_the_parameters_behind_them_too(version):
    description = fmpy.read_model_description(str(build(version)))
    seen = set()
    for unknowns, first in ((description.outputs, False), (description.initialUnknowns, True)):
        for unknown in unknowns:
            name = base(unknown.variable.name)
            inputs, parameters = BEHIND[name]
            depends = [each.name for each in unknown.dependencies]
            assert {base(each) for each in depends} == (inputs | parameters if first else inputs), name
            assert unknown.dependenciesKind == ["dependent"] * len(depends)
            seen.add((name, first))
    assert seen == {(name, first) for name in BEHIND for first in (False, True)}


def test_the_applied_force_of_a_leg_depends_on_its_own_command_alone():
    description = fmpy.read_model_description(str(build("2.0")))
    found = {
        unknown.variable.name: [each.name for each in unknown.dependencies]
        for unknown in description.outputs
        if unknown.variable.name.startswith("applied_force")
    }
    assert found == {f"applied_force[{leg}]": [f"force[{leg}]"] for leg in range(1, 7)}


def test_every_element_depends_on_every_element_else():
    """36 of the four that place a leg, and so on: no element of an array is left out."""
    description = fmpy.read_model_description(str(build("2.0")))
    sizes = {v.name: v.size for v in VARIABLES}
    checked = 0
    for unknown in description.initialUnknowns:
        name = base(unknown.variable.name)
        if name != "applied_force":
            wanted = set.union(*BEHIND[name])
            assert len(unknown.dependencies) == sum(sizes[each] for each in wanted)
            checked += 1
    assert checked == sum(sizes[name] for name in BEHIND) - 6


def test_a_terminal_holds_what_belongs_to_its_leg_and_one_more_the_platform():
    found = {
        terminal.get("name"): (
            terminal.get("description"),
            {each.get("memberName"): each.get("variableName") for each in terminal},
        )
        for terminal in ET.fromstring(terminals()).iter("Terminal")
    }
    expected = {
        f"leg{leg}": (
            f"Drive and encoder of leg {leg}",
            {f"{name}[{leg}]": name for name in ("force", "brake", "length", "rate", "applied_force")},
        )
        for leg in range(1, 7)
    }
    names = ("wrench", "position", "rotation", "twist", "acceleration")
    expected["platform"] = ("Motion of the platform, wrench on it", {name: name for name in names})
    assert found == expected


@VERSIONS
def test_the_types_that_are_defined_are_those_of_single_elements(version):
    description = fmpy.read_model_description(str(build(version)))
    defined = [each.name for each in description.typeDefinitions]
    assert set(defined) == set(TYPES) - {"Mixed"}
    assert len(defined) == len(set(defined))
