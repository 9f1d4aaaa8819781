"""Immediate ends of a bring-up: unsafe findings, lost drives, runaway legs, faults during a step."""

from __future__ import annotations

from functools import cache, partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.signals import DriveMode, DriveState
from drivers.tick_columns import new_record
from hil.lab.bringup.context import (
    OLD_TICKS,
    TRAVEL_M,
    Context,
    Finding,
    RefusedError,
    Request,
    Step,
    StoppedError,
)
from hil.lab.bringup.procedure import STEPS, bring_up
from hil.lab.bringup.steps import force
from plant_fmu.faults.kinds import DriveSilence, EncoderFreeze, EncoderJump
from plant_fmu.faults.plan import FaultPlan
from tests.hil.lab.bringup.rehearsals import Rehearsal, named

UNSAFE = (
    "runaway",
    "coupling_or_clamp",
    "brake_not_shut",
    "not_powered",
    "lost_power",
    "not_heard",
    "encoder_jumps",
)


def step(name: str, begun: list[str], found: list[Finding], *, raises: bool = False) -> Step:
    """A step that is not a gate and returns these findings, or raises the first one."""

    def find(_: Context) -> None:
        begun.append(name)
        if raises:
            raise StoppedError(found[0])

    return Step(name, "", "", "", find, lambda _: found, gate=False)


class Drives:
    """Six drives with states and ages set by the test."""

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
def test_bring_up_begins_no_step_after_an_unsafe_finding(name: str, raises: bool) -> None:
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
def test_bring_up_runs_the_next_step_after_a_harmless_finding(name: str) -> None:
    begun: list[str] = []
    steps = step("first", begun, [Finding(name, (3,), "", "")]), step("second", begun, [])
    outcome = bring_up(context()[0], steps)
    assert (begun, outcome.stopped, outcome.passed) == (["first", "second"], "", ("second",))


@pytest.mark.parametrize("drive", range(6))
@pytest.mark.parametrize("others", [False, True], ids=["alone", "with the others"])
def test_silent_drive_is_commanded_for_a_few_ticks_while_the_operator_acts(drive: int, others: bool) -> None:
    """The operator takes twenty ticks; the last reported state of the drive is still RUN."""
    waits = iter(range(20))
    c, drives = context(lambda: None if next(waits, None) is not None else 0.0)
    drives.silent = set(range(6)) if others else {drive}
    with pytest.raises(StoppedError) as stopped:
        c.ask(Request("push", drive), partial(c.drive, drive))
    assert (stopped.value.finding.name, stopped.value.finding.legs) == ("not_heard", (drive,))
    assert drives.commanded == [(DriveMode.RUN, drive, 0.0)] * (OLD_TICKS + 1)


@pytest.mark.parametrize("open_brake", [False, True], ids=["all shut", "one open"])
def test_bring_up_ends_after_three_impossible_readings_of_the_operator(
    open_brake: bool,
) -> None:
    c, _ = context(iter([7.0] * 3).__next__)
    cast("Any", c.operator).patience = 3.0
    asked = Request("measure", 2, 0.0, "Measure leg 2", within=(0.0, 1.0))
    with pytest.raises(RefusedError, match="3 readings refused"):
        c.ask(asked, partial(c.drive, 2) if open_brake else None)


@pytest.mark.parametrize("state", [s for s in DriveState if s is not DriveState.RUN])
def test_step_stops_if_a_drive_leaves_run_by_itself(state):
    for leg in range(6):
        c, drives = context()
        drives.record["drive_state"][leg] = state
        with pytest.raises(StoppedError, match=f"gone from RUN to {state.name}") as stop:
            c.drive(leg, 10.0)
        assert (stop.value.finding.name, stop.value.finding.legs) == ("lost_power", (leg,))


def test_enabled_drive_continues_although_the_locked_out_drives_report_a_fault():
    for leg in range(6):
        c, drives = context()
        drives.record["drive_state"][np.arange(6) != leg] = DriveState.FAULT
        c.drive(leg, 10.0)


def test_leg_that_slips_off_the_gauge_is_switched_off():
    rehearsal = Rehearsal("lab")
    hands, bench = rehearsal.hands, rehearsal.bench
    ask, answer, late = hands.ask, hands.answer, []

    def slips(request):
        ask(request)
        if (
            request.act == "read_gauge"
            and rehearsal.drives.record["tau"][2] > 0.9 * rehearsal.machine.force_N
        ):
            bench.do("free")
            late.append(bench.length(2))

    hands.ask = slips  # type: ignore[method-assign]
    waits = iter(range(2000))
    hands.answer = lambda: None if late and next(waits, None) is not None else answer()  # type: ignore[method-assign]
    outcome = rehearsal.run()
    assert ("coupling_or_clamp", (2,)) in named(outcome)
    assert abs(bench.length(2) - late[0]) < 0.02


