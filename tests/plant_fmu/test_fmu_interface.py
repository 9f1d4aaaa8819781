"""The description of an FMU against its settings: binary, variables, units, parameters."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import fmpy
import pytest

from drivers.errors import PlantError
from plant_fmu.fmu import check
from plant_fmu.fmu.check import FmuSpec, Interface, read_interface

LIBRARY = f"binaries/{fmpy.platform_tuple}/model{fmpy.sharedLibraryExtension}"
UNITS = {"force": "N", "length": "m", "rate": "m/s"}
INPUTS = ("force", "brake", "wrench")
TRUTH = ("p", "R", "twist", "applied")
NOTHING = dict.fromkeys(("kg", "m", "s", "A", "K", "mol", "cd"), 0)


def variable(name: str, reference: int, **more: Any) -> Any:
    known = {
        "name": name,
        "valueReference": str(reference),
        "causality": "input" if name in INPUTS else "output",
        "unit": UNITS.get(name),
        "type": "Float64",
        "shape": (6,),
        "variability": "continuous",
        "declaredType": None,
    }
    return SimpleNamespace(**{**known, **more})


def variables(*others: Any, **changes: dict[str, Any]) -> list[Any]:
    """Variables of a platform, some of them changed, and additional ones."""
    found = {name: variable(name, 10 * k + 3) for k, name in enumerate((*UNITS, "brake", "wrench", *TRUTH))}
    found["p"].shape, found["R"].shape = (3,), (3, 3)
    for name, change in changes.items():
        vars(found[name]).update(change)
    return [*found.values(), *others]


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Reads the interface of an FMU with given variables, units and members, under given settings."""

    def of(
        given: list[Any] | None = None,
        members: tuple[str, ...] = (LIBRARY,),
        version: str = "3.0",
        units: tuple[Any, ...] = (),
        needs_tool: bool = False,
        **settings: Any,
    ) -> Interface:
        description = SimpleNamespace(
            fmiVersion=version,
            unitDefinitions=units,
            modelVariables=variables() if given is None else given,
            coSimulation=SimpleNamespace(modelIdentifier="model", needsExecutionTool=needs_tool),
            generationTool="maker",
        )
        monkeypatch.setattr(check, "described", lambda _: (description, list(members)))
        names = {name: [name] for name in UNITS}
        return read_interface(FmuSpec.model_construct(**{"path": "a.fmu", **names, **settings}))

    return of


@pytest.mark.parametrize("key", ["force", "length", "rate", "brake", "wrench"])
def test_plant_signal_must_map_to_six_different_float64_variables_of_its_causality(read, key):
    other = "output" if key in INPUTS else "input"
    for change, word in (
        ({"causality": other}, f"causality {other}"),
        ({"type": "Float32"}, "type Float32"),
        ({"shape": (5,)}, "5 values; 6"),
        ({"shape": ()}, "1 values; 6"),
    ):
        with pytest.raises(PlantError, match=word):
            read(variables(**{key: change}), **{key: [key]})
    about = {"shape": (), "unit": UNITS.get(key), "causality": "input" if key in INPUTS else "output"}
    legs = [variable(f"leg{k}", k, **about) for k in range(6)]
    names = [leg.name for leg in legs]
    face = read(variables(*legs), **{key: names})
    assert {**face.inputs, **face.outputs}[key] == (0, 1, 2, 3, 4, 5)
    with pytest.raises(PlantError, match="mapped twice"):
        read(variables(*legs), **{key: [*names[:5], names[0]]})


def test_unit_assumed_for_a_variable_overrides_the_unit_assumed_for_its_signal(read):
    legs = [variable(f"f[{k}]", k, shape=(), causality="input", unit=None) for k in range(1, 7)]
    names = [leg.name for leg in legs]
    for assume in (
        {"f": "N"},
        {"force": "N"},
        {**dict.fromkeys(names, "N"), "f": "m"},
        {"f": "N", "force": "m"},
    ):
        assert read(variables(*legs), force=names, assume_unit=assume).assumed == dict.fromkeys(names, "N")
    for assume in ({"f": "m"}, {"f[3]": "m", "force": "N"}, {"force": "m"}):
        with pytest.raises(PlantError, match="in 'm'; N is needed"):
            read(variables(*legs), force=names, assume_unit=assume)


@pytest.mark.parametrize("key", UNITS)
def test_fmu_variables_of_force_length_and_rate_need_a_unit_but_wrench_variables_do_not(read, key):
    with pytest.raises(PlantError, match=rf"'{key}' declares no unit; .*{{{key}: {UNITS[key]}}}"):
        read(variables(**{key: {"unit": None}}))
    typed = {"unit": None, "declaredType": SimpleNamespace(unit=UNITS[key])}
    assert read(variables(**{key: typed}), assume_unit={key: UNITS[key]}).assumed == {}
    assert read(wrench=["wrench"]).assumed == {}


