"""What the platform weighs, which way it pulls, and where it hangs is known before a leg carries it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.steps import mounted
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal, named

MOUNTED = STEPS[-1:]


@pytest.mark.parametrize(
    ("mistake", "name", "legs", "says"),
    [
        (Mistake("payload", 0), "payload", (), "configured are 1150 kg"),
        (Mistake("payload", 0, value=0.8), "payload", (), "configured are 1150 kg"),
        (Mistake("upside_down", 0), "gravity", (), "pulls at the legs; by the configuration it presses"),
        (
            Mistake("wrong_home", 0),
            "wrong_home",
            (),
            "the platform hangs elsewhere (pose 0: +9.5",
        ),
        (Mistake("joint_elsewhere", 3), "slipped", (3,), "its joint is elsewhere"),
    ],
)
def test_a_platform_that_is_not_the_configured_one_is_named_while_it_hangs(mistake, name, legs, says):
    rehearsal = Rehearsal("virtual", wired(mistake))
    outcome = rehearsal.run(MOUNTED)
    assert named(outcome) == {(name, legs)}
    assert says in outcome.findings[0].line
    assert rehearsal.watched.opened_while_hung == 0


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
    assert [gap.instead for _, gap in outcome.gaps] == (
        [] if typed else ["See that it weighs 1150 kg with all that is fixed to it"]
    )
    assert outcome.passed == (("mounted",) if typed else ())


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
def test_gravity_is_named_wherever_it_is_not_where_the_configuration_has_it(presses, seen, named):
    c = Rehearsal("virtual", Wiring()).context
    c.machine = replace(c.machine, presses=presses)
    c.facts["load"] = {"mass_kg": 0.0, "presses": float(seen)}
    c.facts["mounted"] = {str(k): {"q_m": q.tolist()} for k, q in enumerate(c.machine.pose_lengths)}
    assert [f.name for f in mounted.judge(c)] == ["gravity"] * named


def test_which_way_a_weight_acts_is_asked_wherever_gravity_points():
    rehearsal = Rehearsal("virtual", Wiring())
    c = rehearsal.context
    c.machine = replace(c.machine, presses=0.0)
    assert named(rehearsal.run(MOUNTED)) == {("gravity", ())}
    assert [r.act for r in rehearsal.hands.requests].count("read_way") == 1


def test_two_good_legs_under_a_platform_that_hangs_tilted_are_not_blamed_alone():
    c = Rehearsal("virtual", Wiring()).context
    c.facts["load"] = {"mass_kg": 0.0, "presses": 1.0}
    q = c.machine.pose_lengths + 6e-3 * np.array([0, 0, 0, 1, -1, 0])
    c.facts["mounted"] = {str(k): {"q_m": each.tolist()} for k, each in enumerate(q)}
    findings = mounted.judge(c)
    assert [(f.name, f.legs) for f in findings] == [("slipped", (3,)), ("slipped", (4,))]
    assert all("See that the platform hangs at the known poses, not tilted" in f.mend for f in findings)


def test_a_mass_in_grams_is_asked_for_again():
    rehearsal, typed = Rehearsal("virtual", Wiring()), iter((1.15e6, 1150.0))
    rehearsal.hands.patience = 2
    weighs(rehearsal, lambda: next(typed))
    assert rehearsal.run(MOUNTED).findings == ()
    assert [r.act for r in rehearsal.hands.requests].count("weigh") == 2
