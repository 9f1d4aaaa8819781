"""Report of the drives after a fault: which are off, braked, or have confirmed a stop, and when."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from drivers.signals import DriveFault, DriveState, Fault, Mode, Reaction
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, Status
from hil.contracts.records import altered
from hil.loop.story.narrator import Narrator
from hil.loop.story.story import DONE
from hil.signals import Operator
from tests.hil.cycle_bench import Bench
from tests.hil.test_frames import OURS
from tests.hil.test_story import told

OFF, READY, RUN = (int(state) for state in (DriveState.OFF, DriveState.READY, DriveState.RUN))


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.until(Mode.APPROACH)
    return bench


def go_on(bench: Bench, narrator: Narrator, ticks: int, operator: tuple[Operator, ...] = (), **inputs: Any):
    for _ in range(ticks):
        bench.step(operator, **inputs)
        narrator.look(operator)
        operator = ()
    return told(narrator)


def confirm(bench: Bench, *deaf: int) -> None:
    """Let all drives except the deaf ones latch and report the emergency stop."""
    for leg in set(range(6)) - set(deaf):
        bench.drives.state[leg] = DriveState.FAULT
        holds = Configure(leg, 0.01, Reaction.BRAKE)
        bench.drives.statuses += reports(OURS, Status(leg, DriveState.FAULT, DriveFault.ESTOP, holds))


# -- on six drives


def test_drives_on_a_dead_bus_are_not_reported_as_switched_off(bench):
    narrator = Narrator(bench.cycle)
    story = go_on(bench, narrator, 40, frames=(), bus_off=True, sends_failed=2)
    assert "could not be sent to the drives" in story.done_text
    assert "10 ms" in story.done_text
    assert "`brake`" in story.done_text
    later = go_on(bench, narrator, 12)
    assert "all six in OFF" in later.done_text
    assert not any("--release" in advice for advice in later.next), "no release without a held platform"


def test_a_drive_that_does_not_confirm_is_listed_with_its_last_state(bench):
    narrator = Narrator(bench.cycle)
    bench.drives.silent = {2}
    story = go_on(bench, narrator, 40)
    assert "not confirmed by drive 2" in story.done_text
    assert "all six" not in story.done_text
    assert "--release" in next(iter(story.next))
    assert [(d.leg, d.state, d.age) for d in story.drives if d.age] == [(2, "RUN", 5)]
    assert story.at_end == "all legs that report are at rest"
    bench.drives.silent, bench.drives.rate = set(), -0.05
    assert "leg 3 at -0.050 m/s" in go_on(bench, narrator, 1).at_end
    bench.drives.silent = set(range(6))
    assert go_on(bench, narrator, 1).at_end.startswith("no leg reports")


@pytest.mark.parametrize("deaf", [(), (0, 4)])
def test_an_emergency_stop_is_reported_with_its_confirmations(bench, deaf):
    narrator = Narrator(bench.cycle)
    go_on(bench, narrator, 1, (Operator.ESTOP,))
    confirm(bench, *deaf)
    text = go_on(bench, narrator, 20).done_text
    assert ("sent; not confirmed by drive 0, 4" if deaf else "sent; all six drives confirmed it") in text


def test_reset_ends_the_fault_report_and_the_next_fault_starts_a_new_one(bench):
    narrator = Narrator(bench.cycle)
    go_on(bench, narrator, 1, (Operator.ESTOP,))
    bench.step((Operator.RESET,))
    narrator.look((Operator.RESET,))
    assert narrator.story() is None
    bench.until(Mode.IDLE)
    bench.step((Operator.ESTOP,))
    narrator.look((Operator.ESTOP,))
    assert [each.tick for each in told(narrator).findings] == [bench.tick]


# -- from mode to mode


class Watched:
    """A cycle with a fault that passes through modes, and its narrator."""

    def __init__(self, bench: Bench) -> None:
        self.cycle = bench.cycle
        self.tick = altered(bench.cycle.tick, sends_failed=0)
        self.number = bench.tick
        self.cycle.mode = Mode.APPROACH
        self.narrator = Narrator(self.cycle)
        self.cycle.faults = Fault.REFUSED_FRAMES

    def look(self, mode: Mode, drives: Any, *operator: Operator, silent: dict[int, int] | None = None) -> str:
        """Text of the completed steps after one tick in a mode; silent: age in ticks by silent leg."""
        self.number += 1
        self.cycle.mode = mode
        age = [(silent or {}).get(leg, 0) for leg in range(6)]
        self.cycle.tick = altered(self.tick, tick=self.number, drive_state=drives, age=age)
        self.narrator.look(operator)
        return told(self.narrator).done_text


@pytest.fixture(scope="module")
def moving() -> Bench:
    bench = Bench()
    bench.until(Mode.APPROACH)
    return bench


@pytest.fixture
def watched(moving: Bench) -> Iterator[Watched]:
    cycle = moving.cycle
    kept = cycle.tick, cycle.mode, cycle.faults, cycle.proven
    yield Watched(moving)
    cycle.tick, cycle.mode, cycle.faults, cycle.proven = kept


def but(leg: int, state: int, others: int) -> list[int]:
    """Six states with a different one for one leg."""
    return [state if each == leg else others for each in range(6)]


def test_fault_report_has_one_step_for_each_mode_entered_after_the_fault(watched):
    """For any reaction, each entered mode is one step, in its tick."""
    entered = [Mode.STOPPING, Mode.PARKING, Mode.UNLOADING, Mode.PARKED]
    for mode in entered:
        watched.cycle.proven = mode is Mode.PARKED
        watched.look(mode, READY)
        watched.look(mode, READY)
    watched.look(Mode.PARKED, OFF)
    done = told(watched.narrator).done
    assert [step.mode for step in done] == [mode.name for mode in entered]
    assert [step.tick - done[0].tick for step in done] == [0, 2, 4, 6]
    assert [step.text for step in done[:3]] == [DONE[mode] for mode in entered[:3]]
    assert "all six in OFF 2 ms later" in done[3].text
    assert done[3].text.endswith("the brakes passed their test")


def test_fault_report_requires_a_new_confirmation_for_a_second_switch_off(watched):
    """Parked, then held because a brake slips, then released."""
    watched.look(Mode.PARKED, READY)
    assert "all six in OFF 1 ms later" in watched.look(Mode.PARKED, OFF)
    watched.look(Mode.HELD, READY)
    watched.look(Mode.FAULT, READY, Operator.RELEASE)
    text = watched.look(Mode.FAULT, but(4, READY, OFF))
    assert "not confirmed by drive 4;" in text
    assert "all six" not in text
    assert "all six in OFF 2 ms later" in watched.look(Mode.FAULT, OFF)


@pytest.mark.parametrize("leg", [0, 5])
@pytest.mark.parametrize("state", [READY, OFF])
def test_feedback_older_than_the_command_does_not_confirm_the_brakes_of_a_held_platform(watched, leg, state):
    drives = but(leg, state, READY)
    watched.look(Mode.HELD, drives, silent={leg: 3})
    for age in (4, 5, 6, 4):  # the last one: in the tick in which it was held
        text = watched.look(Mode.HELD, drives, silent={leg: age})
        assert text.endswith(f"; not confirmed by drive {leg}")
    assert "not confirmed" not in watched.look(Mode.HELD, drives, silent={leg: 4})
    text = watched.look(Mode.HELD, but(leg, RUN, READY))
    assert text.endswith(f"; not confirmed by drive {leg}"), "a drive with open brake must be listed"


@pytest.mark.parametrize("leg", [0, 5])
def test_feedback_older_than_the_command_does_not_confirm_a_switch_off(watched, leg):
    watched.look(Mode.FAULT, OFF, silent={leg: 2})
    for age in (3, 4, 5, 4):  # the last one: in the tick in which it was told
        text = watched.look(Mode.FAULT, OFF, silent={leg: age})
        assert f"not confirmed by drive {leg};" in text
        assert "all six" not in text
    assert "all six in OFF 5 ms later" in watched.look(Mode.FAULT, OFF, silent={leg: 4})


@pytest.mark.parametrize("operator", [(), (Operator.STOP,), (Operator.RELEASE,)])
def test_a_platform_is_reported_as_released_only_on_request(watched, operator):
    watched.look(Mode.HELD, READY)
    assert any("--release" in advice for advice in told(watched.narrator).next)
    text = watched.look(Mode.FAULT, OFF, *operator)
    assert ("released on request" in text) == (operator == (Operator.RELEASE,))
    assert not any("--release" in advice for advice in told(watched.narrator).next), "already released"
