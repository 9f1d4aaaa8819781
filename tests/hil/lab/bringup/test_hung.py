"""A platform that hangs on the legs: it is written down, and taken off before a brake opens or a leg is moved."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivers.tick_columns import new_record
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.lab.bringup import command
from hil.lab.bringup.context import Finding, Request
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.ends import End
from hil.lab.bringup.procedure import STEPS, Outcome
from hil.lab.bringup.steps import brakes, encoder, ids, scan, silence
from hil.lab.bringup.store import Store, identity
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal, named

MOUNTED = STEPS[-1:]


def saved(rehearsal: Rehearsal) -> list[str]:
    """Return all that a bring-up writes into its state file from now on."""
    written: list[str] = []
    rehearsal.context.save = lambda: written.append(json.dumps(rehearsal.context.facts))
    return written


def asked(rehearsal: Rehearsal, act: str) -> list[float]:
    return [request.value for request in rehearsal.hands.requests if request.act == act]


@pytest.mark.parametrize("stop_at", [3, 4], ids=["first pose", "second pose"])
def test_who_is_ended_while_the_platform_is_being_hung_has_written_that_it_may_hang(stop_at: int) -> None:
    rehearsal = Rehearsal("virtual", Wiring(), stop_at=stop_at)
    written = saved(rehearsal)
    with pytest.raises(KeyboardInterrupt):
        rehearsal.run(MOUNTED)
    assert rehearsal.hands.requests[-1].act == "hang"
    facts = json.loads(written[-1])
    assert facts["platform"] == {"hung": True}
    again = Rehearsal("virtual", Wiring(), facts=facts)
    again.bench.hung = True
    with again.context.opened(2):
        assert not again.bench.hung
    assert (len(asked(again, "take_down")), again.watched.opened_while_hung) == (1, 0)


def test_a_platform_that_is_not_to_be_hung_is_not_said_to_hang() -> None:
    rehearsal = Rehearsal("virtual", Wiring(), stop_at=2)
    with pytest.raises(KeyboardInterrupt):
        rehearsal.run(MOUNTED)
    assert "platform" not in rehearsal.context.facts


def test_each_time_the_platform_was_taken_down_it_is_hung_and_read_anew_at_each_pose() -> None:
    facts: dict[str, dict[str, Any]] = {}
    hung: list[list[float]] = []
    for _ in range(3):
        rehearsal = Rehearsal("virtual", Wiring(), facts=facts)
        written = saved(rehearsal)
        for _ in range(2):
            rehearsal.context.take_down()
        assert len(asked(rehearsal, "take_down")) == len(written) == len(hung[:1]), "once, where it hangs"
        assert not {"platform", "mounted"} & {name for each in written for name in json.loads(each)}
        assert not {"platform", "mounted"} & facts.keys()
        assert rehearsal.run(MOUNTED).success
        hung.append(asked(rehearsal, "hang"))
        assert set(facts["mounted"]) == {"0", "1"}
    assert hung == [[0.0, 1.0]] * 3


def test_no_brake_opens_while_the_platform_hangs_on_the_legs():
    """It was hung in an earlier run; a leg is to be measured again. It comes off on a typed word."""
    rehearsal = Rehearsal("virtual", Wiring(), facts={"platform": {"hung": True}})
    rehearsal.bench.hung = True
    outcome = rehearsal.run(STEPS[:5])
    assert outcome.success
    acts = [(request.act, request.word) for request in rehearsal.hands.requests]
    assert acts.count(("take_down", "down")) == 1
    assert rehearsal.watched.most_open == 1
    assert rehearsal.watched.opened_while_hung == 0


@pytest.mark.parametrize(
    ("name", "gone", "steps"),
    [
        ("virtual", (), (ids.STEP,)),
        ("virtual", (), (encoder.STEP,)),
        ("cubemars", (), STEPS[2:3]),
        ("virtual", ("held", "opens"), (brakes.STEP,)),
    ],
)
def test_no_hand_moves_or_pushes_a_leg_that_the_platform_hangs_on(name, gone, steps):
    """In the closed chain no leg gives way: a brake that slips would be taken for one that holds."""
    facts: dict[str, dict[str, object]] = {}
    if gone:
        before = Rehearsal(name, Wiring())
        before.run(STEPS[:5])
        facts = {step: table for step, table in before.context.facts.items() if step not in {*gone, "passed"}}
    if steps == (encoder.STEP,):
        facts = {"ids": {str(k): {"drives": [k], "changes_m": [0.0] * 6} for k in range(6)}}
    rehearsal = Rehearsal(name, Wiring(), facts=facts | {"platform": {"hung": True}})
    rehearsal.bench.hung = True
    rehearsal.run(steps)
    assert rehearsal.hands.requests[0].act == "take_down"
    assert not rehearsal.bench.hung


@pytest.mark.long
def test_after_legs_were_mended_that_were_mounted_elsewhere_the_platform_comes_off():
    rehearsal = Rehearsal("virtual", wired(Mistake("mounted_elsewhere", 1, 2)))
    assert {name for name, _ in named(rehearsal.run())} == {"mounted_elsewhere"}
    facts = rehearsal.context.facts
    for step in ("opens", "force", "gauge"):
        facts[step].pop("1")
    facts.pop("passed")
    mended = Rehearsal("virtual", Wiring(), facts=facts)
    mended.bench.hung = True
    assert mended.run().success
    assert [request.act for request in mended.hands.requests].count("take_down") == 1
    assert mended.watched.opened_while_hung == 0


@pytest.mark.parametrize("name", ["absent", "same_id", "wrong_protocol", "second_controller", "set_up"])
def test_a_platform_that_hangs_is_known_after_a_finding_for_which_the_bus_is_scanned_again(tmp_path, name):
    path = tmp_path / "s.json"
    store = Store(path, {})
    facts = store.facts
    facts |= {"platform": {"hung": True}, "passed": {"mounted": True}}
    store.forget([Finding(name, (2,), "", "")])
    assert Store(path, {}).facts == facts == {"platform": {"hung": True}}


def test_after_an_absent_drive_no_brake_opens_before_the_hung_platform_is_off(tmp_path):
    store = Store(tmp_path / "s.json", {})
    store.facts["platform"] = {"hung": True}
    store.forget([Finding("absent", (2,), "", "")])
    rehearsal = Rehearsal("virtual", Wiring(), facts=Store(tmp_path / "s.json", {}).facts)
    rehearsal.bench.hung = True
    rehearsal.run((scan.STEP, silence.STEP))
    with rehearsal.context.opened(3):
        assert not rehearsal.bench.hung
    assert [request.act for request in rehearsal.hands.requests] == ["take_down"]
    assert rehearsal.watched.most_open == 1
    assert rehearsal.watched.opened_while_hung == 0


def test_a_new_beginning_still_knows_that_the_platform_hangs(tmp_path):
    c = load("virtual")
    path = tmp_path / "state.json"
    store = Store(path, identity(c, ()))
    store.facts |= {"platform": {"hung": True}, "held": {"0": {"moved": False, "hand_N": 700.0}}}
    store.save()
    assert Store(path, identity(c, ()), again=True).facts == {"platform": {"hung": True}}
    assert Store(path, identity(c, ("other",))).facts == {"platform": {"hung": True}}


def weighs(rehearsal: Rehearsal, typed: Callable[[], float]) -> None:
    """Let this be typed for the weight of the platform."""
    do = rehearsal.bench.do
    rehearsal.bench.do = lambda act, *given: typed() if act == "weigh" else do(act, *given)  # type: ignore[method-assign]


@pytest.mark.parametrize("typed", [0.0, 1190.0])
def test_a_platform_that_cannot_be_weighed_is_a_gap_and_one_of_some_percent_more_is_not(typed):
    rehearsal = Rehearsal("virtual", Wiring())
    weighs(rehearsal, lambda: typed)
    outcome = rehearsal.run(MOUNTED)
    assert outcome.findings == ()
    assert len(outcome.gaps) == (typed == 0.0)
    assert outcome.passed == (("mounted",) if typed else ())


def test_which_way_a_weight_acts_is_asked_wherever_gravity_points():
    rehearsal = Rehearsal("virtual", Wiring())
    c = rehearsal.context
    c.machine = replace(c.machine, presses=0.0)
    assert named(rehearsal.run(MOUNTED)) == {("gravity", ())}
    assert [r.act for r in rehearsal.hands.requests].count("read_way") == 1


def test_a_mass_in_grams_is_asked_for_again():
    rehearsal, typed = Rehearsal("virtual", Wiring()), iter((1.15e6, 1150.0))
    rehearsal.hands.patience = 2
    weighs(rehearsal, lambda: next(typed))
    assert rehearsal.run(MOUNTED).findings == ()
    assert [r.act for r in rehearsal.hands.requests].count("weigh") == 2


FOUND = (Finding("encoder_sign", (3,), "", ""), Finding("payload", (), "", ""))


ENDS = {
    "good": (Outcome(("scan",), ()), True),
    "one_leg": (Outcome(("scan",), FOUND[:1]), False),
    "the_platform": (Outcome(("scan",), FOUND[1:]), False),
    "stopped_with_findings": (Outcome((), FOUND, stopped="ids"), False),
    "stopped": (Outcome(("scan",), (), stopped="mounted"), False),
}


class Asked:
    """An operator who does at once what he is asked. Mutable state: what he was asked."""

    patience = 1.0

    def __init__(self) -> None:
        self.requests: list[Request] = []

    def consent(self, *_: str) -> bool:
        return True

    def tell(self, _text: str) -> None:
        pass

    def ask(self, request: Request) -> None:
        self.requests.append(request)

    def answer(self) -> float:
        return 0.0


@pytest.mark.parametrize("machine", [True, False])
@pytest.mark.parametrize("case", ENDS)
def test_nobody_is_told_to_fix_the_platform_to_legs_that_are_to_be_mended(
    case, machine, tmp_path, monkeypatch
):
    outcome, good = ENDS[case]
    monkeypatch.setattr(command, "bring_up", lambda _: outcome)
    monkeypatch.setattr(Drives, "step", lambda *_: new_record())
    c, operator = load("virtual"), Asked()
    line = type("Line", (), {"rate_Hz": 500.0})()
    said = type("Said", (), {"tick": None})()
    end, store = End(line, operator), Store(tmp_path / "s.json", {})
    found, _, why = command._proceed(c, build_protocol(c), end, store, said, hang=machine)
    assert (found, why) == (outcome, "")
    assert [request.act for request in operator.requests] == ["mount"] * (good and machine)
