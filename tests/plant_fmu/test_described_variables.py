"""Both descriptions of our FMU: what they say of each variable and type, of the simulation and of its sources."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest

from plant_fmu.stewart.description import (
    build_description,
    model_description,
    terminals,
)
from plant_fmu.stewart.variables import TYPES
from tests.plant_fmu.test_variables import MIXED, TABLE, count

TWO, THREE = (ET.fromstring(model_description(version, "{t}", ("a.c", "b.c"))) for version in ("2.0", "3.0"))
BOTH = pytest.mark.parametrize("root", [TWO, THREE], ids=["2.0", "3.0"])
VARIABILITY = {
    "independent": ("continuous", None),
    "parameter": ("fixed", "exact"),
    "input": ("continuous", None),
    "output": ("continuous", "calculated"),
}
KINDS = {
    "time": "Time",
    "base_joints": "Length",
    "cylinder_com": "Distance",
    "cylinder_inertia": "PrincipalInertia",
    "stop_stiffness": "Stiffness",
    "brake_force": "ForceBound",
    "force": "Force",
    "brake": "Engagement",
    "length": "Length",
    "rate": "Velocity",
    "rotation": "RotationElement",
    "kinetic_energy": "Energy",
}
"""Of some variables, the types of their elements."""


def elements(name: str) -> list[str]:
    shape = TABLE[name][1]
    if len(shape) == 2:
        return [f"{name}[{i + 1},{j + 1}]" for i in range(shape[0]) for j in range(shape[1])]
    return [f"{name}[{i + 1}]" for i in range(shape[0])] if shape else [name]


def about(variable: ET.Element) -> tuple[str | None, str | None, str | None]:
    return variable.get("causality"), variable.get("variability"), variable.get("initial")


def test_fmi_2_has_a_scalar_for_each_element_at_its_place_with_its_own_first_value_type_and_unit():
    scalars = TWO.findall("ModelVariables/ScalarVariable")
    assert [v.get("name") for v in scalars] == [each for name in TABLE for each in elements(name)]
    assert [v.get("valueReference") for v in scalars] == [str(k) for k in range(len(scalars))]
    found = iter(scalars)
    for name, (causality, shape, start, _) in TABLE.items():
        for k in range(count(shape)):
            scalar = next(found)
            (kind,) = scalar
            assert about(scalar) == (causality, *VARIABILITY[causality]), name
            if name == "leg_spin":
                assert (kind.tag, kind.get("declaredType"), kind.get("start")) == (
                    "Enumeration",
                    "LegSpin",
                    "1",
                )
                continue
            declared = kind.get("declaredType")
            assert declared is not None
            linear, angular = MIXED.get(name, (KINDS.get(name, declared),) * 2)
            assert (kind.tag, declared) == ("Real", linear if k < 3 or name not in MIXED else angular)
            assert kind.get("unit") == TYPES[declared].unit
            assert kind.get("start") == (None if start is None else repr(start[k])), name


def test_fmi_3_has_each_array_whole_with_its_shape_its_first_values_type_and_unit():
    variables = list(THREE.findall("ModelVariables/*"))
    assert [v.get("name") for v in variables] == list(TABLE)
    assert [v.get("valueReference") for v in variables] == [str(k) for k in range(len(TABLE))]
    for v, (name, (causality, shape, start, _)) in zip(variables, TABLE.items(), strict=True):
        assert about(v) == (causality, *VARIABILITY[causality]), name
        if name == "leg_spin":
            assert (v.tag, v.get("declaredType"), v.get("start")) == ("Enumeration", "LegSpin", "1")
            continue
        assert v.tag == "Float64"
        assert [each.get("start") for each in v.findall("Dimension")] == [str(n) for n in shape]
        assert v.get("start") == (None if start is None else " ".join(map(repr, start))), name
        declared = v.get("declaredType")
        if name in MIXED:
            assert (declared, v.get("unit")) == (None, None), name
            continue
        assert declared == KINDS.get(name, declared)
        assert declared is not None
        assert v.get("unit") == TYPES[declared].unit


@BOTH
def test_types_are_described_with_their_quantity_unit_and_range_and_the_items_count_from_1(root):
    defined = root.find("TypeDefinitions")
    names = [each.get("name") for each in defined]
    assert names == [name for name in TYPES if name != "Mixed"]
    for each in defined:
        numbers = each[0] if root is TWO else each
        if each.get("name") == "LegSpin":
            assert [(item.get("name"), item.get("value")) for item in numbers] == [
                ("none", "1"),
                ("universal", "2"),
            ]
            continue
        kind = TYPES[each.get("name")]
        assert each.get("description") == kind.description
        ends = tuple(None if end is None else float(end) for end in (numbers.get("min"), numbers.get("max")))
        assert (numbers.get("quantity"), numbers.get("unit"), *ends) == (
            kind.quantity,
            kind.unit,
            kind.min,
            kind.max,
        )


@BOTH
def test_a_simulation_has_any_whole_step_can_be_saved_and_is_of_a_second_in_milliseconds_by_default(root):
    simulation, experiment = root.find("CoSimulation"), root.find("DefaultExperiment")
    state = "state" if root is TWO else "State"
    assert {key: simulation.get(key) for key in simulation.attrib if key.startswith("can")} == dict.fromkeys(
        ("canHandleVariableCommunicationStepSize", f"canGetAndSetFMU{state}", f"canSerializeFMU{state}"),
        "true",
    )
    assert simulation.get("modelIdentifier") == "stewart"
    assert simulation.get("fixedInternalStepSize") == (None if root is TWO else "0.0001")
    assert experiment.attrib == {"startTime": "0", "stopTime": "1", "stepSize": "0.001"}
    assert [each.get("name") for each in root.findall("LogCategories/Category")] == ["logStatusError"]
    token = root.get("guid" if root is TWO else "instantiationToken")
    assert (root.get("fmiVersion"), token) == ("2.0" if root is TWO else "3.0", "{t}")
    assert [each.get("name") for each in root.findall("CoSimulation/SourceFiles/File")] == (
        ["a.c", "b.c"] if root is TWO else []
    )


def test_the_build_description_names_the_sources_in_their_order_and_how_they_are_compiled():
    files = ET.fromstring(build_description(["b.c", "a.c"])).find("BuildConfiguration/SourceFileSet")
    assert files is not None
    assert [each.get("name") for each in files] == ["b.c", "a.c"]
    assert (files.get("language"), files.get("compilerOptions", "").split()[0]) == ("C99", "-O2")


@pytest.mark.parametrize(
    "text",
    [
        model_description("2.0", "{t}", ("a.c",)),
        model_description("3.0", "{t}", ("a.c",)),
        build_description(["a.c"]),
        terminals(),
    ],
    ids=["2.0", "3.0", "build", "terminals"],
)
def test_a_description_says_what_it_is_and_can_be_read_line_by_line(text):
    first, second, *lines = text.decode().splitlines()
    assert first == "<?xml version='1.0' encoding='utf-8'?>"
    assert second.startswith("<fmi")
    assert text.endswith(b">\n")
    assert all(line.strip().startswith("<") and line.endswith(">") for line in lines)
    assert sum(line.count("<") for line in lines) <= 2 * len(lines)
    assert len(lines) > len(list(ET.fromstring(text).iter())) - 2
