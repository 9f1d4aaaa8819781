"""How a name of the configuration finds variables of an FMU: by itself, or in FMI 2 as an array written out."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from drivers.errors import PlantError
from plant_fmu.fmu.check import FmuSpec, _Reader

SPEC = FmuSpec(path="a.fmu", force=["force"], length=["length"], rate=["rate"])
ELEMENTS = [f"leg.force[{k}]" for k in (1, 2, 3, 4, 5, 6)]


def found(version: str, names: list[str], name: str) -> list[str]:
    variables = [SimpleNamespace(name=each) for each in names]
    description = SimpleNamespace(fmiVersion=version, unitDefinitions=[], modelVariables=variables)
    return [variable.name for variable in _Reader(description, SPEC).find(name)]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_variable_is_found_by_its_own_name_before_any_element(version):
    names = [*ELEMENTS, "leg.force", "leg.forces[1]"]
    assert found(version, names, "leg.force") == ["leg.force"]
    assert found(version, names, "leg.force[4]") == ["leg.force[4]"]


def test_the_elements_of_an_array_are_found_together_in_fmi_2_which_has_no_arrays():
    assert found("2.0", ["leg.forces[1]", *ELEMENTS, "force[1]"], "leg.force") == ELEMENTS
    assert found("2.0", ELEMENTS[::-1], "leg.force") == ELEMENTS, "by index, however they are listed"
    matrix = ["R[1,2]", "R[2,1]", "R[2,10]", "R[2,2]"]
    assert found("2.0", matrix, "R") == ["R[1,2]", "R[2,1]", "R[2,2]", "R[2,10]"]
    with pytest.raises(
        PlantError, match=r"no variable 'leg.force'; close to it: leg.force\[1\], leg.force\[2\]"
    ):
        found("3.0", ELEMENTS, "leg.force")


def test_names_that_are_close_are_offered_and_else_some_of_those_that_there_are():
    names = [f"Leg.FORCE_{k}" for k in range(20)]
    with pytest.raises(PlantError) as told:
        found("2.0", names, "force")
    assert str(told.value).endswith(f"close to it: {', '.join(sorted(names)[:8])}")
    with pytest.raises(PlantError) as told:
        found("2.0", names, "thrust")
    assert str(told.value).endswith(f"; it has {', '.join(sorted(names)[:12])} ...")


def test_a_value_reference_is_a_number_of_32_bits_in_plain_digits():
    description = SimpleNamespace(fmiVersion="2.0", unitDefinitions=[], modelVariables=[])
    reader = _Reader(description, SPEC)
    for number in (0, 1, 4_294_967_295):
        for stated in (number, str(number)):
            assert reader.reference(SimpleNamespace(name="a", valueReference=stated)) == number
    for wrong in ("4294967296", "-1", "+1", "1.0", "1_0", "0x1", "", " 1", "\u0663", "\u00b2", None):
        with pytest.raises(
            PlantError, match=r"variable 'a' has the valueReference .* 0 to 4294967295 are allowed"
        ):
            reader.reference(SimpleNamespace(name="a", valueReference=wrong))
