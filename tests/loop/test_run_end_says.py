"""What an ending says, and what a run says while it goes on after a fault."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Fault, Mode
from hil.loop.run_end import Course, Ending
from hil.signals import Operator
from tests.loop.test_run_end import cycle, first_end

MOVES = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])
TOLD: Any = SimpleNamespace(done_text="the brakes closed")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({}, "why"),
        ({"fault_tick": 0}, "why at tick 0"),
        ({"fault_tick": 7}, "why at tick 7"),
        ({"done": "the loop ended"}, "why: the loop ended"),
        ({"story": TOLD}, "why: the brakes closed"),
        (
            {"fault_tick": 7, "done": "the loop ended", "story": TOLD},
            "why at tick 7: the brakes closed; the loop ended",
        ),
    ],
)
def test_trouble_is_what_went_wrong_in_which_tick_and_what_was_done(more, said):
    assert Ending(Mode.FAULT, Fault.STALE, "why", 9, **more).trouble == said


@pytest.mark.parametrize(
    ("mode", "faults", "reason", "success"),
    [
        (Mode.PARKED, Fault.NONE, "", True),
        (Mode.FAULT, Fault.NONE, "", False),
        (Mode.PARKED, Fault.STALE, "", False),
        (Mode.PARKED, Fault.NONE, "why", False),
    ],
)
def test_only_a_run_that_parks_without_a_fault_and_without_a_reason_is_a_success(
    mode, faults, reason, success
):
    ending = Ending(mode, faults, reason, 9)
    assert ending.success is success
    assert (ending.requested, ending.raised, ending.released) == (False, False, False)


def test_a_plant_that_failed_is_the_only_reason_where_the_controller_saw_nothing():
    blamed = Ending(Mode.PARKED, Fault.NONE, "", 9).blamed("the plant was killed")
    assert (blamed.reason, blamed.story) == ("the plant was killed", None)


@pytest.mark.parametrize(
    ("faults", "before", "fault_tick"),
    [(Fault.NONE, "", -1), (Fault.ESTOP, "; before that: latched fault ESTOP", 40)],
)
def test_a_simulation_whose_plant_fails_says_so_first_and_then_which_fault_was_latched(
    faults, before, fault_tick
):
    now = cycle(Mode.TRACKING)
    course = Course(now)
    assert course.ending(39) is None
    if faults:
        now.mode, now.mode_tick, now.faults = Mode.FAULT, 40, faults
    assert course.ending(40) is None
    ending = course.failed("the plant was killed", 41)
    assert ending.reason.startswith("the plant was killed" + before)
    assert (ending.mode, ending.faults, ending.ticks) == (now.mode, faults, 41)
    assert ending.fault_tick == fault_tick
    assert ending.story is not None
    assert ending.story.plant == "the plant was killed"


def test_why_a_way_is_not_followed_is_logged_once_each_time():
    now, told = cycle(Mode.TRACKING), []
    course = Course(now, event=lambda *event: told.append(event))
    for tick, trouble in enumerate(("", "far", "far", "near", "", "near")):
        now.operating.trouble, now.tick["t_ns"] = trouble, 1000 * tick
        course.ending(tick)
    assert told == [(1000, "warning", "far"), (3000, "warning", "near"), (5000, "warning", "near")]


@pytest.mark.parametrize(
    ("force", "holds"),
    [(True, "The drives hold the platform with force"), (False, "Nothing but the brakes holds")],
)
def test_a_held_platform_is_stayed_with_and_what_holds_it_is_said(force, holds, monkeypatch):
    now = cycle(Mode.HELD, faults=Fault.ESTOP)
    monkeypatch.setattr(now.parts.protocol.traits, "force_on_brakes", force)
    for stays in (True, False):
        course = Course(now, stays=stays)
        course.ending(0)
        said = course.stays_for
        assert said.startswith("latched fault ESTOP") is stays
        assert (f"not all brakes are proven shut. {holds}" in said) is stays


def test_a_platform_that_still_moves_a_quarter_of_a_second_after_a_fault_is_said_to_keep_the_run():
    now = cycle(Mode.FAULT, mode_tick=40, faults=Fault.ESTOP, rate=MOVES)
    course = Course(now, stays=True)
    said = []
    for tick in range(40, 70):
        now.tick["tick"] = tick
        assert course.ending(tick) is None
        said.append(course.stays_for)
    assert said[:25] == [""] * 25
    assert all(each.startswith("latched fault ESTOP") and "still moves" in each for each in said[25:])
    now.mode = Mode.PARKED
    assert course.stays_for == ""


@pytest.mark.parametrize(("mode", "released"), [(Mode.HELD, True), (Mode.UNLOADING, False)])
def test_a_platform_counts_as_released_where_it_was_held_when_the_word_came(mode, released):
    now = cycle(mode, faults=Fault.ESTOP)
    course = Course(now, stays=True)
    course.ending(0)
    course.commands(1, (Operator.RELEASE,))
    now.mode, now.mode_tick = Mode.FAULT, 1
    ending = first_end(course, 100)
    assert ending is not None
    assert ending.released is released
    assert ("the platform was released on request" in ending.trouble) is released