def test_runaway_leg_is_stopped_and_reported():
    rehearsal = Rehearsal("virtual", "force_scale leg=3 value=60.0")
    outcome = rehearsal.run(STEPS[:6])
    assert named(outcome) == {("runaway", (3,))}
    assert rehearsal.watched.most_open == 1


@cache
def begins(name):
    """Start times, s, of each step of a good machine, and the end of the last one."""
    rehearsal = Rehearsal(name)
    ticks: list[int] = []
    rehearsal.hands.consent = lambda *_: not ticks.append(rehearsal.drives.tick)  # type: ignore[method-assign, func-returns-value]
    rehearsal.run()
    return [tick / rehearsal.drives.line.rate_Hz for tick in (*ticks, ticks[-1] + 20)]


FAULTS: dict[str, tuple[Any, dict[str, float]]] = {
    "encoder_jump": (EncoderJump, {"by_m": 0.02}),
    "encoder_freeze": (EncoderFreeze, {}),
    "drive_silence": (DriveSilence, {}),
}
STEPS_OF_FAULTS = ("ids", "brakes", "gauge", "mounted")
SYSTEMS = ("virtual", "damiao", "odrive")
PLACES = [
    (fault, step, SYSTEMS[(i + j) % 3])
    for i, fault in enumerate(FAULTS)
    for j, step in enumerate(STEPS_OF_FAULTS)
]
"""Each fault in each step, with alternating drive families."""


@pytest.mark.long
@pytest.mark.parametrize(("fault", "step", "name"), PLACES)
def test_fault_during_a_step_is_reported_for_its_leg(fault, step, name):
    kind, more = FAULTS[fault]
    number = [each.name for each in STEPS].index(step)
    first, last = begins(name)[number : number + 2]
    plan = FaultPlan([kind(kind=fault, leg=3, at_s=first + 0.3 * (last - first), **more)])
    rehearsal = Rehearsal(name, faults=plan)
    outcome = rehearsal.run()
    assert any(3 in legs for _, legs in named(outcome)), outcome.findings
    assert rehearsal.watched.most_open <= 1


def test_unplugged_bus_ends_a_step_and_lists_the_silent_legs():
    rehearsal = Rehearsal("virtual")

    def unplugged(heard, _):
        gone = any(request.act == "measure" and request.leg == 2 for request in rehearsal.hands.requests)
        return heard._replace(frames=()) if gone else heard

    rehearsal.hears(unplugged)
    outcome = rehearsal.run(STEPS)
    assert named(outcome) == {("not_heard", (0, 1, 2, 3, 4, 5))}
    assert outcome.stopped == "encoder"
    assert rehearsal.watched.most_open == 0


def test_travel_is_not_computed_from_a_silent_drive():
    facts = {"encoder": {str(leg): {"drive": 5 - leg, "scale": 2.0} for leg in range(6)}}
    rehearsal = Rehearsal("virtual", facts=facts)
    rehearsal.drives.step()
    context, before = rehearsal.context, rehearsal.context.lengths()
    rehearsal.drives.record["length"][4] += 0.5
    assert context.travelled(before) == {1: pytest.approx(0.25)} | dict.fromkeys((0, 2, 3, 4, 5), 0.0)
    rehearsal.drives.record["age"][4] = OLD_TICKS + 1
    with pytest.raises(StoppedError, match="not_heard: leg 4"):
        context.travelled(before)


LEGS = range(6)


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_leg_with_too_much_travel_is_stopped_in_either_direction(leg, way):
    off = []
    gone = {k: way * TRAVEL_M * (1.01 if k == leg else -0.3) for k in LEGS}
    c: Any = SimpleNamespace(
        travelled=lambda _: gone,
        drives=SimpleNamespace(off=lambda: off.append(True)),
        reads=lambda: {k: [k] for k in LEGS},
    )
    with pytest.raises(StoppedError) as stopped:
        force.guard(c, leg, np.zeros(6))
    assert off
    assert (stopped.value.finding.name, stopped.value.finding.legs) == ("runaway", (leg,))
    gone[leg] *= 0.98
    force.guard(c, leg, np.zeros(6))
