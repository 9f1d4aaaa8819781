"""Mistakes that no table lists: two at once, faults in mid-step, cables off, answers that are none.

Each is named, or ends the bring-up with a sentence; none releases the platform.
"""

import json
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from hil.lab.bringup.context import OLD_TICKS, StoppedError
from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.steps import brakes, encoder, ids
from hil.lab.bringup.store import refuse_malformed
from plant_fmu.faults.kinds import DriveSilence, EncoderFreeze, EncoderJump
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.rehearsal.wiring import OWN, OWN_BRAKES, Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal, named

BY_HAND = STEPS[:4]


def swapped(values: tuple[Any, ...], i: int, j: int) -> tuple[Any, ...]:
    """Exchange two of the values."""
    found = list(values)
    found[i], found[j] = values[j], values[i]
    return tuple(found)


PAIRS = {
    "swapped_and_its_encoder_reversed": (
        wired(Mistake("ids_swapped", 1, 4), Mistake("encoder_sign", 4)),
        {("ids", (1, 4)), ("encoder_sign", (4,))},
    ),
    "scale_on_one_and_home_on_another": (
        wired(Mistake("encoder_scale", 1, value=2.0), Mistake("offset", 3)),
        {("encoder_scale", (1,)), ("offset", (3,))},
    ),
    "force_and_brake": (
        wired(Mistake("force_sign", 5), Mistake("brake_stuck_shut", 0)),
        {("force_sign", (5,)), ("brake_stuck_shut", (0,))},
    ),
    "encoders_and_brakes_of_the_same_two": (
        replace(Wiring(), encoder=swapped(OWN, 2, 3), brake=swapped(OWN_BRAKES, 2, 3)),
        {("ids", (2, 3)), ("motor_crossed", (2, 3))},  # the same as exchanged drives with crossed motors
    ),
    "motors_and_encoders_of_the_same_two": (
        replace(Wiring(), encoder=swapped(OWN, 0, 5), motor=swapped(OWN, 0, 5)),
        {("encoder_crossed", (0, 5))},
    ),
    "two_pairs_of_drives": (
        wired(Mistake("ids_swapped", 0, 1), Mistake("ids_swapped", 2, 3)),
        {("ids", (0, 1, 2, 3))},
    ),
    "gear_4_for_5": (wired(Mistake("wrong_lead", 2, value=0.8)), {("wrong_lead", (2,))}),
    "gear_5_for_4": (wired(Mistake("wrong_lead", 2, value=1.25)), {("wrong_lead", (2,))}),
    "torque_limit_of_one": (
        wired(Mistake("force_scale", 3, value=0.6)),
        {("force_scale", (3,))},
    ),
    "encoder_jumps": (wired(Mistake("encoder_jumps", 5)), {("encoder_jumps", (5,))}),
    "encoder_stops_half_way": (wired(Mistake("encoder_stops", 0)), {("encoder_jumps", (0,))}),
    "play": (wired(Mistake("backlash", 4)), {("encoder_jumps", (4,))}),
    "nobody_answers": (replace(Wiring(), present=(False,) * 6), {("absent", (0, 1, 2, 3, 4, 5))}),
    "two_absent": (
        wired(Mistake("absent", 1), Mistake("absent", 4)),
        {("absent", (1,)), ("absent", (4,))},
    ),
    "a_number_twice_and_an_encoder": (
        wired(Mistake("same_id", 5, 2), Mistake("encoder_sign", 0)),
        {("same_id", (2, 5))},
    ),
}
QUICK = {"encoder_jumps", "play", "nobody_answers"}


@pytest.mark.parametrize(
    "case", [case if case in QUICK else pytest.param(case, marks=pytest.mark.long) for case in PAIRS]
)
def test_what_nobody_listed_is_named(case):
    wiring, expected = PAIRS[case]
    rehearsal = Rehearsal("virtual", wiring)
    outcome = rehearsal.run(BY_HAND if case in QUICK else STEPS)
    assert named(outcome) == expected
    assert not outcome.success
    assert rehearsal.watched.most_open <= 1


@pytest.mark.parametrize(
    ("name", "mistake", "steps", "says"),
    [
        ("virtual", Mistake("rate_sign", 2), 5, "its rate is -1.01 times what its reading changes by"),
        ("virtual", Mistake("brake_inverted", 1), 5, "holds while that should be open"),
        ("virtual", Mistake("force_one_way", 1), 6, "its drive extends it, and does not shorten it"),
        ("virtual", Mistake("force_saturates", 4), 7, "no further than 21"),
    ],
)
def test_a_drive_that_is_half_right_is_named_with_what_it_does(name, mistake, steps, says):
    rehearsal = Rehearsal(name, wired(mistake))
    outcome = rehearsal.run(STEPS[:steps])
    assert named(outcome) == {(mistake.name, (mistake.leg,))}
    assert says in outcome.findings[0].line


def test_two_brakes_on_one_output_are_named_with_both_legs_and_carry_no_force():
    rehearsal = Rehearsal("virtual", wired(Mistake("brake_of_another", 1, 4)))
    outcome = rehearsal.run(STEPS[:6])
    assert named(outcome) == {("brake_crossed", (1, 4))}
    assert "drive 1 opens the brakes of legs 1, 4 at once" in outcome.findings[0].text
    assert rehearsal.context.known("opens", 4)["legs"] == [4]
    assert rehearsal.watched.most_open == 2
    assert rehearsal.context.known("force", 1) is None
    assert rehearsal.context.known("force", 4) is not None


