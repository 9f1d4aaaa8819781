"""FMUs of others: units that nobody stated, tools that are needed, maps that are proposed, legs that are single."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from pydantic import ValidationError

from drivers.errors import PlantError
from hil.app.configuration.yaml_positions import parse
from hil.app.fmu import plant_section
from hil.cli import main
from plant_fmu.bench import Bench
from plant_fmu.config import BenchPlant, FmuPlant
from plant_fmu.fmu.check import FmuSpec, shown, stated_unit
from plant_fmu.fmu.host import FmuHost
from plant_fmu.fmu.probe import probe
from plant_fmu.fmu.propose import propose
from plant_fmu.stewart.build import build

VERSIONS = ["2.0", "3.0"]
UNITS = {"force": "N", "length": "m", "rate": "m/s"}


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


UNITLESS = ((rb' (unit|declaredType)="(?!Spin|spin|Leg|leg)[^"]*"', b""),)


def spec(path, **changes):
    names = {key: (key,) for key in ("force", "length", "rate", "brake")}
    return FmuSpec.model_construct(**{"path": str(path), **names, **changes})


@pytest.mark.parametrize("version", VERSIONS)
def test_units_that_nobody_stated_are_refused_with_the_key_that_states_them(version, tmp_path):
    path = rewritten(version, tmp_path / "u.fmu", *UNITLESS)
    with pytest.raises(PlantError, match=r"declares no unit.*plant.model.assume_unit: {force: N}"):
        FmuHost(spec(path))


@pytest.mark.parametrize("version", VERSIONS)
def test_assumed_units_stand_in_for_unstated_ones_alone(version, tmp_path):
    path = rewritten(version, tmp_path / "u.fmu", *UNITLESS)
    host = FmuHost(spec(path, assume_unit=UNITS))
    q, _ = host.reset()
    assert set(host._interface.assumed.values()) == set(UNITS.values())
    host.close()
    stated = FmuHost(spec(build(version), assume_unit=UNITS))
    assert stated._interface.assumed == {}
    np.testing.assert_array_equal(stated.reset()[0], q)
    stated.close()


@pytest.mark.parametrize(
    ("assumed", "word"),
    [({**UNITS, "rate": "m"}, r"'rate.*' in 'm'; m/s is needed"), ({"force": "N", "length": "m"}, "'rate.*' declares no unit")],
)  # fmt: skip
def test_an_assumed_unit_has_to_be_the_one_that_is_needed(assumed, word, tmp_path):
    path = rewritten("3.0", tmp_path / "u.fmu", *UNITLESS)
    with pytest.raises(PlantError, match=word):
        FmuHost(spec(path, assume_unit=assumed))


def test_an_assumed_unit_never_overrules_a_stated_one():
    with pytest.raises(PlantError, match=r"'length.*' is in 'm'; m/s is needed"):
        FmuHost(spec(build("3.0"), rate=("length",), length=("length",), assume_unit=UNITS))


def test_a_tool_that_is_needed_is_refused_until_it_is_allowed(tmp_path):
    needs = (rb"<CoSimulation ", b'<CoSimulation needsExecutionTool="true" ')
    path = rewritten(
        "3.0",
        tmp_path / "t.fmu",
        (rb' needsExecutionTool="false"', b"")
        if b'needsExecutionTool="false"' in xml("3.0")
        else (rb"^", b""),
        needs,
    )
    with pytest.raises(PlantError, match=r"needsExecutionTool.*allow_execution_tool: true"):
        FmuHost(spec(path))
    FmuHost(spec(path, allow_execution_tool=True)).close()


def xml(version):
    with zipfile.ZipFile(build(version)) as archive:
        return archive.read("modelDescription.xml")


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"assume_unit": {"thrust": "N"}}, "not mapped: thrust"),
        ({"allow_execution_tool": True, "isolation": "in_process"}, "isolation child_process"),
        ({"assume_unit": {"force": "kN"}}, "'N'"),
    ],
)
def test_a_section_that_cannot_be_meant_is_refused(changes, word):
    section = {"type": "fmu", "path": "x.fmu", "force": ["f"], "length": ["q"], "rate": ["v"]}
    FmuPlant.model_validate(section)
    with pytest.raises(ValidationError, match=word):
        FmuPlant.model_validate(section | changes)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("changes", [(), UNITLESS], ids=["units", "none"])
def test_the_map_of_our_fmu_is_proposed_with_and_without_units(version, changes, tmp_path):
    path = rewritten(version, tmp_path / "p.fmu", *changes)
    found = propose(path)
    assert found.missing == ()
    names = {"2.0": tuple(f"[{i}]" for i in range(1, 7)), "3.0": ("",)}[version]
    for key in ("force", "length", "rate", "brake"):
        assert found.mapped[key] == tuple(key + name for name in names)
    assert found.unstated == (UNITS if changes else {})
    assert "mass" in found.parameters


def test_a_structural_parameter_is_not_offered_and_is_refused_by_its_kind(tmp_path):
    """FMI 3.0 lets it be set in Configuration Mode alone."""
    mass = rb'(name="mass"[^>]*causality=)"parameter"'
    path = rewritten("3.0", tmp_path / "p.fmu", (mass, rb'\1"structuralParameter"'))
    parameters = propose(path).parameters
    assert "mass" not in parameters
    assert "gravity" in parameters
    with pytest.raises(
        PlantError, match=r"'mass' is a structuralParameter, .* give the FMU that start value"
    ):
        FmuHost(spec(path, parameters={"mass": 1000.0}))
    FmuHost(spec(path, parameters={"gravity": [0.0, 0.0, -1.0]})).close()


def platform_of_names(force, length, rate, brake):
    """The description of our FMI 2.0 file with names of another maker; {} is the leg."""
    return [
        (
            re.escape(f'name="{key}[{i}]"').encode(),
            f'name="{name.format(i - 1 if "{}_" in name else i)}"'.encode(),
        )
        for key, name in {"force": force, "length": length, "rate": rate, "brake": brake}.items()
        for i in range(1, 7)
    ]


@pytest.mark.parametrize(
    "names",
    [
        ("cyl_{}_thrust_in", "cyl_{}_pos", "cyl_{}_vel", "hold_{}"),
        ("leg[{}].force", "leg[{}].length", "leg[{}].rate", "leg[{}].brake"),
        ("axis{}.tau", "axis{}.q", "axis{}.qd", "axis{}.lock"),
    ],
)
def test_names_with_the_leg_in_their_middle_are_recognised_in_leg_order(names, tmp_path):
    path = rewritten("2.0", tmp_path / "p.fmu", *UNITLESS, *platform_of_names(*names))
    found = propose(path)
    for key, name in zip(("force", "length", "rate", "brake"), names, strict=True):
        first = 0 if "{}_" in name else 1
        assert found.mapped[key] == tuple(name.format(i) for i in range(first, first + 6)), key


def read(text: str) -> dict[str, Any]:
    """What the loader of configurations makes of a text."""
    document = parse(text)
    assert not document.problems
    assert document.value is not None
    return document.value


@pytest.mark.parametrize("file", ["p.fmu", "a: b.fmu", "#1.fmu", "[a], 'b\".fmu"])
@pytest.mark.parametrize("name", ["a_long_name_of_the_{}_th_leg", "leg[{}].port", "no, {}: {{#1}}"])
def test_the_proposed_section_can_be_copied_from_the_terminal(name, file, tmp_path):
    names = [f"{name}_{word}" for word in ("force", "length", "rate", "brake")]
    path = rewritten("2.0", tmp_path / file, *UNITLESS, *platform_of_names(*names))
    done = CliRunner().invoke(main, ["fmu", "show", str(path)])
    model = read("plant:" + done.output.split("\nplant:")[1])["plant"]["model"]
    found = propose(path)
    assert len(found.mapped) == 4
    assert {key: tuple(model[key]) for key in found.mapped} == found.mapped
    assert (model["path"], model["assume_unit"]) == (file, UNITS)
    FmuPlant.model_validate(model)


def test_the_section_of_our_own_file_of_fmi_2_can_be_copied():
    model = read("\n".join(plant_section("a.fmu", propose(build("2.0")))))
    assert model["force"] == [f"force[{i}]" for i in range(1, 7)]
    FmuPlant.model_validate(model)


def test_what_a_tool_is_called_adds_no_line_to_the_proposed_section(tmp_path):
    named = (rb'generationTool="[^"]*"', b'generationTool="a&#10;path: other.fmu"')
    needed = (rb"<CoSimulation ", b'<CoSimulation needsExecutionTool="true" ')
    path = rewritten("2.0", tmp_path / "p.fmu", named, needed)
    done = CliRunner().invoke(main, ["fmu", "show", str(path)])
    model = read("plant:" + done.output.split("\nplant:")[1])["plant"]["model"]
    assert (model["path"], model["allow_execution_tool"]) == ("p.fmu", True)


HOSTILE = "a&#10;hil: all is well &#155;2J \u202e".encode()
NEEDED = (rb"<CoSimulation ", b'<CoSimulation needsExecutionTool="true" ')


def test_texts_of_the_description_steer_no_terminal_and_add_no_line(tmp_path):
    named = (rb'generationTool="[^"]*"', b'generationTool="%b"' % HOSTILE)
    inputs = (rb'name="force"', b'name="%b_force"' % HOSTILE)
    parameters = (rb'name="mass"', b'name="%b"' % HOSTILE)
    plain = CliRunner().invoke(main, ["fmu", "show", str(build("3.0"))])
    path = rewritten("3.0", tmp_path / "p.fmu", named, inputs, parameters)
    done = CliRunner().invoke(main, ["fmu", "show", str(path)])
    assert done.exit_code == 0, done.output
    assert done.output.count(r"\nhil: all is well \x9b2J \u202e") >= 4, "tool, input, parameter, section"
    assert done.output.replace("\n", "").isprintable()
    assert done.output.count("\n") == plain.output.count("\n")


@pytest.mark.parametrize(
    ("said", "changes"),
    [
        ("the FMU needs", ((rb'generationTool="[^"]*"', b'generationTool="%b"' % HOSTILE), NEEDED)),
        ("2.0 and 3.0 can be hosted", ((rb'fmiVersion="3.0"', b'fmiVersion="3.9%b"' % HOSTILE),)),
        ("no variable 'force'; close to it", ((rb'name="force"', b'name="%bforce"' % HOSTILE),)),
        ("cannot be read", ((rb'(name="force"[^>]*causality=)"input"', rb'\1"%b"' % HOSTILE),)),
        ("no binary for this machine", ((rb'modelIdentifier="[^"]*"', b'modelIdentifier="%b"' % HOSTILE),)),
    ],
)
def test_a_refusal_that_quotes_the_description_stays_one_line(tmp_path, said, changes):
    path = rewritten("3.0", tmp_path / "p.fmu", *changes)
    with pytest.raises(PlantError, match=said) as told:
        FmuHost(spec(path))
    assert r"\nhil: all is well" in str(told.value)
    assert str(told.value).isprintable()


def test_an_fmu_of_another_machine_is_shown_with_what_it_lacks_on_this_one(tmp_path):
    path = rewritten("3.0", tmp_path / "p.fmu", (rb'modelIdentifier="[^"]*"', b'modelIdentifier="other"'))
    done = CliRunner().invoke(main, ["fmu", "show", str(path)])
    assert done.exit_code == 0, done.output
    first, second, *_ = done.output.splitlines()
    assert first.startswith(f"{path}: FMI 3.0, made by")
    assert second.startswith("  the FMU has no binary for this machine (binaries/")
    assert "force" in done.output


def test_an_fmu_of_this_machine_is_shown_without_an_obstacle(tmp_path):
    assert propose(rewritten("2.0", tmp_path / "p.fmu")).obstacle == ""


FMI_1 = b"""<fmiModelDescription fmiVersion="1.0" modelName="m" modelIdentifier="m" guid="{1}"
  numberOfContinuousStates="0" numberOfEventIndicators="0"><ModelVariables/><Implementation>
  <CoSimulation_StandAlone><Capabilities/></CoSimulation_StandAlone></Implementation></fmiModelDescription>"""


@pytest.mark.parametrize(
    ("version", "xml"), [("1.0", FMI_1), ("4.0-alpha", FMI_1.replace(b'"1.0"', b'"4.0-alpha"'))]
)
def test_an_fmu_of_another_standard_is_refused_with_its_version_and_not_proposed_for(tmp_path, version, xml):
    path = tmp_path / "p.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
    done = CliRunner().invoke(main, ["fmu", "show", str(path)])
    assert done.exit_code == 2
    assert re.search(f"{path}: .*(FMI|FMI version:) {version}", done.output.replace("\n", ""))


def test_nothing_is_proposed_for_names_that_say_nothing(tmp_path):
    path = rewritten("3.0", tmp_path / "p.fmu", *UNITLESS, (rb'name="force"', b'name="in1"'))
    assert propose(path).missing == ("force",)


def test_a_number_in_a_name_may_have_any_number_of_digits(tmp_path):
    longer = (rb'name="brake', b'name="' + b"7" * 5000 + b"_brake")
    path = rewritten("2.0", tmp_path / "p.fmu", longer)
    assert propose(path).missing == ()


def test_single_legs_are_told_from_a_platform():
    bench = Bench(BenchPlant(type="bench", mass_kg=50.0))
    single = probe(bench, 10.0, 1e-3)
    assert single.uncoupled is True
    np.testing.assert_allclose(np.diag(single.mobility), 1 / 50.0, rtol=1e-3)
    host = FmuHost(spec(build("3.0")))
    platform = probe(host, 10.0, 1e-3)
    assert platform.uncoupled is False
    assert (np.diag(platform.mobility) > 0.0).all()
    host.close()


def test_a_plant_that_does_not_answer_is_neither():
    class Stuck(Bench):
        def step(self, force, brake, wrench, dt_s):
            return super().step(force, np.ones(6), wrench, dt_s)

    assert probe(Stuck(BenchPlant(type="bench")), 1.0, 1e-3).uncoupled is None


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_with_a_malformed_description_is_refused_and_closed(version, tmp_path):
    path = tmp_path / "malformed.fmu"
    with zipfile.ZipFile(build(version)) as source, zipfile.ZipFile(path, "w") as out:
        out.writestr("modelDescription.xml", source.read("modelDescription.xml")[:200])
    with pytest.raises(PlantError, match="cannot be read") as caught:
        propose(path)
    assert caught.value.__cause__ is not None, "its frames live on, and what they hold"
    opened = [fd for fd in Path("/proc/self/fd").iterdir() if fd.exists() and fd.samefile(path)]
    assert opened == []


def test_of_two_sixes_that_fit_equally_well_neither_is_proposed(tmp_path):
    """Brakes that are called forces, too."""
    second = (rb'name="brake\[(\d)\]"', rb'name="other.force[\1]"')
    path = rewritten("2.0", tmp_path / "p.fmu", *UNITLESS, second)
    found = propose(path)
    assert found.missing == ("force",)
    assert "force" not in found.mapped


@pytest.mark.parametrize(
    ("own", "of_type", "stated"),
    [("kN", None, "kN"), ("kN", "mm", "kN"), (None, "mm", "mm"), (None, None, None), ("", "", None)],
)
def test_the_unit_of_a_variable_is_its_own_or_else_that_of_its_type(own, of_type, stated):
    assert stated_unit(SimpleNamespace(unit=own, declaredType=SimpleNamespace(unit=of_type))) == stated
    if not of_type:
        assert stated_unit(SimpleNamespace(unit=own, declaredType=None)) == stated


@pytest.mark.parametrize(
    ("key", "change"),
    [(key, (rb'(name="%b"[^>]* unit=)"%b"' % (key.encode(), unit.encode()), rb'\1"ft"')) for key, unit in UNITS.items()]
    + [("brake", (rb'(name="brake")', rb'\1 unit="N"'))],
)  # fmt: skip
def test_what_states_another_unit_than_is_needed_is_not_proposed_whatever_its_name(key, change, tmp_path):
    found = propose(rewritten("3.0", tmp_path / "p.fmu", change))
    assert set(found.mapped) == {"force", "length", "rate", "brake"} - {key}


@pytest.mark.parametrize("version", VERSIONS)
def test_nothing_is_proposed_for_an_fmu_that_is_not_for_co_simulation(version, tmp_path):
    path = rewritten(version, tmp_path / "p.fmu", (rb"CoSimulation", b"ModelExchange"))
    with pytest.raises(PlantError, match=r"p\.fmu: the FMU has no co-simulation interface; export it"):
        propose(path)


@pytest.mark.parametrize(
    ("text", "line"),
    [("plain \N{MICRO SIGN}m", "plain \N{MICRO SIGN}m"), ("", ""), ("a\nb", r"a\nb"), ("it's\t\x9b2J", r"it's\t\x9b2J")],
)  # fmt: skip
def test_a_text_is_shown_as_it_is_with_numbers_for_what_is_no_sign(text, line):
    assert shown(text) == line
