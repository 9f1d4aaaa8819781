"""Which facts are dropped with a leg that is mended, or a drive that is exchanged, and which stay."""

from __future__ import annotations

from typing import Any

import pytest

from hil.lab.bringup.context import Finding
from hil.lab.bringup.facts import forget_legs
from hil.lab.bringup.store import Store

OF_LEGS = {
    "watchdog": lambda k: {"powered": True, "until_s": 0.01, "since_s": 0.009},
    "ids": lambda k: {"drives": [k], "changes_m": [0.0] * 6},
    "encoder": lambda k: {"drive": k, "tape_m": [1, 2], "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0},
    "held": lambda k: {"moved": False, "hand_N": 700.0},
    "opens": lambda k: {"legs": [k], "hand_N": 30.0, "rate_share": 1.0},
    "force": lambda k: {"plus": {}, "minus": {}},
    "gauge": lambda k: {"pairs_N": []},
}
"""All that is proven of one leg or its drive."""


def all_facts() -> dict[str, dict[str, Any]]:
    """Return the facts of a machine that has passed every step."""
    facts: dict[str, dict[str, Any]] = {
        step: {str(k): fact(k) for k in range(6)} for step, fact in OF_LEGS.items()
    }
    whole: dict[str, dict[str, Any]] = {
        "mounted": {"0": {"q_m": [1.0] * 6}, "1": {"q_m": [1.1] * 6}},
        "load": {"mass_kg": 1150.0, "presses": 1.0},
        "passed": dict.fromkeys([*OF_LEGS, "mounted"], True),
    }
    return facts | whole | {"platform": {"hung": True}, "identity": {str(k): {} for k in range(6)}}


@pytest.mark.parametrize("legs", [{0}, {1}, {2}, {3}, {4}, {5}, {1, 4}])
@pytest.mark.parametrize("by_finding", [False, True])
def test_nothing_that_was_proven_of_a_leg_or_its_drive_outlives_it(
    legs: set[int], by_finding: bool, tmp_path: Any
) -> None:
    facts = all_facts()
    if by_finding:
        store = Store(tmp_path / "s.json", {})
        store.facts = facts
        store.forget([Finding("watchdog_long", tuple(legs), "", "")])
    else:
        forget_legs(facts, legs)
    others = {str(k) for k in range(6)} - {str(k) for k in legs}
    assert {step: facts[step].keys() for step in OF_LEGS} == dict.fromkeys(OF_LEGS, others)
    assert facts.keys() == {*OF_LEGS, "platform", "identity"}, "the platform hangs whoever was exchanged"


@pytest.mark.parametrize(
    ("step", "fact"),
    [
        ("ids", {"drives": [4]}),
        ("ids", {"drives": [2, 4]}),
        ("encoder", {"drive": 4}),
        ("opens", {"legs": [1, 4]}),
    ],
)
def test_behind_exchanged_numbers_a_fact_that_names_the_drive_goes_with_it(
    step: str, fact: dict[str, Any]
) -> None:
    facts = all_facts()
    facts[step]["1"] |= fact
    forget_legs(facts, {4})
    assert set(facts[step]) == {"0", "2", "3", "5"}
    assert all(set(facts[other]) == set("01235") for other in OF_LEGS if other != step)
