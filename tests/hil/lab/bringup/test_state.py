"""State file of a bring-up: facts that are kept or dropped with a leg, a drive or hardware; damaged files."""

from __future__ import annotations

import json
from typing import Any

import pytest

from drivers.errors import RunError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.lab.bringup.context import Finding, forget_legs
from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.steps import gauge
from hil.lab.bringup.store import Store, identity
from tests.hil.lab.bringup.rehearsals import Rehearsal

STATE = json.dumps({"version": 7, "identity": {}, "facts": {"held": {"0": {"moved": True}}}, "check": ""})
DAMAGED = {
    "empty": lambda _: "",
    "half": lambda text: text[: len(text) // 2],
    "another file": lambda _: "{}",
    "too deep": lambda _: "[" * 100_000,
    "another version": lambda text: text.replace('"version": 7', '"version": 6'),
    "no check": lambda _: STATE,
    "a fact by hand": lambda text: text.replace('"moved": true', '"moved": false'),
    "hardware by hand": lambda text: text.replace('"stroke": 1', '"stroke": 2'),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_damaged_bring_up_state_file_is_refused_in_one_line_and_left_unchanged(tmp_path, case):
    path = tmp_path / "state.json"
    store = Store(path, {"stroke": 1})
    store.facts["held"] = {"0": {"moved": True, "hand_N": None}}
    store.save()
    assert Store(path, {"stroke": 1}).facts == store.facts
    damaged = DAMAGED[case](path.read_text())
    path.write_text(damaged)
    with pytest.raises(RunError) as caught:
        Store(path, {"stroke": 1})
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert path.read_text() == damaged


def test_continued_bring_up_reads_stored_measurements_and_repeats_only_missing_ones(tmp_path):
    rehearsal = Rehearsal("virtual")
    store = Store(tmp_path / "state.json", {})
    rehearsal.context.facts = store.facts
    rehearsal.run()
    store.save()
    assert Store(tmp_path / "state.json", {}).facts == store.facts
    assert set(store.facts) >= {"scan", "watchdog", "ids", "encoder", "held", "opens", "force", "gauge"}
    del store.facts["gauge"]["1"], store.facts["held"]["2"]
    again = Rehearsal("virtual", facts=store.facts)
    assert again.run().passed == tuple(step.name for step in STEPS)
    acts = [request.act for request in again.hands.requests]
    asked = [(each.act, each.leg) for each in again.hands.requests[: acts.index("hang")]]
    assert [each for each in asked if each[0] in {"read_gauge", "read_held"}] == [
        ("read_held", 2),
        *[("read_gauge", 1)] * 4,
    ]
    store.facts["encoder"]["3"]["scale"] = 0.0
    assert list(gauge.judge(again.context)) == [], "no lead finding without a working encoder"


def test_bring_up_state_file_that_cannot_be_written_raises_an_error(tmp_path):
    store = Store(tmp_path / "gone" / "s.json", {})
    with pytest.raises(RunError, match="cannot be written"):
        store.save()


OF_LEGS = {
    "watchdog": lambda k: {"powered": True, "until_s": 0.01, "since_s": 0.009},
    "ids": lambda k: {"drives": [k], "changes_m": [0.0] * 6},
    "encoder": lambda k: {"drive": k, "tape_m": [1, 2], "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0},
    "held": lambda k: {"moved": False, "hand_N": 700.0},
    "opens": lambda k: {"legs": [k], "hand_N": 30.0, "rate_share": 1.0},
    "shuts": lambda k: {"opens": True, "late_s": 0.0},
    "force": lambda k: {"plus": {}, "minus": {}},
    "gauge": lambda k: {"pairs_N": []},
}
"""Facts about one leg or its drive, by step."""


def all_facts() -> dict[str, dict[str, Any]]:
    """Facts of a machine that has passed every step."""
    facts: dict[str, dict[str, Any]] = {
        step: {str(k): fact(k) for k in range(6)} for step, fact in OF_LEGS.items()
    }
    whole: dict[str, dict[str, Any]] = {
        "mounted": {"0": {"q_m": [1.0] * 6}, "1": {"q_m": [1.1] * 6}},
        "taped": {"0": {"q_m": [1.0] * 6}, "1": {"q_m": [1.1] * 6}},
        "hoisted": {"unloaded": {str(k): True for k in range(6)}},
        "load": {"mass_kg": 1150.0, "presses": 1.0},
        "passed": dict.fromkeys([*OF_LEGS, "mounted"], True),
    }
    return facts | whole | {"platform": {"hung": True}, "identity": {str(k): {} for k in range(6)}}


@pytest.mark.parametrize("legs", [{0}, {1}, {2}, {3}, {4}, {5}, {1, 4}])
@pytest.mark.parametrize("by_finding", [False, True])
def test_all_measurements_of_a_replaced_leg_or_drive_are_discarded(
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
    assert facts.keys() == {*OF_LEGS, "platform", "identity"}, "the hanging platform is never forgotten"


@pytest.mark.parametrize(
    ("step", "fact"),
    [
        ("ids", {"drives": [4]}),
        ("ids", {"drives": [2, 4]}),
        ("encoder", {"drive": 4}),
        ("opens", {"legs": [1, 4]}),
    ],
)
def test_measurements_of_other_legs_by_a_replaced_drive_are_dropped(step: str, fact: dict[str, Any]) -> None:
    facts = all_facts()
    facts[step]["1"] |= fact
    forget_legs(facts, {4})
    assert set(facts[step]) == {"0", "2", "3", "5"}
    assert all(set(facts[other]) == set("01235") for other in OF_LEGS if other != step)


OTHERS: dict[str, tuple[str, dict[str, Any], str]] = {
    "watchdog": ("desktop", {"drives": {"watchdog_ms": 12}}, "drives"),
    "rated_force": ("desktop", {"drives": {"force_limit_N": 200}}, "drives"),
    "radius": ("desktop", {"drives": {"transmission": {"pulley_radius_m": 0.021}}}, "drives"),
    "numbers": ("virtual", {"drives": {"node_ids": [1, 2, 3, 4, 6, 5]}}, "node numbers"),
    "shorter": ("virtual", {"platform": {"length_min_m": 0.76}}, "stroke"),
    "bus": ("virtual", {"bus": {"channel": "hil9"}}, "bus"),
}


@pytest.mark.parametrize("case", OTHERS)
def test_all_measurements_are_discarded_if_the_configured_hardware_changed(case, tmp_path):
    name, changes, changed = OTHERS[case]
    c, path = load(name), tmp_path / "s.json"
    store = Store(path, identity(c, ()))
    store.facts["watchdog"] = {"0": {"powered": True, "until_s": 0.012, "since_s": 0.01}}
    store.facts["platform"] = {"hung": True}
    store.save()
    assert Store(path, identity(c, ())).facts == store.facts
    other = loads(with_changes(c.text, changes), "other.yaml", c.folder)
    again = Store(path, identity(other, ()))
    assert (again.changed, again.facts) == (changed, {"platform": {"hung": True}})
