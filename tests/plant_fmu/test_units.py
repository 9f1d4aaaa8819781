"""The units in the description of our FMU: what their names say, in SI base units."""

from __future__ import annotations

import re
from collections import Counter

import fmpy
import pytest

from plant_fmu.stewart.build import build
from plant_fmu.stewart.variables import TYPES, UNITS, VARIABLES

DERIVED = {
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "Hz": {"s": -1},
}
"""BIPM, The International System of Units (2019), table 4."""
BASE = ("kg", "m", "s", "rad")


def exponents(name: str) -> dict[str, int]:
    """Return the exponents of the base units in a name as N.s/m or m/s2."""
    total: Counter[str] = Counter()
    for side, part in zip((1, -1), name.split("/"), strict=False):
        for symbol, power in re.findall(r"([A-Za-z]+)(\d*)", part):
            for base, n in DERIVED.get(symbol, {symbol: 1}).items():
                total[base] += side * n * int(power or 1)
    return {base: n for base, n in total.items() if n}


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_every_unit_has_the_exponents_that_its_name_says(version):
    described = {
        unit.name: {base: n for base in BASE if (n := getattr(unit.baseUnit, base))}
        for unit in fmpy.read_model_description(str(build(version))).unitDefinitions
    }
    assert described == {name: exponents(name) for name in UNITS}
    assert len(described) >= 14
    for unit in fmpy.read_model_description(str(build(version))).unitDefinitions:
        assert (unit.baseUnit.factor, unit.baseUnit.offset) == (1.0, 0.0)
        assert not any((unit.baseUnit.A, unit.baseUnit.K, unit.baseUnit.mol, unit.baseUnit.cd))


def test_a_variable_of_several_types_has_one_for_each_element_and_every_type_has_a_unit_that_is_stated():
    for variable in VARIABLES:
        assert len(variable.types) == (variable.size if variable.type == "Mixed" else 0), variable.name
        assert set(variable.types) <= set(TYPES)
    assert {kind.unit for kind in TYPES.values()} - {None} <= set(UNITS)
