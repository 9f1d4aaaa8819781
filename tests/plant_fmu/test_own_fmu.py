"""Foreign FMUs: undeclared units, required tools, proposed maps, uncoupled legs."""

from __future__ import annotations

import re
import zipfile
from typing import Any

import pytest
from click.testing import CliRunner
from pydantic import ValidationError

from drivers.errors import PlantError
from hil.app.configuration.yaml_positions import parse
from hil.cli import main
from plant_fmu.config import FmuPlant
from plant_fmu.fmu.check import FmuSpec
from plant_fmu.fmu.host import FmuHost
from plant_fmu.fmu.propose import propose
from plant_fmu.stewart.build import build

VERSIONS = ["2.0", "3.0"]
UNITS = {"force": "N", "length": "m", "rate": "m/s"}
KEYS = ("force", "length", "rate", "brake")
UNITLESS = ((rb' (unit|declaredType)="(?!Spin|spin|Leg|leg)[^"]*"', b""),)
NEEDED = (rb"<CoSimulation ", b'<CoSimulation needsExecutionTool="true" ')


def rewritten(version, out, *changes):
    """Copy our FMU with its description changed by regular expressions."""
    with zipfile.ZipFile(build(version)) as source, zipfile.ZipFile(out, "w") as target:
        for member in source.infolist():
            data = source.read(member)
            if member.filename == "modelDescription.xml":
                for old, new in changes:
                    data, n = re.subn(old, new, data)
                    assert n
            target.writestr(member.filename, data)
    return out


def spec(path, **changes):
    names = {key: (key,) for key in KEYS}
    return FmuSpec.model_construct(**{"path": str(path), **names, **changes})


def show(path):
    """Run `hil fmu show`; return its output, and the section that it proposes."""
    done = CliRunner().invoke(main, ["fmu", "show", str(path)])
    assert done.exit_code == 0, done.output
    document = parse("plant:" + done.output.split("\nplant:")[1])
    assert not document.problems
    value: Any = document.value
    assert value is not None
    return done.output, value["plant"]["model"]


SECTION: dict[str, Any] = {"type": "fmu", "path": "x.fmu", "force": ["f"], "length": ["q"], "rate": ["v"]}
SIX = ["a", "b", "c", "d", "e", "f"]


@pytest.mark.parametrize("key", ["force", "length", "rate", "brake", "wrench"])
def test_plant_signal_maps_to_six_different_fmu_variables_or_one_array(key):
    for names in (["a"], SIX, *([[]] if key in {"brake", "wrench"} else [])):
        assert getattr(FmuPlant.model_validate(SECTION | {key: names}), key) == names
    for names in (["a", "b"], SIX[:5], [*SIX, "g"], ["a", "f", "b", "b", "e", "f"]):
        with pytest.raises(ValidationError, match=r"array of six|the same variable twice: b, f\b"):
            FmuPlant.model_validate(SECTION | {key: names})


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"assume_unit": {"thrust": "N"}}, "not mapped: thrust"),
        ({"allow_execution_tool": True, "isolation": "in_process"}, "isolation child_process"),
        ({"assume_unit": {"force": "kN"}}, "'N'"),
    ],
)
def test_invalid_fmu_section_of_the_configuration_is_refused(changes, word):
    with pytest.raises(ValidationError, match=word):
        FmuPlant.model_validate(SECTION | changes)


