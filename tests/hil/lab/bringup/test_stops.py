"""What ends a bring-up at once, and a driven leg: findings that no later step follows, and lost drives."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.signals import DriveFault, DriveMode, DriveState
from drivers.tick_columns import new_record
from hil.lab.bringup.context import OLD_TICKS, Context, Finding, RefusedError, Request, Step, StoppedError
from hil.lab.bringup.procedure import bring_up

UNSAFE = ("runaway", "not_powered", "lost_power", "not_heard", "encoder_jumps")


def step(name: str, begun: list[str], found: list[Finding], *, raises: bool = False) -> Step:
    """Return a step that is no gate, which finds this, or is ended by it."""

    def find(_: Context) -> None:
        begun.append(name)
        if raises:
            raise StoppedError(found[0])

    return Step(name, "", "", "", find, lambda _: found, gate=False)


class Drives:
    """Six drives that answer as a test has them, by drive and tick."""

    def __init__(self) -> None:
        self.record, self.protocol = new_record(), SimpleNamespace(fault_text=lambda _: "")
        self.record["drive_state"], self.record["age"] = int(DriveState.RUN), 0
        self.commanded: list[tuple[DriveMode, int | None, float]] = []
        self.silent: set[int] = set()

    def step(self, mode: DriveMode = DriveMode.OFF, leg: int | None = None, force: float = 0.0) -> Any:
        self.commanded.append((mode, leg, force))
        for drive in self.silent:
            self.record["age"][drive] += 1
        return self.record

    def off(self, _: float = 0.0) -> None:
        pass

    def prepare(self, _: int | None) -> None:
        pass


def context(answer: Any = lambda: 0.0) -> tuple[Context, Drives]:
    drives = Drives()
    operator = SimpleNamespace(
        consent=lambda *_: True, tell=lambda _: None, ask=lambda _: None, answer=answer, patience=1.0
    )
    machine = SimpleNamespace(brake_shut_s=0.1)
    return Context(cast("Any", machine), cast("Any", drives), cast("Any", operator)), drives


@pytest.mark.parametrize("raises", [True, False], ids=["in mid-step", "at its end"])
@pytest.mark.parametrize("name", UNSAFE)
def test_after_what_is_unsafe_no_further_step_begins(name: str, raises: bool) -> None:
    begun: list[str] = []
    harmless, unsafe = Finding("friction", (1,), "", ""), Finding(name, (3,), "", "")
    steps = (
        step("first", begun, [harmless]),
        step("second", begun, [unsafe] if raises else [harmless, unsafe], raises=raises),
        step("third", begun, []),
    )
    outcome = bring_up(context()[0], steps)
    assert begun == ["first", "second"]
    assert outcome.stopped == "second"
    assert unsafe in outcome.findings


@pytest.mark.parametrize("name", ["friction", "force_sign", "brake_stuck_shut"])
def test_after_what_can_wait_the_next_step_still_looks_for_its_cause(name: str) -> None:
    begun: list[str] = []
    steps = step("first", begun, [Finding(name, (3,), "", "")]), step("second", begun, [])
    outcome = bring_up(context()[0], steps)
    assert (begun, outcome.stopped, outcome.passed) == (["first", "second"], "", ("second",))


@pytest.mark.parametrize("drive", range(6))
@pytest.mark.parametrize("others", [False, True], ids=["alone", "with the others"])
def test_a_drive_that_falls_silent_while_a_hand_pushes_is_commanded_a_few_ticks_and_no_more(
    drive: int, others: bool
) -> None:
    """The operator takes twenty ticks; what the drive last said of its state still stands."""
    waits = iter(range(20))
    c, drives = context(lambda: None if next(waits, None) is not None else 0.0)
    drives.silent = set(range(6)) if others else {drive}
    with pytest.raises(StoppedError) as stopped:
        c.ask(Request("push", drive), partial(c.drive, drive))
    assert (stopped.value.finding.name, stopped.value.finding.legs) == ("lost_power", (drive,))
    assert drives.commanded == [(DriveMode.RUN, drive, 0.0)] * (OLD_TICKS + 1)


@pytest.mark.parametrize("drive", range(6))
def test_a_drive_that_has_left_run_is_not_commanded_again(drive: int) -> None:
    c, drives = context()
    c.drive(drive, 5.0)
    for state in (DriveState.OFF, DriveState.READY, DriveState.FAULT):
        drives.record["drive_state"][drive] = int(state)
        drives.record["drive_fault"][drive] = int(DriveFault.WATCHDOG)
        with pytest.raises(StoppedError, match=f"leg {drive}: the drive has gone from RUN to {state.name}"):
            c.drive(drive, 5.0)


@pytest.mark.parametrize("open_brake", [False, True], ids=["all shut", "one open"])
def test_readings_that_cannot_be_end_a_bring_up_after_so_many_whatever_is_commanded_meanwhile(
    open_brake: bool,
) -> None:
    c, _ = context(iter([7.0] * 3).__next__)
    cast("Any", c.operator).patience = 3.0
    asked = Request("measure", 2, 0.0, "Measure leg 2", within=(0.0, 1.0))
    with pytest.raises(
        RefusedError, match="Measure leg 2: 3 readings refused, the last one 7, allowed: 0 to 1"
    ):
        c.ask(asked, partial(c.drive, 2) if open_brake else None)
