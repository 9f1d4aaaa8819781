"""What the platform weighs, which way it pulls, and where it hangs is known before a leg carries it."""

import pytest

from hil.bringup.procedure import STEPS
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.bringup.kit import Rehearsal, named

MOUNTED = STEPS[-1:]


@pytest.mark.parametrize(
    ("mistake", "name", "legs", "says"),
    [
        (Mistake("payload", 0), "payload", (), "configured are 1150 kg"),
        (Mistake("payload", 0, value=0.8), "payload", (), "configured are 1150 kg"),
        (Mistake("upside_down", 0), "gravity", (), "pulls at the legs; by the configuration it would press"),
        (
            Mistake("wrong_home", 0),
            "wrong_home",
            (0, 1, 2, 3, 4, 5),
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


@pytest.mark.parametrize("typed", [0.0, 1190.0])
def test_a_platform_that_cannot_be_weighed_is_a_gap_and_one_of_some_percent_more_is_not(typed):
    rehearsal = Rehearsal("virtual", Wiring())
    rehearsal.bench.weigh = lambda: typed  # type: ignore[method-assign]
    outcome = rehearsal.run(MOUNTED)
    assert outcome.findings == ()
    assert [gap.instead for _, gap in outcome.gaps] == (
        [] if typed else ["See that it weighs 1150 kg with all that is fixed to it"]
    )
    assert outcome.passed == (("mounted",) if typed else ())
