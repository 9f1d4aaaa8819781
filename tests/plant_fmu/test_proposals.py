"""Which variables of an FMU are proposed for which key: by number, unit and name, and only where one group fits."""

from __future__ import annotations

import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from plant_fmu.fmu.propose import Proposal, propose


def variable(name: str, causality: str = "input", unit: str | None = None, **more: Any) -> Any:
    return SimpleNamespace(
        **{
            "name": name,
            "causality": causality,
            "unit": unit,
            "type": "Real",
            "shape": (),
            "declaredType": None,
            **more,
        }
    )


def six(name: str, causality: str = "input", unit: str | None = None, first: int = 1) -> list[Any]:
    """Return six variables; {} in the name is the leg."""
    return [variable(name.format(first + k), causality, unit) for k in range(6)]


@pytest.fixture
def proposed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """What is proposed for an FMU with these variables."""
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", b"")

    def of(*variables: Any, tool: str | None = "maker", needs: bool = False) -> Proposal:
        description = SimpleNamespace(
            modelVariables=variables,
            coSimulation=SimpleNamespace(needsExecutionTool=needs, modelIdentifier="a"),
            generationTool=tool,
            fmiVersion="2.0",
        )
        monkeypatch.setattr("plant_fmu.fmu.propose.described", lambda _: description)
        return propose(path)

    return of


@pytest.mark.parametrize("first", [0, 1])
def test_six_of_a_name_are_those_that_count_from_0_or_1_in_the_order_of_their_numbers(proposed, first):
    names = tuple(f"force_{first + k}" for k in range(6))
    mixed = [variable(name) for name in (*names[3:], *names[:3])]
    assert proposed(*mixed).mapped == {"force": names}


@pytest.mark.parametrize("numbers", [range(2, 8), range(1, 6), range(1, 8), range(7), (0, 1, 2, 3, 4, 6)])
def test_other_numbers_than_six_from_0_or_1_on_are_no_legs(proposed, numbers):
    found = proposed(*[variable(f"force_{k}") for k in numbers])
    assert found.mapped == {}
    assert found.missing == ("force", "length", "rate")


def test_six_that_are_not_all_inputs_or_not_all_numbers_are_none(proposed):
    parts = six("force_{}")
    assert proposed(*parts[:3], *six("force_{}", "output")[3:]).mapped == {}
    parts[5].type = "Integer"
    assert proposed(*parts).mapped == {}


def test_an_array_of_six_is_proposed_and_one_of_another_shape_is_not(proposed):
    for shape, mapped in (((6,), {"force": ("force",)}), ((5,), {}), ((6, 1), {}), ((1, 6), {}), ((7,), {})):
        assert proposed(variable("force", shape=shape)).mapped == mapped


ROLES = [
    ("force", "input", "N", ["force", "f", "leg.tau", "taus", "effort", "leg_thrust", "u", "main thrust in"]),
    ("rate", "output", "m/s", ["rate", "v", "leg.dq", "qd", "dl", "Leg Velocity", "ldot", "speeds", "velo"]),
    (
        "length",
        "output",
        "m",
        ["length", "q", "leg x", "l", "stroke", "len", "lens", "leg.posi", "leg.Position"],
    ),
    ("brake", "input", None, ["brake", "lock", "leg clamps", "hold"]),
]


@pytest.mark.parametrize(("key", "causality", "unit", "names"), ROLES)
def test_a_name_is_that_of_a_key_by_one_of_its_words_in_its_causality_alone(
    proposed, key, causality, unit, names
):
    other = {"input": "output", "output": "input"}[causality]
    for name in names:
        for stated in {unit, None}:
            group = six(name + "_{}", causality, stated)
            found = proposed(*group)
            assert found.mapped == {key: tuple(v.name for v in group)}, name
            assert found.unstated == ({} if stated == unit else {key: unit})
        assert key not in proposed(*six(name + "_{}", other)).mapped, name
        if unit is not None:
            assert key not in proposed(*six(name + "_{}", causality, "rad")).mapped, name


@pytest.mark.parametrize("name", ["paddling_{}", "qdx_{}", "value_{}", "xl_{}", "leg.dqs_{}"])
def test_words_of_one_or_two_letters_count_as_a_whole_alone(proposed, name):
    assert proposed(*six(name, "output")).mapped == {}


def test_a_stated_unit_counts_more_than_a_name_and_a_whole_word_more_than_a_part(proposed):
    exact, loose = six("force_{}"), six("forces_{}")
    exact_N, loose_N = six("b.force_{}", unit="N"), six("b.forces_{}", unit="N")
    for better, worse in ((exact, loose), (loose_N, exact), (exact_N, loose_N)):
        for groups in ((better, worse), (worse, better)):
            found = proposed(*groups[0], *groups[1])
            assert found.mapped == {"force": tuple(v.name for v in better)}


def test_of_two_groups_that_fit_alike_none_is_proposed(proposed):
    assert proposed(*six("a.force_{}"), *six("b.force_{}")).mapped == {}


def test_what_is_a_brake_by_its_name_is_no_force(proposed):
    group = six("hold_force_{}")
    found = proposed(*group)
    assert found.mapped == {"brake": tuple(v.name for v in group)}
    assert found.unstated == {}
    assert found.missing == ("force", "length", "rate")


def test_a_unit_that_one_of_six_does_not_state_is_to_be_stated(proposed):
    for at in range(6):
        group = six("force_{}", unit="N")
        group[at].unit = None
        if at == 0:
            group[at].declaredType = SimpleNamespace(unit="N")
        assert proposed(*group).unstated == ({} if at == 0 else {"force": "N"})


def test_a_proposal_tells_who_made_the_fmu_what_can_be_set_and_what_goes_in_and_out(proposed):
    variables = [
        variable("mass", "parameter", "kg"),
        variable("on", "parameter", type="Boolean"),
        variable("force", unit="N", shape=(6,)),
        variable("q", "output"),
        variable("inner", "local"),
    ]
    found = proposed(*variables)
    assert (found.tool, found.fmi, found.needs_tool) == ("maker", "2.0", False)
    assert found.parameters == ("mass", "on")
    assert found.variables == ("input   force[6]  Real, N", "output  q  Real, no unit stated")
    assert proposed(tool=None).tool == "unknown tool"
    assert proposed(needs=True).needs_tool is True
