"""Units that an FMU states: those with the exponents that are needed are taken, and no others."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import PlantError
from plant_fmu.fmu.check import FmuSpec, _Reader

SPEC = FmuSpec(path="a.fmu", force=["force"], length=["length"], rate=["rate"])
EXPONENTS = {"N": (1, 1, -2), "N.m": (1, 2, -2), "m": (0, 1, 0), "m/s": (0, 1, -1)}
"""Of kg, m and s."""
SPELLED = {
    "N": {"N"},
    "N.m": {"N.m", "Nm", "N*m", "N m"},
    "m": {"m"},
    "m/s": {"m/s", "m.s-1", "m*s-1"},
}
"""Names of units that the FMU defines by nothing else."""
OTHERS = ("kN", "mm", "km/h", "1", "rad", "s")


def taken(needed: tuple[str, ...], name: str, **defined: Any) -> bool:
    """Tell whether a variable in a unit of this name is taken; `defined` are its base units, if any."""
    nothing = dict.fromkeys(("kg", "m", "s", "A", "K", "mol", "cd"), 0)
    base = SimpleNamespace(**{**nothing, "factor": 1.0, "offset": 0.0, **defined}) if defined else None
    variable = SimpleNamespace(
        name="a",
        type="Float64",
        causality="input",
        shape=(6,),
        valueReference="7",
        unit=name,
        declaredType=None,
    )
    unit = SimpleNamespace(name=name, baseUnit=base)
    description = SimpleNamespace(fmiVersion="3.0", unitDefinitions=[unit], modelVariables=[variable])
    reader = _Reader(description, SPEC)
    try:
        reader.channel("force", ["a"], "input", needed)
    except PlantError:
        said = f"'a' is in {name!r}; {' or '.join(needed)} is needed"
        with pytest.raises(PlantError, match=re.escape(said)):
            reader.channel("force", ["a"], "input", needed)
        return False
    return True


@pytest.mark.parametrize("needed", EXPONENTS)
def test_a_unit_is_told_by_its_exponents_whatever_it_is_called(needed):
    for unit, (kg, m, s) in EXPONENTS.items():
        assert taken((needed,), "x", kg=kg, m=m, s=s) == (unit == needed)
        assert not taken((needed,), "x", kg=kg, m=m, s=-s - 3)
        assert taken(("N", "N.m"), "x", kg=kg, m=m, s=s) == (unit in {"N", "N.m"})


@pytest.mark.parametrize("needed", EXPONENTS)
def test_a_unit_with_a_factor_an_offset_or_another_base_is_not_taken(needed):
    exponents = dict(zip(("kg", "m", "s"), EXPONENTS[needed], strict=True))
    changes: list[dict[str, float]] = [{"factor": 1e3}, {"factor": 1e-3}, {"offset": 1.0}]
    changes += [{base: 1.0} for base in ("A", "K", "mol", "cd")]
    changes += [{base: 9.0} for base in ("kg", "m", "s")]
    for change in changes:
        assert not taken((needed,), needed, **{**exponents, **change}), change


@pytest.mark.parametrize("needed", EXPONENTS)
def test_a_unit_that_is_not_defined_is_told_by_its_name(needed):
    for unit, names in SPELLED.items():
        for name in names:
            assert taken((needed,), name) == (unit == needed), name
    for name in OTHERS:
        assert not taken((needed,), name)
