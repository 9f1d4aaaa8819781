"""Properties and texts of an ending, and the messages of a run that continues after a fault."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import NEVER, Fault, Mode, Stop
from hil.loop.run_end import Course, Ending
from hil.signals import Operator
from tests.loop.test_run_end import MOVES, F, H, P, S, T, W, X, change, cycle


@pytest.mark.parametrize(
    ("mode", "faults", "reason", "success"),
    [
        (P, Fault.NONE, "", True),
        (F, Fault.NONE, "", False),
        (P, Fault.STALE, "", False),
        (P, Fault.NONE, "why", False),
    ],
)
def test_run_succeeds_only_if_it_parks_without_fault_or_failure_reason(mode, faults, reason, success):
    assert Ending(mode, faults, reason, 9).success is success


@pytest.mark.parametrize(
    ("duration_s", "operator", "requested"),
    [(None, (), False), (0.1, (), True), *((None, (o,), o in {*S, *X, Operator.END}) for o in Operator)],
)
def test_stop_by_operator_or_end_of_duration_counts_as_requested(duration_s, operator, requested):
    course = Course(cycle(P), duration_s)
    course.commands(10, operator)
    ending = course.ending(10)
    assert ending is not None
    assert ending.requested is requested
    assert ending.success


@pytest.mark.parametrize("asked", [(), S, (*S, Operator.END)])
def test_run_stopped_before_its_drives_are_ready_succeeds_only_if_the_operator_stopped_it(asked):
    now = cycle(W, age=NEVER)
    course = Course(now, None if asked else 1.0)
    for tick in range(101):
        course.commands(tick, asked if tick == 100 else ())
    now.mode, now.mode_tick = P, 100
    ending = course.ending(100)
    assert ending is not None
    assert ending.success == bool(asked)


@pytest.mark.parametrize(
    ("stop", "what"),
    [
        (Stop.MISSED, "limits.missed_stop_ticks"),
        (Stop.RECORDER, "recording.on_recorder_loss"),
        (Stop.STRETCHED, "limits.stretch_percent"),
    ],
)
def test_run_stopped_by_safety_fails_with_the_limit_as_reason(stop, what):
    ending = Course(cycle(P, stop=stop)).ending(0)
    assert ending is not None
    assert (ending.success, ending.requested) == (False, False)
    assert what in ending.reason


def test_failure_message_gives_the_cause_in_the_plant_before_the_fault_of_the_controller():
    course = Course(cycle(F, 1, Fault.STALE, counted_age=np.array([5] * 6)))
    assert course.ending(1) is None
    ending = course.ending(26)
    assert ending is not None
    assert ending.blamed("") is ending
    blamed = ending.blamed("the FMU did not step")
    assert blamed.trouble.startswith("the FMU did not step; the controller: latched fault STALE")
    assert blamed.story is not None
    assert blamed.story.lines()[0] == "plant: the FMU did not step"
    parked = Ending(P, Fault.NONE, "", 100)
    assert (parked.success, parked.blamed("the plant was killed").success) == (True, False)


@pytest.mark.parametrize("faults", [Fault.NONE, Fault.ESTOP])
def test_plant_failure_is_reported_before_the_lasting_fault_of_the_controller(faults):
    now = cycle(T)
    course = Course(now)
    assert course.ending(39) is None
    if faults:
        change(now, 40, {"mode": F, "faults": faults})
    assert course.ending(40) is None
    ending = course.failed("the plant was killed", 41)
    assert ending.reason.startswith("the plant was killed")
    assert ("latched fault ESTOP" in ending.reason) is bool(faults)
    assert (ending.mode, ending.faults, ending.ticks) == (now.mode, faults, 41)
    assert ending.fault_tick == (40 if faults else -1)
    assert ending.story is not None
    assert ending.story.plant == "the plant was killed"


def test_run_that_continues_after_a_fault_reports_the_reason_and_whether_force_holds(monkeypatch):
    for force, holds in ((True, "with force"), (False, "Only the brakes")):
        now = cycle(H, faults=Fault.ESTOP)
        monkeypatch.setattr(now.parts.protocol.traits, "force_on_brakes", force)
        for stays in (True, False):
            course = Course(now, stays=stays)
            course.ending(0)
            assert (holds in course.stays_for) is stays
    now = cycle(F, 40, Fault.ESTOP, rate=MOVES)
    course, said = Course(now, stays=True), []
    for tick in range(40, 70):
        now.tick["tick"] = tick
        assert course.ending(tick) is None
        said.append("still moves" in course.stays_for)
    assert said == [False] * 25 + [True] * 5
    now.mode = P
    assert course.stays_for == ""


@pytest.mark.parametrize(("mode", "released"), [(H, True), (Mode.UNLOADING, False)])
def test_platform_counts_as_released_by_the_operator_only_if_it_was_held(mode, released):
    now = cycle(mode, faults=Fault.ESTOP)
    course = Course(now, stays=True)
    course.ending(0)
    course.commands(1, (Operator.RELEASE,))
    change(now, 1, {"mode": F})
    assert course.ending(1) is None
    ending = course.ending(26)
    assert ending is not None
    assert ending.released is released
