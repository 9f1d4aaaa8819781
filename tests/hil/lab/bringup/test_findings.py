"""Findings derived from the facts of a step, for each leg."""

from dataclasses import replace
from importlib import resources
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.lab.bringup.steps import brakes, force, gauge, mounted
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.rehearsals import Rehearsal, named

LEGS = range(6)
ANSWERS = [1.0] * 6


@pytest.fixture(scope="module")
def machine():
    return Rehearsal("virtual")


@pytest.fixture
def context(machine):
    """Context with the facts of a good machine about brakes and encoders."""
    c = replace(machine.context, facts={})
    encoder = {"tape_m": [0.75, 2.2], "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0}
    opens = {"hand_N": 30.0, "rate_share": 1.0}
    c.facts["encoder"] = {str(k): {"drive": k, **encoder} for k in LEGS}
    c.facts["held"] = {str(k): {"moved": False, "hand_N": 700.0} for k in LEGS}
    c.facts["opens"] = {str(k): {"legs": [k], **opens} for k in LEGS}
    return c


def test_interchanged_brakes_are_reported_as_one_finding_with_all_their_drives(context):
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


def found_with(context, counts, opens):
    """Findings by name, for drives that count and open other legs than their own."""
    encoder = context.facts["encoder"]
    by_leg = {leg: drive for drive, leg in counts.items()}
    context.facts["encoder"] = {str(k): encoder[str(k)] | {"drive": by_leg.get(k, k)} for k in LEGS}
    for drive, legs in opens.items():
        context.facts["opens"][str(drive)]["legs"] = legs
    return {finding.name: finding for finding in brakes.judge(context)}


EXCHANGED = "node_ids: [1, 5, 3, 4, 2, 6]"
BEHIND = {
    "stuck brake, crossed encoders": (
        {0: 2, 2: 0},
        {0: []},
        {"encoder_crossed": (0, 2), "brake_stuck_shut": (0,)},
    ),
    "other one is stuck": ({2: 0, 0: 2}, {2: []}, {"encoder_crossed": (0, 2), "brake_stuck_shut": (2,)}),
    "exchanged, 4 is stuck": ({1: 4, 4: 1}, {1: [4], 4: []}, {"ids": (1, 4), "brake_stuck_shut": (4,)}),
    "exchanged, 1 is stuck": ({1: 4, 4: 1}, {1: [], 4: [1]}, {"ids": (1, 4), "brake_stuck_shut": (1,)}),
    "exchanged, beside crossed encoders": (
        {1: 4, 4: 1, 0: 2, 2: 0},
        {1: [4], 4: [1]},
        {"ids": (1, 4), "encoder_crossed": (0, 2)},
    ),
    "three go round, one has its own brake": (
        {0: 1, 1: 2, 2: 0},
        {0: [1], 1: [1], 2: [0]},
        {"ids": (0, 2), "encoder_crossed": (1,)},
    ),
}
"""Leg that each drive counts, legs that its brake output opens, and the findings."""


@pytest.mark.parametrize("case", BEHIND)
def test_exchanged_node_numbers_crossed_encoders_and_stuck_brakes_are_distinguished(context, case):
    counts, opens, expected = BEHIND[case]
    found = found_with(context, counts, opens)
    found.pop("brake_crossed", None)
    assert {name: finding.legs for name, finding in found.items()} == expected
    if "ids" in found:
        assert (EXCHANGED in found["ids"].remedy) == (found["ids"].legs == (1, 4))


STILL = {"force_N": None, "leg": None, "way": 0}


@pytest.fixture
def ramped(monkeypatch):
    """List of drives that ramped their force."""
    drives: list[int] = []
    monkeypatch.setattr(force, "_ramp", lambda _c, drive, _sign: drives.append(drive) or dict(STILL))  # type: ignore[func-returns-value]
    return drives


@pytest.mark.parametrize("lacks", [{"drive": None}, {"scale": 0.0}])
def test_no_force_is_applied_while_a_leg_has_no_working_encoder(context, ramped, lacks):
    for blind in LEGS:
        known = dict(context.facts["encoder"])
        context.facts["encoder"] = known | {str(blind): known[str(blind)] | lacks}
        force.find(context)
        assert (ramped, context.facts.get("force")) == ([], None), f"leg {blind} has no working encoder"
        context.facts["encoder"] = known
    force.find(context)
    assert ramped == [drive for drive in LEGS for _ in range(2)]


FORGOTTEN_M = np.array([0.025, 0.02, 0.03, 0.025, 0.0125, 0.05])
"""Different for each leg."""


def at_poses(context, q):
    """Facts about legs that read q (poses, 6) m at the known poses and have the right lengths by tape."""
    tables = {"mounted": q, "taped": context.machine.pose_lengths}
    return {
        name: {str(k): {"q_m": each.tolist(), "answers": ANSWERS} for k, each in enumerate(lengths)}
        for name, lengths in tables.items()
    }


def hung(context, off_m):
    """Names and legs of the findings if each leg reads `off_m` too much at both poses."""
    context.facts["load"] = {"mass_kg": 0.0, "presses": 1.0}
    q = context.machine.pose_lengths + off_m
    context.facts |= at_poses(context, q)
    return [(finding.name, finding.legs) for finding in mounted.judge(context)]


def test_length_offset_of_whole_turns_is_no_finding_if_the_drives_forget_turns(context):
    context.machine = replace(context.machine, forgotten_m=FORGOTTEN_M)
    for turns in ([1, -1, 2, -2, 3, 0], [-1, 1, -2, 2, -3, 5], [0] * 6):
        assert hung(context, np.array(turns) * FORGOTTEN_M) == []
        for leg in LEGS:
            for part in (-0.4, 0.4):
                assert hung(context, (turns + part * np.eye(6)[leg]) * FORGOTTEN_M) == [("slipped", (leg,))]


@pytest.mark.parametrize(
    ("presses", "seen", "named"),
    [
        (0.9, 1, False),
        (0.9, -1, True),
        (0.9, 0, True),
        (-0.9, -1, False),
        (-0.9, 1, True),
        (0.2, 0, False),
        (-0.2, 0, False),
        (0.2, 1, True),
    ],
)
def test_gravity_that_differs_from_the_configuration_is_a_finding(presses, seen, named):
    c = Rehearsal("virtual").context
    c.machine = replace(c.machine, presses=presses)
    c.facts["load"] = {"mass_kg": 0.0, "presses": float(seen)}
    c.facts |= at_poses(c, c.machine.pose_lengths)
    assert [f.name for f in mounted.judge(c)] == ["gravity"] * named


ROBOTS = {
    # +-18 N m and +-54 N m in 4095 steps, behind 20 mm: half a step is 0.22 N and 0.66 N at the leg
    "cubemars": ({"variant": "cubemars", "model": "AK80-9"}, 200.0),
    "damiao": ({"variant": "damiao", "model": "DM8009"}, 600.0),
}
"""Options of the drives and rated force, N; friction of a leg on the bench is a thousandth of it."""


def with_robot(name, wiring):
    """A rehearsal with good facts from all steps before `force`."""
    options, rated_N = ROBOTS[name]
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    changes = {
        "drives": {"options": options, "force_limit_N": rated_N},
        "plant": {"model": {"coulomb_friction_N": 0.0}},
    }
    facts = {
        "held": {str(k): {"moved": False} for k in LEGS},
        "opens": {str(k): {"legs": [k], "hand_N": 1e-3 * rated_N, "rate_share": 1.0} for k in LEGS},
        "encoder": {str(k): {"drive": k, "scale": 1.0} for k in LEGS},
    }
    return Rehearsal(loads(with_changes(text, changes), name), wiring, facts=facts)


@pytest.mark.parametrize("name", ROBOTS)
def test_inverted_force_sign_is_found_although_half_a_torque_step_moves_the_leg(name):
    rehearsal = with_robot(name, wired(Mistake("force_sign", 2)))
    outcome = rehearsal.run((force.STEP,))
    assert named(outcome) == {("force_sign", (2,))}
    assert rehearsal.watched.most_travel_m < 1e-3


@pytest.mark.parametrize(("plus", "minus"), [(-1, -1), (1, 1), (-1, 0), (0, 1)])
def test_leg_that_moves_in_one_direction_only_is_not_reported_as_exchanged_motor_phases(plus, minus):
    rehearsal = with_robot("cubemars", Wiring())
    right: dict[str, Any] = {
        "plus": {"force_N": 1.0, "leg": 0, "way": 1},
        "minus": {"force_N": 1.0, "leg": 0, "way": -1},
    }
    right["late_s"] = 0.0
    one_way = {"plus": right["plus"] | {"way": plus}, "minus": right["minus"] | {"way": minus}}
    rehearsal.context.facts["force"] = {str(k): one_way if k == 4 else right for k in LEGS}
    (finding,) = force.judge(rehearsal.context)
    assert (finding.name, finding.legs) == ("one_way", (4,))
    assert "phases" not in finding.line


CAUSES = {
    # scale by tape, N by gauge a N, spread of the levels in N: behind steps of 0.45 N an error of 0.1 or 0.35
    "a lead": (1.25, 1.24, 4.5, "wrong_lead"),
    "a lead behind losses": (1.25, 1.2, 4.5, "wrong_lead"),
    "an encoder": (1.25, 1.0, 4.5, None),
    "an encoder behind losses": (1.25, 0.92, 4.5, None),
    "a lead that steps hide": (1.25, 1.24, 1.3, "scale_or_lead"),
    "an encoder that steps hide": (1.25, 1.0, 1.3, "scale_or_lead"),
    "an encoder by a hundredth": (1.01, 1.0, 1.3, None),
    "a force": (1.0, 1.5, 4.5, "force_scale"),
    "a force within losses": (1.0, 1.2, 4.5, None),
    "both, each by itself": (1.25, 0.6, 4.5, "force_scale"),
}


@pytest.mark.parametrize("case", CAUSES)
def test_force_gauge_distinguishes_a_wrong_screw_lead_from_a_wrong_encoder_scale(case):
    scale, gain, span_N, name = CAUSES[case]
    rehearsal = with_robot("cubemars", Wiring())
    context = rehearsal.context
    right = {"force_N": 0.1, "leg": 2, "way": 1}
    context.facts["force"] = {"2": {"plus": right, "minus": right | {"way": -1}}}
    context.facts["encoder"]["2"] = {"drive": 2, "scale": scale, "tape_m": [0.25, 0.4]}
    levels = [5.4 - span_N * share for share in (1.0, 0.6, 0.3, 0.0)]
    context.facts["gauge"] = {"2": {"pairs_N": [[force_N, gain * force_N] for force_N in levels]}}
    found = list(gauge.judge(context))
    assert [finding.name for finding in found] == [name] * (name is not None)


SAME_LEVELS = {
    "good": ([[2.0, 1.9], [2.0, 2.0], [3.0, 3.0], [4.0, 4.0]], []),
    "a limit": ([[2.0, 1.9], [2.0, 2.0], [3.0, 2.1], [4.0, 2.1]], ["force_saturates"]),
    "a gauge that was not zeroed": ([[1.6, 4.7], [2.4, 5.5], [3.2, 6.3], [4.0, 7.1]], []),
    "one command at all levels": ([[2.0, 2.0]] * 4, ["force_scale"]),
}


@pytest.mark.parametrize("case", SAME_LEVELS)
def test_force_saturation_and_scale_are_reported_only_with_different_commanded_forces(case):
    pairs, expected = SAME_LEVELS[case]
    c = Rehearsal("virtual").context
    way = {"force_N": 0.1, "leg": 0, "way": 1}
    c.facts["force"] = {"0": {"plus": way, "minus": way | {"way": -1}}}
    c.facts["opens"] = {str(k): {"legs": [k], "hand_N": 1.0, "rate_share": 1.0} for k in LEGS}
    c.facts["encoder"] = {}
    c.facts["gauge"] = {"0": {"pairs_N": pairs}}
    assert [finding.name for finding in gauge.judge(c)] == expected


def test_excessive_friction_is_reported_for_the_leg_that_the_drive_moves():
    c = Rehearsal("virtual").context
    c.facts["opens"] = {"1": {"legs": [4], "hand_N": c.machine.force_N, "rate_share": None}}
    c.facts["force"] = {"1": {"plus": STILL, "minus": STILL}}
    assert [(f.name, f.legs) for f in force.judge(c)] == [("friction", (4,))]