def test_a_leg_whose_brake_never_shuts_is_not_laid_to_the_outputs_of_the_others():
    rehearsal = Rehearsal("virtual", wired(Mistake("brake_stuck_open", 4)))
    assert named(rehearsal.run(STEPS[:5])) == {("brake_stuck_open", (4,))}


@cache
def begins(name):
    """Return when a good machine begins each step, s, and when it has ended the last one."""
    rehearsal = Rehearsal(name, Wiring())
    ticks: list[int] = []

    def consent(*_: str) -> bool:
        ticks.append(rehearsal.drives.tick)
        return True

    rehearsal.hands.consent = consent  # type: ignore[method-assign]
    rehearsal.run()
    ends = [*ticks, ticks[-1] + 20]
    return [tick / rehearsal.drives.line.rate_Hz for tick in ends]


def until(step, share, name):
    """Return when a good machine is at a share of a step, s."""
    number = [each.name for each in STEPS].index(step)
    first, last = begins(name)[number : number + 2]
    return first + share * (last - first)


@pytest.mark.long
@pytest.mark.parametrize("step", ["ids", "brakes", "gauge", "mounted"])
@pytest.mark.parametrize("name", ["virtual", "damiao", "odrive"])
@pytest.mark.parametrize(
    "fault",
    [
        lambda t: EncoderJump(kind="encoder_jump", leg=3, at_s=t, by_m=0.02),
        lambda t: EncoderFreeze(kind="encoder_freeze", leg=3, at_s=t),
        lambda t: DriveSilence(kind="drive_silence", leg=3, at_s=t),
    ],
    ids=["jump", "freeze", "silence"],
)
def test_a_fault_of_one_leg_in_mid_step_is_named_at_that_leg(step, name, fault):
    rehearsal = Rehearsal(name, Wiring(), faults=FaultPlan([fault(until(step, 0.3, name))]))
    outcome = rehearsal.run()
    assert any(3 in legs for _, legs in named(outcome)), outcome.findings
    assert rehearsal.watched.most_open <= 1


def test_a_cable_off_during_a_step_ends_it_with_the_legs_that_are_silent():
    rehearsal = Rehearsal("virtual", Wiring())
    exchange = rehearsal.drives.line.exchange

    def unplugged(opening):
        heard = exchange(opening)
        gone = any(request.act == "measure" and request.leg == 2 for request in rehearsal.hands.requests)
        return heard._replace(frames=()) if gone else heard

    rehearsal.drives.line.exchange = unplugged  # type: ignore[method-assign]
    outcome = rehearsal.run(STEPS)
    assert named(outcome) == {("not_heard", (0, 1, 2, 3, 4, 5))}
    assert outcome.stopped == "encoder"
    assert rehearsal.watched.most_open == 0


def test_no_reading_is_taken_of_a_drive_that_is_not_heard():
    rehearsal = Rehearsal("virtual", Wiring())
    rehearsal.drives.step()
    rehearsal.drives.record["age"][4] = 50
    with pytest.raises(StoppedError, match="not_heard: leg 4"):
        rehearsal.context.lengths()


def test_how_far_legs_have_gone_is_not_said_by_what_a_drive_read_before_it_fell_silent():
    facts = {"encoder": {str(leg): {"drive": 5 - leg, "scale": 2.0} for leg in range(6)}}
    rehearsal = Rehearsal("virtual", Wiring(), facts=facts)
    rehearsal.drives.step()
    context, before = rehearsal.context, rehearsal.context.lengths()
    rehearsal.drives.record["length"][4] += 0.5
    assert context.travelled(before) == {1: pytest.approx(0.25)} | dict.fromkeys((0, 2, 3, 4, 5), 0.0)
    rehearsal.drives.record["age"][4] = OLD_TICKS + 1
    with pytest.raises(StoppedError, match="lost_power: leg 4"):
        context.travelled(before)


def test_a_tape_that_is_read_in_millimetres_is_asked_again():
    rehearsal = Rehearsal("virtual", Wiring())
    answer = rehearsal.hands.answer
    typed: list[float] = []
    said: list[str] = []

    def in_millimetres():
        value = answer()
        if rehearsal.hands.requests[-1].act == "measure" and len(typed) < 1 and value is not None:
            typed.append(value)
            return 1e3 * value
        return value

    rehearsal.hands.answer = in_millimetres  # type: ignore[method-assign]
    rehearsal.hands.tell = said.append  # type: ignore[method-assign,assignment]
    outcome = rehearsal.run(BY_HAND)
    assert outcome.findings == ()
    assert sum(request.act == "measure" for request in rehearsal.hands.requests) == 19
    assert any("cannot be" in text and "not mm" in text for text in said)


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


@pytest.mark.long
def test_killed_after_any_fact_it_goes_on_from_there_and_ends_well():
    """SIGKILL leaves what was saved last: the facts of some moments, each read back as JSON."""
    rehearsal = Rehearsal("virtual", Wiring())
    moments: list[str] = []
    rehearsal.context.save = lambda: moments.append(json.dumps(rehearsal.context.facts))
    assert rehearsal.run().success
    asked = len(rehearsal.hands.requests)
    for moment in moments[1::6]:
        facts = json.loads(moment)
        refuse_malformed(facts)
        resumed = Rehearsal("virtual", Wiring(), facts=facts)
        resumed.bench.hung = "platform" in facts
        outcome = resumed.run()
        assert outcome.success, outcome.findings
        assert resumed.watched.most_open <= 1
        assert resumed.watched.opened_while_hung == 0
        assert len(resumed.hands.requests) <= asked
