"""An FMU's description against what is asked of it: version, binary, channels, units, parameters, in any order."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fmpy
import pytest

from drivers.errors import PlantError
from plant_fmu.fmu import check
from plant_fmu.fmu.check import (
    FmuSpec,
    Interface,
    described,
    library_candidates,
    read_interface,
)
from plant_fmu.stewart.build import build

PATH = Path("a.fmu")
LIBRARY = f"binaries/{fmpy.platform_tuple}/model{fmpy.sharedLibraryExtension}"
UNITS = {"force": "N", "length": "m", "rate": "m/s"}
CAUSALITY = {"force": "input", "brake": "input", "wrench": "input"}


def variable(name: str, reference: int, **more: Any) -> Any:
    known = {
        "name": name,
        "valueReference": str(reference),
        "causality": CAUSALITY.get(name, "output"),
        "unit": UNITS.get(name),
        "type": "Float64",
        "shape": (6,),
        "variability": "continuous",
        "declaredType": None,
    }
    return SimpleNamespace(**{**known, **more})


def variables() -> dict[str, Any]:
    names = ("force", "length", "rate", "brake", "wrench", "p", "R", "twist", "applied")
    found = {name: variable(name, 10 * k + 3) for k, name in enumerate(names)}
    found["p"].shape, found["R"].shape = (3,), (3, 3)
    return found


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The interface of an FMU with these variables and this binary, as a specification asks for it."""

    def of(
        given: dict[str, Any] | None = None,
        members: tuple[str, ...] = (LIBRARY,),
        version: str = "3.0",
        simulation: dict[str, Any] | None = None,
        **asked: Any,
    ) -> Interface:
        about = {"modelIdentifier": "model", "needsExecutionTool": False, **(simulation or {})}
        description = SimpleNamespace(
            fmiVersion=version,
            unitDefinitions=[],
            modelVariables=list((variables() if given is None else given).values()),
            coSimulation=SimpleNamespace(**about),
            generationTool="maker",
        )
        monkeypatch.setattr(check, "described", lambda _: description)
        names = {"force": ("force",), "length": ("length",), "rate": ("rate",)}
        return read_interface(members, FmuSpec.model_construct(**{"path": str(PATH), **names, **asked}))

    return of


def changed(name: str, **more: Any) -> dict[str, Any]:
    found = variables()
    found[name] = variable(name, 99, **more)
    return found


TRUTH = ("p", "R", "twist", "applied")


def test_channels_are_those_that_are_asked_for_with_their_references(read):
    face = read()
    assert face.inputs == {"force": (3,)}
    assert face.outputs == {"length": (13,), "rate": (23,)}
    assert (face.major, face.library, face.starts, face.assumed) == (3, LIBRARY, (), {})
    face = read(brake=("brake",), wrench=("wrench",), truth=TRUTH)
    assert list(face.inputs) == ["force", "brake", "wrench"]
    assert (face.inputs["brake"], face.inputs["wrench"]) == ((33,), (43,))
    assert list(face.outputs) == ["length", "rate", *TRUTH]
    assert face.outputs["applied"] == (83,)


@pytest.mark.parametrize("name", TRUTH)
def test_a_part_of_the_truth_has_its_own_number_of_values(read, name):
    size = {"p": 3, "R": 9}.get(name, 6)
    for other in (size - 1, size + 1):
        with pytest.raises(PlantError, match=rf"truth: \['{name}'\] are {other} values; {size} are needed"):
            read(changed(name, shape=(other,)), truth=TRUTH)


@pytest.mark.parametrize("key", ["force", "length", "rate", "brake", "wrench"])
def test_a_channel_has_six_real_values_of_its_causality_each_mapped_once(read, key):
    asked = {key: (key,)}
    other = {"input": "output", "output": "input"}[CAUSALITY.get(key, "output")]
    units = {"unit": UNITS.get(key)}
    for change, said in (
        ({"causality": other}, f"{key}: variable '{key}' is of causality {other}; .* is needed"),
        ({"type": "Float32"}, f"{key}: variable '{key}' is of type Float32; Real .* is needed"),
        ({"shape": (5,)}, "are 5 values; 6 are needed"),
        ({"shape": ()}, "are 1 values; 6 are needed"),
        ({"shape": (7,)}, "are 7 values; 6 are needed"),
    ):
        with pytest.raises(PlantError, match=said):
            read(changed(key, **{**units, **change}), **asked)
    legs = {f"{key}{k}": variable(key + str(k), k, shape=(), causality=CAUSALITY.get(key, "output"), **units)
            for k in range(6)}  # fmt: skip
    face = read({**variables(), **legs}, **{key: tuple(legs)})
    assert {**face.inputs, **face.outputs}[key] == (0, 1, 2, 3, 4, 5)
    with pytest.raises(PlantError, match=rf"{key}: one variable is mapped twice"):
        read({**variables(), **legs}, **{key: (*list(legs)[:5], f"{key}0")})


