"""Parameters of an FMU: each type of either standard takes what is a value of it, by its own function."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import PlantError
from plant_fmu.fmu.check import FmuSpec, Parameter, Start, _Reader

SPEC = FmuSpec(path="a.fmu", force=["force"], length=["length"], rate=["rate"])
INTEGERS = ["Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"]
FLOATS = ["Real", "Float32", "Float64"]


def start(kind: str, value: Parameter, version: str = "3.0", items: list[Any] | None = None) -> Start:
    variable = SimpleNamespace(
        name="a",
        type=kind,
        causality="parameter",
        variability="fixed",
        shape=(len(value),) if isinstance(value, list) else (),
        valueReference="7",
        declaredType=None if items is None else SimpleNamespace(items=items),
    )
    description = SimpleNamespace(fmiVersion=version, unitDefinitions=[], modelVariables=[variable])
    return _Reader(description, SPEC).start("a", value)


def refused(kind: str, value: Parameter) -> None:
    with pytest.raises(PlantError, match=f"'a' is of type {kind}; .* is no value of it"):
        start(kind, value)


@pytest.mark.parametrize("kind", INTEGERS)
def test_an_integer_of_any_width_takes_whole_numbers_alone(kind):
    for value in (3, 3.0, -2):
        found = start(kind, value)
        assert found == Start("a", kind, (7,), (int(value),))
        assert type(found.values[0]) is int
    assert start(kind, [1.0, 2.0, 3.0]).values == (1, 2, 3)
    for wrong in (3.5, True, "many", float("nan")):
        refused(kind, wrong)
    refused(kind, [1.0, 2.5])


@pytest.mark.parametrize("kind", FLOATS)
def test_a_float_takes_any_number(kind):
    for value in (3, 3.5, -2.0):
        found = start(kind, value)
        assert found == Start("a", kind, (7,), (float(value),))
        assert type(found.values[0]) is float
    refused(kind, "many")


def test_a_truth_value_and_a_text_take_what_they_are_and_types_without_a_value_take_nothing():
    assert start("Boolean", True).values == (True,)
    assert start("Boolean", False).values == (False,)
    for wrong in (1, 0.0, "true"):
        refused("Boolean", wrong)
    assert start("String", "a text") == Start("a", "String", (7,), ("a text",))
    for kind in ("Binary", "Clock"):
        for wrong in (1, True, "a text"):
            refused(kind, wrong)


@pytest.mark.parametrize(("version", "setter"), [("2.0", "Integer"), ("3.0", "Int64")])
def test_an_enumeration_takes_the_name_of_an_item_or_its_number(version, setter):
    """Items without a value count from 1."""
    named = [SimpleNamespace(name=name, value=value) for name, value in (("off", "4"), ("on", "9"))]
    counted = [SimpleNamespace(name=name, value=None) for name in ("off", "on")]
    for items, expected in ((named, (4, 9)), (counted, (1, 2))):
        for name, value in zip(("off", "on"), expected, strict=True):
            assert start("Enumeration", name, version, items) == Start("a", setter, (7,), (value,))
    assert start("Enumeration", 9, version, named).values == (9,)
    refused("Enumeration", "off")
