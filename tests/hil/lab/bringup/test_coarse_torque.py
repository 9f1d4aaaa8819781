"""Legs of little friction behind a coarse field of torque, whose code of zero is half a step of force."""

from importlib import resources

import pytest

from drivers.signals import LEGS
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.lab.bringup.steps import force, gauge
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal, named

ROBOTS = {
    # +-18 N m and +-54 N m in 4095 steps, behind 20 mm: half a step is 0.22 N and 0.66 N at the leg
    "cubemars": ({"variant": "cubemars", "model": "AK80-9"}, 200.0),
    "damiao": ({"variant": "damiao", "model": "DM8009"}, 600.0),
}
"""Options of the drives and rated force, N; friction of a leg on the bench is a thousandth of that."""


def with_robot(name, wiring):
    """A rehearsal whose steps before `force` have found all legs as they should be."""
    options, rated_N = ROBOTS[name]
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    changes = {
        "drives": {"options": options, "force_limit_N": rated_N},
        "plant": {"model": {"coulomb_friction_N": 0.0}},
    }
    facts = {
        "held": {str(k): {"moved": False} for k in range(LEGS)},
        "opens": {str(k): {"legs": [k], "hand_N": 1e-3 * rated_N, "rate_share": 1.0} for k in range(LEGS)},
        "encoder": {str(k): {"drive": k, "scale": 1.0} for k in range(LEGS)},
    }
    return Rehearsal(loads(with_changes(text, changes), name), wiring, facts=facts)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_sign_of_force_is_not_taken_from_half_a_step_that_moves_the_leg(name):
    rehearsal = with_robot(name, wired(Mistake("force_sign", 2)))
    outcome = rehearsal.run((force.STEP,))
    assert named(outcome) == {("force_sign", (2,))}
    assert rehearsal.watched.most_travel_m < 1e-3


@pytest.mark.parametrize(("plus", "minus"), [(-1, -1), (1, 1), (-1, 0), (0, 1)])
def test_a_leg_that_moves_one_way_under_either_sign_is_no_reason_to_exchange_phases(plus, minus):
    rehearsal = with_robot("cubemars", Wiring())
    right = {"plus": {"force_N": 1.0, "leg": 0, "way": 1}, "minus": {"force_N": 1.0, "leg": 0, "way": -1}}
    one_way = {"plus": right["plus"] | {"way": plus}, "minus": right["minus"] | {"way": minus}}
    rehearsal.context.facts["force"] = {str(k): one_way if k == 4 else right for k in range(LEGS)}
    (finding,) = force.judge(rehearsal.context)
    assert (finding.name, finding.legs) == ("one_way", (4,))
    assert "0.44 N" in finding.text
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
def test_lead_and_encoder_are_told_apart_by_force_or_both_are_named(case):
    scale, gain, span_N, name = CAUSES[case]
    rehearsal = with_robot("cubemars", Wiring())
    context = rehearsal.context
    right = {"force_N": 0.1, "leg": 2, "way": 1}
    context.facts["force"] = {"2": {"plus": right, "minus": right | {"way": -1}}}
    context.facts["encoder"]["2"] = {"drive": 2, "scale": scale, "tape_m": [0.25, 0.4]}
    levels = [5.4 - span_N * share for share in (1.0, 0.6, 0.3, 0.0)]
    context.facts["gauge"] = {"2": {"pairs_N": [[force_N, gain * force_N] for force_N in levels]}}
    found = gauge.judge(context)
    assert [finding.name for finding in found] == [name] * (name is not None)
    assert name != "scale_or_lead" or "one turn" in found[0].mend


@pytest.mark.parametrize(("hand", "name"), [(0.76, "friction"), (0.74, "force_one_way")])
def test_a_leg_that_moves_one_way_alone_is_laid_to_its_friction_where_a_hand_needs_the_force_too(hand, name):
    """Friction of nearly the most force: truncated codes of torque reach it one way and not the other."""
    still, moved = {"force_N": None, "leg": None, "way": 0}, {"force_N": 5.3, "leg": 2, "way": -1}
    c = Rehearsal("cubemars", Wiring()).context
    c.facts["opens"] = {"2": {"legs": [2], "hand_N": hand * c.machine.force_N, "rate_share": None}}
    c.facts["force"] = {"2": {"plus": still, "minus": moved}}
    (finding,) = force.judge(c)
    assert (finding.name, finding.legs) == (name, (2,))
    assert "its drive shortens it, and does not extend it with 2 %" in finding.text
    assert ("; a hand needs 4.104 N" in finding.text) is (name == "friction")


@pytest.mark.parametrize(
    ("pairs", "most"),
    [
        ([[2.0, 1.9], [2.0, 2.0], [3.0, 3.0], [4.0, 4.0]], None),
        ([[2.0, 1.9], [2.0, 2.0], [3.0, 2.1], [4.0, 2.1]], 2.1),
        ([[2.0, 1.9], [2.0, 2.0], [3.0, 3.0], [3.0, 3.0]], None),
        ([[2.0, 2.0]] * 4, None),
        ([[1.6, 4.7], [2.4, 5.5], [3.2, 6.3], [4.0, 7.1]], None),  # a gauge that was not zeroed
        ([[1.6, 1.6], [2.4, 1.7], [3.2, 1.7], [4.0, 1.7]], 1.7),
    ],
)
def test_levels_that_are_one_command_tell_a_limit_or_nothing_and_never_fail(pairs, most):
    c = Rehearsal("virtual", Wiring()).context
    c.facts["gauge"] = {"0": {"pairs_N": pairs}}
    assert gauge._limited(c, 0) == most


@pytest.mark.parametrize("least", [0.1, 3.0])
def test_a_torque_that_is_one_command_at_all_levels_is_named_for_its_steps(least):
    c = Rehearsal("virtual", Wiring()).context
    way = {"force_N": least, "leg": 0, "way": 1}
    c.facts["force"] = {"0": {"plus": way, "minus": way | {"way": -1}}}
    c.facts["opens"] = {str(k): {"legs": [k], "hand_N": 1.0, "rate_share": 1.0} for k in range(LEGS)}
    c.facts["encoder"] = {}
    c.facts["gauge"] = {"0": {"pairs_N": [[2.0, 2.0]] * 4}}
    (finding,) = gauge.judge(c)
    assert (finding.name, finding.legs) == ("force_scale", (0,))
    assert "or to each other" in finding.text


def test_friction_that_a_drive_meets_is_that_of_the_leg_it_moves():
    c = Rehearsal("virtual", Wiring()).context
    still = {"force_N": None, "leg": None, "way": 0}
    c.facts["opens"] = {"1": {"legs": [4], "hand_N": c.machine.force_N, "rate_share": None}}
    c.facts["force"] = {"1": {"plus": still, "minus": still}}
    assert [(f.name, f.legs) for f in force.judge(c)] == [("friction", (4,))]