@pytest.mark.parametrize(
    ("key", "exponents"), [("force", (1, 1, -2)), ("length", (0, 1, 0)), ("rate", (0, 1, -1))]
)
def test_unit_of_an_fmu_variable_must_have_the_right_si_exponents_and_no_factor(read, key, exponents):
    right = {**NOTHING, "factor": 1.0, "offset": 0.0, **dict(zip(("kg", "m", "s"), exponents, strict=True))}

    def stated(**change):
        unit = SimpleNamespace(name="x", baseUnit=SimpleNamespace(**{**right, **change}))
        return read(variables(**{key: {"unit": "x"}}), units=(unit,))

    assert stated().assumed == {}
    for change in ({"factor": 1e3}, {"offset": 1.0}, *({base: 9.0} for base in NOTHING)):
        with pytest.raises(PlantError, match=f"is in 'x'; {UNITS[key]} is needed"):
            stated(**change)


ITEMS = SimpleNamespace(items=[SimpleNamespace(name="off", value="4"), SimpleNamespace(name="on", value="9")])
COUNTED = SimpleNamespace(items=[SimpleNamespace(name=name, value=None) for name in ("off", "on")])
INTEGERS = ("Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
TYPES: list[tuple[str, Any, Any]] = [
    *((kind, value, int(value)) for kind in INTEGERS for value in (3, 3.0, -2)),
    *((kind, wrong, None) for kind in INTEGERS for wrong in (3.5, True, "many", float("nan"))),
    *((kind, value, float(value)) for kind in ("Real", "Float32", "Float64") for value in (3, 3.5)),
    *(("Float64", wrong, None) for wrong in ("many", 10**310)),
    *(("Boolean", True, True), ("Boolean", 1, None), ("Boolean", "true", None), ("String", "a", "a")),
    *(("Binary", "a", None), ("Clock", 1, None)),
]


@pytest.mark.parametrize(("kind", "given", "value"), TYPES)
def test_fmu_parameter_accepts_only_values_of_its_type(read, kind, given, value):
    one = variables(variable("k", 7, causality="parameter", type=kind, shape=()))
    if value is None:
        with pytest.raises(PlantError, match=f"type {kind}; .* is not a valid value"):
            read(one, parameters={"k": given})
        return
    (start,) = read(one, parameters={"k": given}).starts
    assert (start.setter, start.values, type(start.values[0])) == (kind, (value,), type(value))


@pytest.mark.parametrize(
    ("version", "real", "setter"), [("2.0", "Real", "Integer"), ("3.0", "Float64", "Int64")]
)
def test_fmu_enumeration_parameter_accepts_the_name_or_number_of_an_item(read, version, real, setter):
    """Items without a value count from 1."""
    for items, name, value in ((ITEMS, "off", 4), (ITEMS, "on", 9), (COUNTED, "on", 2), (ITEMS, 9, 9)):
        about = {"causality": "parameter", "type": "Enumeration", "shape": (), "declaredType": items}
        given = variables(variable("k", 7, **about))
        for each in given[:-1]:
            each.type = real
        (start,) = read(given, version=version, parameters={"k": name}).starts
        assert (start.setter, start.values) == (setter, (value,))


def test_name_of_an_array_selects_scalar_fmu_variables_as_its_elements_only_in_fmi_2(read):
    elements = [variable(f"leg.f[{k}]", k, shape=(), causality="input", unit="N") for k in (4, 1, 6, 3, 2, 5)]
    others = [variable("leg.fs[1]", 8), variable("f[1]", 9)]
    given = variables(*elements, *others)
    assert read(given, version="2.0", force=["leg.f"]).inputs["force"] == (1, 2, 3, 4, 5, 6)
    with pytest.raises(PlantError, match=r"no variable 'leg.f'; similar names: leg.f\[1\]"):
        read(given, force=["leg.f"])
    whole = variables(*elements, variable("leg.f", 70, causality="input", unit="N"))
    assert read(whole, version="2.0", force=["leg.f"]).inputs["force"] == (70,)


def test_fmi_2_fmu_is_loaded_from_the_binaries_folder_of_the_fmi_2_standard_if_both_exist(read):
    old = f"binaries/{fmpy.platform}/model{fmpy.sharedLibraryExtension}"
    for members, library in (((LIBRARY, old), old), ((LIBRARY,), LIBRARY), ((old,), old)):
        assert read(members=members, version="2.0").library == library
    with pytest.raises(PlantError, match="binaries for b"):
        read(members=(old, "binaries/b/x.dll", "binaries/c", "resources/d/e"))


def test_fmu_that_needs_an_execution_tool_is_refused_unless_the_configuration_allows_it(read):
    read(needs_tool=True, allow_execution_tool=True)
    with pytest.raises(PlantError, match="needs maker at run time"):
        read(needs_tool=True)
