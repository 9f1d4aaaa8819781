"""What is told of emergency stops: each in the tick in which it was first sent, in the order of what was done."""

from __future__ import annotations

import pytest

from drivers.signals import DriveFault, DriveState, Mode, Reaction
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, Status
from hil.loop.story.narrator import Narrator
from hil.loop.story.told import Step, Story
from hil.signals import Operator
from tests.hil.cycle_bench import Bench
from tests.hil.test_frames import OURS
from tests.hil.test_story import go_on


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.until(Mode.APPROACH)
    return bench


def confirm(bench: Bench) -> None:
    """Let all drives latch the emergency stop and say so."""
    for leg in range(6):
        bench.drives.state[leg] = DriveState.FAULT
        holds = Configure(leg, 0.01, Reaction.BRAKE)
        bench.drives.statuses += reports(OURS, Status(leg, DriveState.FAULT, DriveFault.ESTOP, holds))


def stops(story: Story) -> list[Step]:
    return [step for step in story.done if step.mode == "ESTOP"]


@pytest.mark.parametrize("later", [0, 30])
def test_an_emergency_stop_after_another_fault_has_its_own_tick(bench, later):
    narrator = Narrator(bench.cycle)
    bench.drives.silent = {2}
    struck = go_on(bench, narrator, 5).findings[0].tick
    if later:
        go_on(bench, narrator, later)
    asked = bench.tick + 1
    assert asked == struck + later + 1
    story = go_on(bench, narrator, 20, (Operator.ESTOP,))
    (step,) = stops(story)
    assert step.tick == asked
    assert step.time_s == pytest.approx(1e-3 * asked)
    assert "sent in 20 ticks" in step.text
    assert story.done[0].tick == struck


def test_an_emergency_stop_that_drives_forget_is_sent_again_and_told_again(bench):
    narrator = Narrator(bench.cycle)
    first = bench.tick + 1
    go_on(bench, narrator, 3, (Operator.ESTOP,))
    confirm(bench)
    go_on(bench, narrator, 10)
    bench.drives.state[4] = DriveState.OFF
    again = bench.tick + 1
    story = go_on(bench, narrator, 5)
    assert [(step.tick, step.text) for step in stops(story)] == [
        (first, "the emergency stop was sent in 3 ticks, until all six drives confirmed it"),
        (again, "the emergency stop was sent in 5 ticks; not confirmed by drive 4"),
    ]


def test_what_was_done_is_told_in_the_order_of_its_ticks(bench):
    """The bus dies while the emergency stop is sent."""
    narrator = Narrator(bench.cycle)
    go_on(bench, narrator, 10, (Operator.ESTOP,))
    story = go_on(bench, narrator, 40, bus_off=True, sends_failed=2)
    ticks = [step.tick for step in story.done]
    assert len(stops(story)) == 1
    assert ticks == sorted(ticks)
