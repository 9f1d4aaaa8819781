"""What a step makes of its facts, for each leg: exchanged brake cables, an unread leg, forgotten turns."""

from dataclasses import replace
from itertools import permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.lab.bringup.context import TRAVEL_M, StoppedError
from hil.lab.bringup.steps import brakes, force, mounted
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.lab.bringup.kit import Rehearsal

LEGS = range(6)


@pytest.fixture(scope="module")
def machine():
    return Rehearsal("virtual", Wiring())


@pytest.fixture
def context(machine):
    """What is known once brakes and encoders of a good machine were found."""
    c = replace(machine.context, facts={})
    encoder = {"tape_m": [0.75, 2.2], "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0}
    opens = {"hand_N": 30.0, "rate_share": 1.0}
    c.facts["encoder"] = {str(k): {"drive": k, **encoder} for k in LEGS}
    c.facts["held"] = {str(k): {"moved": False, "hand_N": 700.0} for k in LEGS}
    c.facts["opens"] = {str(k): {"legs": [k], **opens} for k in LEGS}
    return c


def test_brakes_that_open_for_another_drive_are_named_with_all_their_drives(context):
    assert brakes.judge(context) == []
    for a, b in permutations(LEGS, 2):
        c = (a + 1) % 6 if (a + 1) % 6 != b else (a + 2) % 6
        for cycle in ((a, b), (a, b, c)):
            for drive in LEGS:
                context.facts["opens"][str(drive)]["legs"] = [drive]
            for drive, leg in zip(cycle, (*cycle[1:], cycle[0]), strict=True):
                context.facts["opens"][str(drive)]["legs"] = [leg]
            (finding,) = brakes.judge(context)
            assert (finding.name, finding.legs) == ("brake_crossed", tuple(sorted(cycle)))
            assert f"drive {a} opens the brake of leg {b}" in finding.text
            assert "Exchange the brakes' cables" in finding.mend


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_leg_that_goes_too_far_is_stopped_whichever_way_it_goes(leg, way):
    off = []
    gone = {k: way * TRAVEL_M * (1.01 if k == leg else -0.3) for k in LEGS}
    c: Any = SimpleNamespace(
        travelled=lambda _: gone,
        drives=SimpleNamespace(off=lambda: off.append(True)),
        reads=lambda: {k: [k] for k in LEGS},
    )
    with pytest.raises(StoppedError) as stopped:
        force.guard(c, leg, np.zeros(6), np.zeros(6))
    assert off
    assert (stopped.value.finding.name, stopped.value.finding.legs) == ("runaway", (leg,))
    gone[leg] *= 0.98
    assert force.guard(c, leg, np.zeros(6), np.zeros(6)) == (leg, gone[leg])


def found_with(context, counts, opens):
    """Judge drives that count and open other legs than theirs; return the findings by name."""
    encoder = context.facts["encoder"]
    by_leg = {leg: drive for drive, leg in counts.items()}
    context.facts["encoder"] = {str(k): encoder[str(k)] | {"drive": by_leg.get(k, k)} for k in LEGS}
    for drive, legs in opens.items():
        context.facts["opens"][str(drive)]["legs"] = legs
    return {finding.name: finding for finding in brakes.judge(context)}


def test_exchanged_numbers_beside_crossed_encoder_cables_change_their_own_legs_alone(context):
    """Nodes 2 and 5 are exchanged; the encoders of legs 0 and 2 are."""
    found = found_with(context, {1: 4, 4: 1, 0: 2, 2: 0}, {1: [4], 4: [1]})
    assert found.keys() == {"ids", "encoder_crossed"}
    assert found["ids"].legs == (1, 4)
    assert "node_ids: [1, 5, 3, 4, 2, 6]" in found["ids"].mend
    assert found["encoder_crossed"].legs == (0, 2)


@pytest.mark.parametrize(("stuck", "other"), [(0, 2), (2, 0), (3, 5)])
def test_a_stuck_brake_among_crossed_encoders_makes_no_number_of_it(context, stuck, other):
    found = found_with(context, {stuck: other, other: stuck}, {stuck: []})
    assert found.keys() == {"encoder_crossed", "brake_stuck_shut"}
    assert found["encoder_crossed"].legs == tuple(sorted((stuck, other)))
    assert f"drive {stuck} counts leg {other}, its brake" not in found["encoder_crossed"].text


@pytest.mark.parametrize("opens", [{1: [4], 4: []}, {1: [], 4: [1]}, {1: [], 4: []}])
def test_a_stuck_brake_among_exchanged_numbers_hides_none_of_them(context, opens):
    found = found_with(context, {1: 4, 4: 1}, opens)
    assert found.keys() == {"ids", "brake_stuck_shut"}
    assert "node_ids: [1, 5, 3, 4, 2, 6]" in found["ids"].mend


def test_no_order_of_numbers_is_named_that_has_one_twice(context):
    """Of three drives whose readings go round one has its own brake."""
    found = found_with(context, {0: 1, 1: 2, 2: 0}, {0: [1], 1: [1], 2: [0]})
    assert found["ids"].legs == (0, 2)
    assert "node_ids" not in found["ids"].mend
    assert found["encoder_crossed"].legs == (1,)


@pytest.fixture
def ramped(monkeypatch):
    """The drives whose force has grown."""
    drives: list[int] = []
    monkeypatch.setattr(force, "_ramp", lambda _c, drive, _sign: drives.append(drive) or {})  # type: ignore[func-returns-value]
    return drives


@pytest.mark.parametrize("lacks", [{"drive": None}, {"scale": 0.0}])
def test_no_force_acts_while_one_leg_has_no_encoder_that_counts_it(context, ramped, lacks):
    for blind in LEGS:
        known = dict(context.facts["encoder"])
        context.facts["encoder"] = known | {str(blind): known[str(blind)] | lacks}
        force.find(context)
        assert (ramped, context.facts.get("force")) == ([], None), f"leg {blind} is not seen"
        context.facts["encoder"] = known
    force.find(context)
    assert ramped == [drive for drive in LEGS for _ in range(2)]


FORGOTTEN_M = np.array([0.025, 0.02, 0.03, 0.025, 0.0125, 0.05])
"""Unlike legs."""


def hung(context, off_m):
    """Return the names and legs that are found where each leg reads so much more at both poses."""
    context.facts["load"] = {"mass_kg": 0.0, "presses": 1.0}
    q = context.machine.pose_lengths + off_m
    context.facts["mounted"] = {str(k): {"q_m": each.tolist()} for k, each in enumerate(q)}
    return [(finding.name, finding.legs) for finding in mounted.judge(context)]


def test_whole_turns_that_motors_forgot_name_no_leg_however_many_and_which_way(context):
    context.machine = replace(context.machine, forgotten_m=FORGOTTEN_M)
    for turns in ([1, -1, 2, -2, 3, 0], [-1, 1, -2, 2, -3, 5], [0] * 6):
        assert hung(context, np.array(turns) * FORGOTTEN_M) == []


def test_what_is_off_by_more_than_whole_turns_is_named_beside_them(context):
    context.machine = replace(context.machine, forgotten_m=FORGOTTEN_M)
    for leg in LEGS:
        for part in (-0.4, 0.4):
            turns = np.array([1.0, -1.0, 2.0, -2.0, 3.0, 1.0])
            turns[leg] += part
            assert hung(context, turns * FORGOTTEN_M) == [("slipped", (leg,))]


def test_drives_that_forget_nothing_are_named_one_turn_off(context):
    assert context.machine.forgotten_m is None
    for leg in LEGS:
        assert hung(context, 0.025 * np.eye(6)[leg]) == [("slipped", (leg,))]