def test_structural_fmu_parameter_is_not_listed_and_cannot_be_set(tmp_path):
    """FMI 3.0 allows setting it only in Configuration Mode."""
    mass = rb'(name="mass"[^>]*causality=)"parameter"'
    path = rewritten("3.0", tmp_path / "p.fmu", (mass, rb'\1"structuralParameter"'))
    assert {"mass", "gravity"} & set(propose(path).parameters) == {"gravity"}
    with pytest.raises(PlantError, match="'mass': causality structuralParameter"):
        FmuHost(spec(path, parameters={"mass": 1000.0}))


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("changes", [(), UNITLESS], ids=["units", "none"])
def test_proposed_mapping_of_the_own_fmu_is_right_with_and_without_declared_units(version, changes, tmp_path):
    found = propose(rewritten(version, tmp_path / "p.fmu", *changes))
    names = {"2.0": tuple(f"[{i}]" for i in range(1, 7)), "3.0": ("",)}[version]
    assert found.mapped == {key: tuple(key + name for name in names) for key in KEYS}
    assert (found.missing, found.obstacle) == ((), "")
    assert found.unstated == (UNITS if changes else {})
    assert "mass" in found.parameters


def platform_of_names(names):
    """Changes of our FMI 2.0 description to the names of another tool; {} is the leg."""
    return [
        (
            re.escape(f'name="{key}[{i}]"').encode(),
            f'name="{name.format(i - 1 if "{}_" in name else i)}"'.encode(),
        )
        for key, name in zip(KEYS, names, strict=True)
        for i in range(1, 7)
    ]


@pytest.mark.parametrize(
    "names",
    [
        ("cyl_{}_thrust_in", "cyl_{}_pos", "cyl_{}_vel", "hold_{}"),
        ("leg[{}].force", "leg[{}].length", "leg[{}].rate", "leg[{}].brake"),
        ("axis{}.tau", "axis{}.q", "axis{}.qd", "axis{}.lock"),
        ("u_{}", "l_{}", "Leg Velocity {}", "clamp{}"),
    ],
)
def test_fmu_variables_with_a_leg_number_inside_their_name_are_proposed_in_leg_order(names, tmp_path):
    found = propose(rewritten("2.0", tmp_path / "p.fmu", *UNITLESS, *platform_of_names(names)))
    for key, name in zip(KEYS, names, strict=True):
        first = 0 if "{}_" in name else 1
        assert found.mapped[key] == tuple(name.format(i) for i in range(first, first + 6)), key


@pytest.mark.parametrize(
    ("name", "file"), [("a_long_name_of_the_{}_th_leg", "a: b.fmu"), ("no, {}: {{#1}}", "[a], 'b\".fmu")]
)
def test_proposed_fmu_section_is_valid_yaml_even_for_unusual_variable_names(name, file, tmp_path):
    names = [f"{name}_{word}" for word in KEYS]
    path = rewritten("2.0", tmp_path / file, *UNITLESS, *platform_of_names(names))
    _, model = show(path)
    assert {key: tuple(model[key]) for key in KEYS} == propose(path).mapped
    assert (model["path"], model["assume_unit"]) == (file, UNITS)
    FmuPlant.model_validate(model)


HOSTILE = "a&#10;hil: all is well &#155;2J \u202e".encode()


def test_control_characters_in_an_fmu_description_are_escaped_in_the_output(tmp_path):
    named = (rb'generationTool="[^"]*"', b'generationTool="%b"' % HOSTILE)
    inputs = (rb'name="force"', b'name="%b_force"' % HOSTILE)
    path = rewritten("3.0", tmp_path / "p.fmu", named, inputs, NEEDED)
    output, model = show(path)
    assert model["allow_execution_tool"] is True
    assert output.replace("\n", "").isprintable()
    assert "\nhil: all is well" not in output
    with pytest.raises(PlantError, match="the FMU needs") as error:
        FmuHost(spec(path))
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    "change",
    [
        (rb'name="force\[', b'name="in['),
        (rb'name="force\[6\]', b'name="force[7]'),
        (rb'name="brake\[(\d)\]"', rb'name="other.force[\1]"'),
    ],
    ids=["no word", "no six", "two that fit"],
)
def test_force_mapping_is_proposed_only_if_exactly_one_group_of_fmu_variables_fits(change, tmp_path):
    found = propose(rewritten("2.0", tmp_path / "p.fmu", *UNITLESS, change))
    assert found.missing == ("force",)
