"""What is told of drives that were told to switch off: all six only once none is powered, each time anew."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.signals import DriveState, Fault, Mode
from hil.contracts.records import altered
from hil.loop.story.narrator import Narrator
from hil.signals import Operator
from tests.hil.cycle_bench import Bench
from tests.hil.test_story import told

OFF, READY, RUN = (int(state) for state in (DriveState.OFF, DriveState.READY, DriveState.RUN))


def silent(leg: int, ticks: int) -> list[int]:
    """Return the ages of six drives of which one was last heard so many ticks ago."""
    return [ticks if each == leg else 0 for each in range(6)]


@pytest.fixture(scope="module")
def moving() -> Bench:
    bench = Bench()
    bench.until(Mode.APPROACH)
    return bench


class Watched:
    """A cycle with a fault that goes from mode to mode as it is told, and who tells of it."""

    def __init__(self, bench: Bench) -> None:
        self.cycle = bench.cycle
        self.tick = altered(bench.cycle.tick, sends_failed=0)
        self.number = bench.tick
        self.cycle.mode = Mode.APPROACH
        self.narrator = Narrator(self.cycle)
        self.cycle.faults = Fault.REFUSED_FRAMES

    def look(self, mode: Mode, drives: Any, *operator: Operator, age: Any = 0) -> str:
        """One tick in a mode, each drive last heard `age` ticks ago; what is told of it."""
        self.number += 1
        self.cycle.mode = mode
        self.cycle.tick = altered(self.tick, tick=self.number, drive_state=drives, age=age)
        self.narrator.look(operator)
        return told(self.narrator).done_text


@pytest.fixture
def watched(moving):
    cycle = moving.cycle
    kept = cycle.tick, cycle.mode, cycle.faults
    yield Watched(moving)
    cycle.tick, cycle.mode, cycle.faults = kept


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("state", [READY, RUN])
def test_six_drives_are_off_once_none_is_powered(watched, leg, state):
    drives = [OFF] * 6
    drives[leg] = state
    watched.look(Mode.FAULT, RUN)
    for _ in range(3):
        text = watched.look(Mode.FAULT, drives)
        assert f"not confirmed by drive {leg};" in text
        assert "all six" not in text
    assert "all six in OFF 4 ms later" in watched.look(Mode.FAULT, OFF)


def test_drives_that_are_switched_off_a_second_time_confirm_it_anew(watched):
    """Parked, then held as a brake slips, then released."""
    watched.look(Mode.PARKED, READY)
    assert "all six in OFF 1 ms later" in watched.look(Mode.PARKED, OFF)
    watched.look(Mode.HELD, READY)
    drives = [OFF, OFF, OFF, OFF, READY, OFF]
    watched.look(Mode.FAULT, READY, Operator.RELEASE)
    text = watched.look(Mode.FAULT, drives)
    assert "not confirmed by drive 4;" in text
    assert "all six" not in text
    assert "all six in OFF 2 ms later" in watched.look(Mode.FAULT, OFF)


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("state", [READY, OFF])
def test_a_drive_that_was_last_heard_before_the_platform_was_held_has_not_confirmed_its_brake(
    watched, leg, state
):
    drives = [READY] * 6
    drives[leg] = state
    watched.look(Mode.HELD, drives, age=silent(leg, 3))
    for age in range(4, 9):
        text = watched.look(Mode.HELD, drives, age=silent(leg, age))
        assert text.endswith(f"; not confirmed by drive {leg}"), "since before it was held"
    text = watched.look(Mode.HELD, drives, age=silent(leg, 6))
    assert text.endswith(f"; not confirmed by drive {leg}"), "in the tick in which it was held"
    assert "not confirmed" not in watched.look(Mode.HELD, drives, age=silent(leg, 6))
    drives[leg] = RUN
    assert watched.look(Mode.HELD, drives).endswith(f"; not confirmed by drive {leg}"), "its brake is open"


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_that_was_last_heard_before_it_was_told_to_switch_off_has_confirmed_nothing(watched, leg):
    watched.look(Mode.FAULT, OFF, age=silent(leg, 2))
    for age in range(3, 9):
        text = watched.look(Mode.FAULT, OFF, age=silent(leg, age))
        assert f"not confirmed by drive {leg};" in text
        assert "all six" not in text
    assert "all six in OFF 7 ms later" in watched.look(Mode.FAULT, OFF, age=silent(leg, 6))


def test_what_the_drives_said_is_of_the_first_fault_and_what_they_say_in_the_end_of_the_last_tick(watched):
    watched.look(Mode.STOPPING, RUN)
    watched.cycle.faults |= Fault.BUS
    watched.look(Mode.FAULT, READY)
    watched.look(Mode.FAULT, OFF)
    story = told(watched.narrator)
    assert [each.fault for each in story.findings] == ["REFUSED_FRAMES", "BUS"]
    assert [each.state for each in story.drives] == ["RUN"] * 6
    assert [each.state for each in story.drives_at_end] == ["OFF"] * 6


@pytest.mark.parametrize("leg", range(6))
def test_what_a_drive_said_in_the_tick_in_which_it_was_told_is_no_answer_to_that(watched, leg):
    watched.look(Mode.FAULT, OFF)
    assert f"not confirmed by drive {leg};" in watched.look(Mode.FAULT, OFF, age=silent(leg, 1))
    assert "all six in OFF 2 ms later" in watched.look(Mode.FAULT, OFF, age=silent(leg, 1))


@pytest.mark.parametrize("operator", [(), (Operator.STOP,), (Operator.RELEASE,)])
def test_a_platform_that_is_held_no_more_was_released_only_where_somebody_asked_for_it(watched, operator):
    watched.look(Mode.HELD, READY)
    said = watched.look(Mode.FAULT, OFF, *operator)
    assert ("released on request" in said) == (operator == (Operator.RELEASE,))


def test_drives_that_fault_while_they_switch_off_have_been_told_so_since_the_first_time(watched):
    watched.look(Mode.PARKED, READY)
    watched.look(Mode.PARKED, READY)
    watched.look(Mode.FAULT, READY)
    assert "all six in OFF 3 ms later" in watched.look(Mode.FAULT, OFF)