def test_the_unit_of_a_variable_that_states_none_is_that_of_its_name_before_that_of_its_key(read):
    bare = {**variables(), "force": variable("force", 1, unit=None)}
    assert read(bare, assume_unit={"force": "N"}).assumed == {"force": "N"}
    legs = {f"f[{k}]": variable(f"f[{k}]", k, shape=(), causality="input", unit=None) for k in range(1, 7)}
    given = {**variables(), **legs}
    for assume in (
        {"f": "N"},
        {"force": "N"},
        {**dict.fromkeys(legs, "N"), "f": "m"},
        {"f": "N", "force": "m"},
    ):
        assert read(given, force=tuple(legs), assume_unit=assume).assumed == dict.fromkeys(legs, "N")
    for assume in ({"f": "m"}, {"f[3]": "m", "force": "N"}, {"force": "m"}):
        with pytest.raises(PlantError, match=r"assume_unit: 'f\[.\]' in 'm'; N is needed"):
            read(given, force=tuple(legs), assume_unit=assume)


@pytest.mark.parametrize("key", ["force", "length", "rate"])
def test_a_force_or_length_that_states_no_unit_is_refused_and_a_wrench_is_not(read, key):
    for bare in (
        variable(key, 1, unit=None),
        variable(key, 1, unit=None, declaredType=SimpleNamespace(unit=None)),
    ):
        with pytest.raises(
            PlantError, match=rf"'{key}' declares no unit; .*assume_unit: {{{key}: {UNITS[key]}}}"
        ):
            read({**variables(), key: bare})
    typed = variable(key, 1, unit=None, declaredType=SimpleNamespace(unit=UNITS[key]))
    assert read({**variables(), key: typed}, assume_unit={key: UNITS[key]}).assumed == {}
    assert read(wrench=("wrench",)).assumed == {}
    assert read(wrench=("wrench",), assume_unit={"wrench": "N.m"}).assumed == {"wrench": "N.m"}


@pytest.mark.parametrize(
    ("causality", "variability", "allowed"),
    [
        ("parameter", "fixed", True),
        ("parameter", "tunable", True),
        ("input", "continuous", True),
        ("parameter", "constant", False),
        ("output", "continuous", False),
        ("local", "constant", False),
    ],
)
def test_what_is_a_parameter_or_an_input_and_no_constant_can_be_set(read, causality, variability, allowed):
    more = {"causality": causality, "variability": variability, "shape": (2,)}
    given = {**variables(), "k": variable("k", 71, **more)}
    if allowed:
        (start,) = read(given, parameters={"k": [1.5, 2.0]}).starts
        assert (start.name, start.references, start.values) == ("k", (71,), (1.5, 2.0))
        for values in ([1.0], [1.0, 2.0, 3.0], 1.0):
            with pytest.raises(PlantError, match=r"'k' has 2 elements but [13] are given"):
                read(given, parameters={"k": values})
        return
    with pytest.raises(PlantError, match=f"'k' is a {causality}; only parameters can be set"):
        read(given, parameters={"k": [1.0, 2.0]})


def test_parameters_are_set_in_the_order_of_the_configuration(read):
    given = {
        **variables(),
        **{n: variable(n, k, causality="parameter", shape=()) for k, n in enumerate("cab")},
    }
    starts = read(given, parameters={"b": 1.0, "c": 2.0, "a": 3.0}).starts
    assert [(each.name, each.values) for each in starts] == [("b", (1.0,)), ("c", (2.0,)), ("a", (3.0,))]


def test_in_fmi_2_the_folder_of_that_standard_comes_first_and_the_one_of_fmi_3_counts_as_well(read):
    file = f"model{fmpy.sharedLibraryExtension}"
    old = f"binaries/{fmpy.platform}/{file}"
    assert library_candidates(2, "model") == [old, LIBRARY]
    assert library_candidates(3, "model") == [LIBRARY]
    given = {name: SimpleNamespace(**{**vars(each), "type": "Real"}) for name, each in variables().items()}
    for members, library in (((LIBRARY, old), old), ((LIBRARY,), LIBRARY), ((old,), old)):
        assert read(given, members, "2.0").library == library


def test_binaries_for_other_machines_are_named_each_once(read):
    members = ("binaries/b/x.dll", "binaries/a/x.so", "binaries/a/deep/y.so", "binaries/c", "resources/d/e/f")
    with pytest.raises(PlantError, match=r"no binary for this machine .* binaries for a, b\. Export it for"):
        read(members=members)
    with pytest.raises(PlantError, match=r"binaries for none\. "):
        read(members=("binaries/c", "resources/d/e"))


def test_a_tool_is_needed_where_the_fmu_says_so_and_then_has_to_be_allowed(read):
    for needed in (False, True):
        assert read(simulation={"needsExecutionTool": needed}, allow_execution_tool=True).library == LIBRARY
    with pytest.raises(PlantError, match="the FMU needs maker at run time"):
        read(simulation={"needsExecutionTool": True})


def test_a_description_that_can_be_read_need_not_keep_to_the_schema(tmp_path):
    with zipfile.ZipFile(build("3.0")) as source, zipfile.ZipFile(tmp_path / "a.fmu", "w") as target:
        xml = source.read("modelDescription.xml")
        target.writestr("modelDescription.xml", re.sub(rb"<fmiModelDescription", rb'\g<0> own="1"', xml))
    assert described(tmp_path / "a.fmu").modelName == "Stewart platform"


def test_a_text_with_what_is_no_sign_is_shown_with_its_numbers_and_any_other_as_it_is():
    assert check.shown('it\'s "here" \\ \u00e4') == 'it\'s "here" \\ \u00e4'
    assert check.shown("a\nb\x1b") == r"a\nb\x1b"
