"""Which commands a run gives by itself, and when: its own word once, and its end once."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import NEVER, DriveState, Fault, Mode, Stop
from hil.loop.run_end import Course
from hil.signals import Operator
from tests.loop.test_run_end import cycle, first_end

ENGAGE, STOP = (Operator.ENGAGE,), (Operator.STOP,)


def given(
    course: Course, until: int, said: dict[int, tuple[Operator, ...]], since: int = 0
) -> dict[int, tuple[Operator, ...]]:
    """Return the commands of the ticks that have any."""
    found = {tick: course.commands(tick, said.get(tick, ())) for tick in range(since, until)}
    return {tick: commands for tick, commands in found.items() if commands}


def test_a_duration_counts_from_the_operators_first_consent_and_stops_once():
    course = Course(cycle(Mode.IDLE), 0.5, armed=False)
    assert given(course, 200, {7: ENGAGE, 20: ENGAGE}) == {7: ENGAGE, 20: ENGAGE, 57: STOP}


@pytest.mark.parametrize("said_again", [40, 80])
def test_a_consent_that_has_to_be_given_again_is_waited_for_and_its_duration_counts_from_then_on(said_again):
    """A drive was switched off in the tick of the first one."""
    now = cycle(Mode.IDLE)
    course = Course(now, 0.5, armed=False)
    assert course.commands(0, ENGAGE) == ENGAGE
    now.mode = Mode.WAITING
    assert course.commands(1) == ()
    now.mode = Mode.IDLE
    assert given(course, 200, {said_again: ENGAGE}, 2) == {said_again: ENGAGE, said_again + 50: STOP}


def test_a_consent_that_has_to_be_given_again_leaves_the_end_of_the_run_where_it_was():
    now = cycle(Mode.FAULT, faults=Fault.ESTOP)
    course = Course(now, 0.5)
    course.commands(0)
    now.mode = Mode.IDLE
    course.commands(10, ENGAGE)
    now.mode = Mode.WAITING
    assert given(course, 200, {}, 11) == {50: STOP}


def test_a_consent_that_is_taken_back_stops_no_run_a_second_time():
    now = cycle(Mode.WAITING)
    course = Course(now, 0.5)
    assert given(course, 60, {}) == {50: STOP}
    now.mode = Mode.IDLE
    assert course.commands(60) == ENGAGE
    now.mode = Mode.WAITING
    assert given(course, 200, {}, 61) == {}


def test_a_run_that_was_asked_to_end_is_not_stopped_again_at_its_duration():
    course = Course(cycle(Mode.TRACKING), 0.5)
    assert given(course, 200, {10: (Operator.END,)}) == {10: (Operator.STOP, Operator.END)}


@pytest.mark.parametrize("mode", [Mode.WAITING, Mode.LOADING, Mode.TRACKING, Mode.PARKED])
def test_a_word_of_consent_where_no_run_is_ready_does_not_count_for_later(mode):
    now = cycle(mode)
    course = Course(now, 0.5, armed=False)
    course.commands(0, ENGAGE)
    now.mode = Mode.IDLE
    assert course.waits_for_consent
    assert given(course, 200, {}) == {}
    assert course.commands(200, ENGAGE) == ENGAGE
    assert not course.waits_for_consent
    assert course.commands(250) == STOP


@pytest.mark.parametrize("mode", Mode)
def test_only_a_run_that_is_ready_waits_for_consent_and_none_that_arms_itself(mode):
    assert Course(cycle(mode), armed=False).waits_for_consent == (mode is Mode.IDLE)
    assert not Course(cycle(mode)).waits_for_consent


@pytest.mark.parametrize(
    "operator", [o for o in Operator if o not in {Operator.STOP, Operator.ESTOP, Operator.END}]
)
def test_no_other_word_than_a_stop_asks_for_the_end_of_a_run(operator):
    course = Course(cycle(Mode.PARKED))
    course.commands(0, (operator,))
    ending = course.ending(0)
    assert ending is not None
    assert not ending.requested


def test_an_emergency_stop_leaves_a_platform_that_moves_for_good():
    now = cycle(Mode.FAULT, faults=Fault.ESTOP, rate=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.02]))
    course = Course(now, stays=True)
    course.commands(1, (Operator.ESTOP,))
    course.commands(2)
    course.commands(3, (Operator.STOP,))
    assert course.ending(3) is not None


def test_a_run_that_stays_waits_for_drives_that_it_has_had_before_until_it_is_asked_to_end():
    now = cycle(Mode.IDLE)
    course = Course(now, goes_on=True)
    assert course.commands(0) == ENGAGE
    now.mode = Mode.LOADING
    course.commands(1)
    now.mode, now.tick["age"] = Mode.WAITING, NEVER
    assert first_end(course, 3000) is None
    course.commands(3000, (Operator.END,))
    assert first_end(course, 3000) is not None


@pytest.mark.parametrize("mode", [Mode.PARKED, Mode.FAULT])
def test_a_run_that_does_not_stay_ends_after_it_and_one_that_stays_goes_on(mode):
    now = cycle(mode, faults=Fault.ESTOP if mode is Mode.FAULT else Fault.NONE)
    assert first_end(Course(now, goes_on=True), 3000) is None
    assert first_end(Course(now), 100) is not None


@pytest.mark.parametrize("age", [0, NEVER], ids=["heard", "never"])
def test_drives_whose_turns_are_not_known_end_the_wait_after_two_seconds_with_the_reason(age):
    now = cycle(Mode.WAITING, mode_tick=5, age=age)
    now.homing.refusal = "leg 3: turn it home"
    ending = first_end(Course(now), 3000)
    assert ending is not None
    assert ending.ticks == 205
    assert ending.mode is Mode.WAITING
    assert ending.faults is Fault.NONE
    assert "leg 3: turn it home" in ending.reason


@pytest.mark.parametrize(("state", "ticks"), [(DriveState.FAULT, 207), (DriveState.BOOT, 1007)])
def test_drives_are_waited_for_from_the_tick_in_which_that_began(state, ticks):
    now = cycle(Mode.WAITING, mode_tick=7, drive_state=np.array([DriveState.OFF] * 5 + [state]))
    ending = first_end(Course(now), 3000)
    assert ending is not None
    assert ending.ticks == ticks
    assert ending.mode is Mode.WAITING
    assert ending.faults is Fault.NONE


def test_a_run_that_was_over_before_its_drives_were_ready_says_that_and_not_who_stopped_it():
    now = cycle(Mode.WAITING, age=NEVER, stop=Stop.MISSED)
    course = Course(now, 1.0)
    course.commands(100)
    now.mode, now.mode_tick = Mode.PARKED, 100
    ending = first_end(course, 200)
    assert ending is not None
    assert "drive 0 never answered" in ending.reason
    assert "missed" not in ending.reason
