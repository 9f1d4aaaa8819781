"""A drive's rate against what its reading changes by, as a hand pushes its leg."""

import pytest

from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.steps import brakes
from hil.lab.bringup.steps.brakes import RATE_WITHIN, Steps
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.lab.bringup.kit import Rehearsal, named

TICK_NS = 2_000_000


def pushed(motion, rate=lambda v: v):
    """Return the share that drive 2 has after ticks with these speeds, m/s, and the rates that it reports."""
    c = Rehearsal("virtual", Wiring()).context
    record, length = c.drives.record, 1.5
    steps = Steps(c, 2, lambda: None)
    for n, speed in enumerate(motion):
        length += 1e-9 * TICK_NS * speed
        record["t_ns"], record["age"][2] = n * TICK_NS, 0
        record["length"][2], record["rate"][2] = length, rate(speed)
        steps.keep()
    return steps.share()


@pytest.mark.parametrize("speed", [2e-3, 0.015, 0.1, -0.1, 0.8])
@pytest.mark.parametrize("factor", [1.0, -1.0, 2.0, 0.0])
def test_a_slow_push_tells_a_rate_as_a_fast_one_does(speed, factor):
    ticks = max(8, round(1.2e-3 / abs(speed) / (1e-9 * TICK_NS)))
    assert pushed([speed] * ticks, lambda v: factor * v) == pytest.approx(factor, abs=1e-9)


def test_a_leg_that_rests_for_long_before_and_after_says_nothing_then():
    """Half a code of the rate at rest, for ten seconds each, would be more than the way that was pushed."""
    rest = [0.0] * 5000
    share = pushed([*rest, *[0.03] * 40, *rest], lambda v: v - 2e-4)
    assert RATE_WITHIN[0] < share < RATE_WITHIN[1]


@pytest.mark.parametrize("motion", [[1e-4] * 5000, [0.01] * 20, []])
def test_a_push_that_is_too_slow_or_too_short_is_not_judged(motion):
    assert pushed(motion) is None


def test_a_rate_that_was_not_seen_is_a_gap_with_its_drive_and_what_to_do():
    c = Rehearsal("virtual", Wiring()).context
    c.facts["opens"] = {str(k): {"legs": [k], "hand_N": 1.0, "rate_share": 1.0} for k in range(6)}
    assert brakes.gap(c) is None
    for leg in (1, 4):
        c.facts["opens"][str(leg)]["rate_share"] = None
    gap = brakes.gap(c)
    assert gap is not None
    assert gap.text.startswith("drives 1, 4 moved too little, or too slowly")
    assert "by 0.6 mm or more at 1 mm/s or more" in gap.line


def test_a_usual_push_leaves_no_gap():
    rehearsal = Rehearsal("virtual", Wiring())
    outcome = rehearsal.run(STEPS[:5])
    assert named(outcome) == set()
    assert outcome.gaps == ()
