"""A platform hanging on the legs is recorded, and taken off before a brake opens or a leg is moved."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.tick_columns import new_record
from hil.app.configuration.configuration import load
from hil.lab.bringup import command
from hil.lab.bringup.context import Finding
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.procedure import STEPS, Outcome
from hil.lab.bringup.rehearsal import mistake_of
from hil.lab.bringup.steps import brakes, encoder, ids, mounted
from hil.lab.bringup.store import Store, identity
from plant_fmu.rehearsal.wiring import wired
from tests.hil.lab.bringup.rehearsals import Rehearsal, named

MOUNTED = STEPS[-2:-1]


def saved(rehearsal: Rehearsal) -> list[str]:
    """List of all texts that the bring-up saves to its state file from now on."""
    written: list[str] = []
    rehearsal.context.save = lambda: written.append(json.dumps(rehearsal.context.facts))
    return written


def asked(rehearsal: Rehearsal, act: str) -> list[float]:
    return [request.value for request in rehearsal.hands.requests if request.act == act]


@pytest.mark.parametrize("stop_at", [2, 9], ids=["first pose", "second pose"])
def test_mounting_that_is_interrupted_is_recorded_as_a_hanging_platform(stop_at: int) -> None:
    rehearsal = Rehearsal("virtual", stop_at=stop_at)
    written = saved(rehearsal)
    with pytest.raises(KeyboardInterrupt):
        rehearsal.run(MOUNTED)
    assert rehearsal.hands.requests[-1].act == "hang"
    facts = json.loads(written[-1])
    assert facts["platform"] == {"hung": True}
    again = Rehearsal("virtual", facts=facts)
    again.bench.hung = True
    with again.context.opened(2):
        assert not again.bench.hung
    assert (len(asked(again, "take_down")), again.watched.opened_while_hung) == (1, 0)


def test_no_brake_opens_while_the_platform_hangs_on_the_legs():
    """It was hung in an earlier run and a leg must be measured again: it is taken off, confirmed by a word."""
    rehearsal = Rehearsal("virtual", facts={"platform": {"hung": True}})
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
def test_platform_is_taken_off_before_a_leg_is_moved_or_pushed_by_hand(name, gone, steps):
    """In the closed chain no leg gives way, so a slipping brake would seem to hold."""
    facts: dict[str, dict[str, object]] = {}
    if gone:
        before = Rehearsal(name)
        before.run(STEPS[:5])
        facts = {step: table for step, table in before.context.facts.items() if step not in {*gone, "passed"}}
    if steps == (encoder.STEP,):
        facts = {"ids": {str(k): {"drives": [k], "changes_m": [0.0] * 6} for k in range(6)}}
    rehearsal = Rehearsal(name, facts=facts | {"platform": {"hung": True}})
    rehearsal.bench.hung = True
    rehearsal.run(steps)
    assert rehearsal.hands.requests[0].act == "take_down"
    assert not rehearsal.bench.hung


@pytest.mark.long
def test_platform_is_taken_off_after_the_mounting_was_corrected():
    rehearsal = Rehearsal("virtual", "mounted_elsewhere leg=1 other=2")
    assert {name for name, _ in named(rehearsal.run())} == {"mounted_elsewhere"}
    facts = rehearsal.context.facts
    for step in ("opens", "force", "gauge"):
        facts[step].pop("1")
    facts.pop("passed")
    repaired = Rehearsal("virtual", facts=facts)
    repaired.bench.hung = True
    assert repaired.run().success
    assert [request.act for request in repaired.hands.requests].count("take_down") == 1
    assert repaired.watched.opened_while_hung == 0


@pytest.mark.parametrize("name", ["absent", "same_id", "wrong_protocol", "second_controller", "set_up"])
def test_hanging_platform_is_remembered_after_a_new_scan_of_the_bus(tmp_path, name):
    path = tmp_path / "s.json"
    store = Store(path, {})
    facts = store.facts
    facts |= {"platform": {"hung": True}, "passed": {"mounted": True}}
    store.forget([Finding(name, (2,), "", "")])
    assert Store(path, {}).facts == facts == {"platform": {"hung": True}}


def test_hanging_platform_is_remembered_with_option_again_or_new_hardware(tmp_path):
    c = load("virtual")
    path = tmp_path / "state.json"
    store = Store(path, identity(c, ()))
    store.facts |= {"platform": {"hung": True}, "held": {"0": {"moved": False, "hand_N": 700.0}}}
    store.save()
    assert Store(path, identity(c, ()), again=True).facts == {"platform": {"hung": True}}
    assert Store(path, identity(c, ("other",))).facts == {"platform": {"hung": True}}


def weighs(rehearsal: Rehearsal, typed: Callable[[], float]) -> None:
    """Replace the weighing of the platform by a typed value."""
    do = rehearsal.bench.do
    rehearsal.bench.do = lambda act, *given: typed() if act == "weigh" else do(act, *given)  # type: ignore[method-assign]


@pytest.mark.parametrize("typed", [0.0, 1190.0])
def test_platform_mass_is_reported_as_unproven_if_the_platform_cannot_be_weighed(typed):
    rehearsal = Rehearsal("virtual")
    weighs(rehearsal, lambda: typed)
    outcome = rehearsal.run(MOUNTED)
    assert outcome.findings == ()
    assert len(outcome.gaps) == (typed == 0.0)
    assert outcome.passed == (("mounted",) if typed else ())


@pytest.mark.parametrize(
    ("mistake", "found"),
    [
        ("offset leg=2 value=0.004", ("slipped", (2,))),
        ("encoder_scale leg=3 value=0.85", ("scale_or_lead", (3,))),
        ("wrong_lead leg=2", ("scale_or_lead", (2,))),
        ("upside_down", ("gravity", ())),
    ],
)
def test_tape_measurements_at_known_poses_find_legs_changed_by_the_mounting(mistake, found):
    rehearsal = Rehearsal("desktop", wired(mistake_of(f"{mistake} mounting")))
    assert named(rehearsal.run(MOUNTED)) == {found}
    assert Rehearsal("desktop").run(MOUNTED).success


@pytest.mark.parametrize(("read_m", "found"), [(0.0, set()), (5e-3, {"scale_or_lead"})])
def test_leg_of_equal_tape_lengths_at_both_poses_is_compared_in_metres_not_by_a_ratio(read_m, found):
    rehearsal = Rehearsal("virtual")
    rehearsal.run(MOUNTED)
    c = rehearsal.context
    c.machine.pose_lengths[1, 2] = c.machine.pose_lengths[0, 2]
    for pose, key in ((0, "mounted"), (1, "mounted"), (0, "taped"), (1, "taped")):
        c.known(key, pose)["q_m"][2] = c.machine.pose_lengths[0, 2] + read_m * pose * (key == "mounted")
    assert {finding.name for finding in mounted.judge(c)} == found


def test_crossed_encoders_are_found_by_tape_and_not_taken_for_wrong_joint_positions():
    rehearsal = Rehearsal("virtual", wired(mistake_of("encoder_crossed leg=1 other=4 mounting")))
    assert named(rehearsal.run(MOUNTED)) == {("encoder_crossed", (1,)), ("encoder_crossed", (4,))}


@pytest.fixture(scope="module")
def proven():
    """Facts of a good machine about its legs on trestles."""
    rehearsal = Rehearsal("virtual")
    rehearsal.run(STEPS[:4])
    return json.dumps({"encoder": rehearsal.context.facts["encoder"], "platform": {"hung": True}})


def hoisted(facts: str, wiring: str = "") -> Rehearsal:
    """A mounted machine of which only the step on the hoist is missing."""
    rehearsal = Rehearsal("virtual", wiring, facts=json.loads(facts))
    rehearsal.bench.hung = True
    return rehearsal


@pytest.mark.parametrize(
    ("mistake", "found"),
    [
        ("", None),
        ("brake_crossed leg=1 other=4", ("brake_crossed", (1, 4))),
        ("brake_of_another leg=1 other=4", ("brake_crossed", (1, 4))),
        ("brake_stuck_open leg=2", ("brake_stuck_open", (2,))),
        ("encoder_late leg=2 value=0.02", ("late_or_lags", (2,))),
        ("force_lags leg=2 value=0.05", ("late_or_lags", (2,))),
    ],
)
def test_brakes_and_drives_are_tested_again_on_the_hoist(proven, mistake, found):
    rehearsal = hoisted(proven, mistake)
    outcome = rehearsal.run(STEPS[-1:])
    assert found in named(outcome) if found else outcome.success
    acts = [(each.act, each.word) for each in rehearsal.hands.requests]
    assert acts[0] == ("carry", "carried")
    assert ("take_down", "down") not in acts
    opened = {"brake_of_another": 2, "brake_stuck_open": 0}.get(mistake.split(" ")[0], 1)
    assert rehearsal.watched.most_open == opened


@pytest.mark.parametrize(
    ("slackens_at", "time", "kept", "most_m"),
    [
        (("let_go", 5), 1, {}, 5e-3),
        (("let_go", 5), 1, {"unloaded": dict.fromkeys("012345", True)}, 5e-3),
        (("push", 2), 2, {}, 0.03),
    ],
)
def test_brake_shuts_if_the_hoist_does_not_carry_the_whole_platform(proven, slackens_at, time, kept, most_m):
    """The weight is on leg 2 before its brake opens, in a repeated run too, or while it is pushed."""
    rehearsal = hoisted(json.dumps(json.loads(proven) | {"hoisted": kept}))
    bench, do, seen = rehearsal.bench, rehearsal.bench.do, []

    def slack(act: str, *given: Any) -> float:
        answer = do(act, *given)
        seen.append((act, *given[:1]))
        if seen.count(slackens_at) >= time:
            bench._legs.push(2, 300.0, on=True)
        return answer

    cast("Any", bench).do = slack
    before = bench.length(2)
    assert named(rehearsal.run(STEPS[-1:])) == {("loaded", (2,))}
    assert 5e-4 < bench.length(2) - before < most_m
    assert "clear" not in [act for act, *_ in seen]


FOUND = (Finding("encoder_sign", (3,), "", ""),)
ENDS = {
    "good": (Outcome(("scan",), ()), True),
    "a finding": (Outcome(("scan",), FOUND), False),
    "stopped": (Outcome(("scan",), (), stopped="mounted"), False),
}


@pytest.mark.parametrize("machine", [True, False])
@pytest.mark.parametrize("case", ENDS)
def test_mounting_of_the_platform_is_requested_only_without_findings(case, machine, monkeypatch):
    outcome, good = ENDS[case]
    asked: list[str] = []
    operator: Any = SimpleNamespace(
        patience=1.0,
        consent=lambda *_: True,
        tell=lambda _: None,
        ask=lambda request: asked.append(request.act),
        answer=lambda: 0.0,
    )
    monkeypatch.setattr(command, "bring_up", lambda _: outcome)
    monkeypatch.setattr(Drives, "step", lambda *_: new_record())
    context = Rehearsal("virtual").context
    context.operator = operator
    command._proceed(context, hang=machine)
    assert asked == ["mount"] * (good and machine)
