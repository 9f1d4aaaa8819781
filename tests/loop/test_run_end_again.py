"""When a run ends after its second stop or fault: what came before the fault does not count for it."""

import numpy as np
import pytest

from drivers.signals import NEVER, Fault, Mode
from hil.loop.run_end import Course
from hil.signals import Operator
from tests.loop.test_run_end import cycle, first_end

MOVES = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.HELD])
def test_an_emergency_stop_in_motion_does_not_leave_the_platform_that_moves_after_it(mode):
    now = cycle(mode, rate=MOVES)
    course = Course(now, stays=True)
    course.commands(10, (Operator.ESTOP,))
    now.mode, now.mode_tick, now.faults = Mode.FAULT, 10, Fault.ESTOP
    assert all(course.ending(tick) is None for tick in range(10, 500))
    now.tick["rate"] = 0.0
    assert all(course.ending(tick) is None for tick in range(500, 524)), "0.25 s at rest"
    assert course.ending(524) is not None


def test_a_second_emergency_stop_leaves_it_once_the_first_one_has_led_to_the_fault():
    now = cycle(Mode.TRACKING, rate=MOVES)
    course = Course(now, stays=True)
    course.commands(10, (Operator.ESTOP,))
    now.mode, now.mode_tick, now.faults = Mode.FAULT, 10, Fault.ESTOP
    assert course.ending(10) is None
    course.commands(11, (Operator.ESTOP,))
    assert course.ending(11) is not None


@pytest.mark.parametrize(("rate", "ends"), [(MOVES, 2500), (np.zeros(6), 1600)], ids=["moves", "rests"])
def test_a_platform_that_is_held_again_after_a_reset_is_held_for_as_long_as_the_first_time(rate, ends):
    now = cycle(Mode.HELD, faults=Fault.STALE, rate=MOVES)
    course = Course(now)
    assert first_end(course, 800) is None
    now.mode, now.mode_tick, now.faults = Mode.TRACKING, 800, Fault.NONE
    assert all(course.ending(tick) is None for tick in range(800, 1500))
    now.mode, now.mode_tick, now.faults = Mode.HELD, 1500, Fault.STALE
    now.tick["rate"] = rate
    ending = next((found for tick in range(1500, 3000) if (found := course.ending(tick))), None)
    assert ending is not None
    assert ending.ticks == ends


def test_an_end_that_is_asked_for_later_does_not_make_good_that_the_drives_were_never_ready():
    now = cycle(Mode.WAITING, age=NEVER)
    course = Course(now, duration_s=1.0, goes_on=True)
    course.commands(100)
    now.mode, now.mode_tick = Mode.PARKED, 100
    course.commands(101, (Operator.STOP, Operator.END))
    ending = first_end(course, 200)
    assert ending is not None
    assert "drive 0 never answered" in ending.reason


@pytest.mark.parametrize("struck", range(5))
@pytest.mark.parametrize("mode", [Mode.FAULT, Mode.HELD])
def test_however_early_a_fault_strikes_the_legs_are_watched_for_as_long_from_then_on(mode, struck):
    now = cycle(mode, mode_tick=struck, faults=Fault.ESTOP)
    course = Course(now)
    ending = next((found for tick in range(struck, 500) if (found := course.ending(tick))), None)
    assert ending is not None
    assert ending.ticks == struck + (25 if mode is Mode.FAULT else 100)


def test_a_leg_that_moves_is_waited_for_ten_seconds_from_the_fault_on():
    now = cycle(Mode.FAULT, mode_tick=40, faults=Fault.ESTOP, rate=MOVES)
    course = Course(now)
    ending = next((found for tick in range(40, 2000) if (found := course.ending(tick))), None)
    assert ending is not None
    assert ending.ticks == 1040


def test_a_platform_at_rest_that_is_left_by_an_emergency_stop_does_not_still_move():
    course = Course(cycle(Mode.FAULT, mode_tick=40, faults=Fault.ESTOP), stays=True)
    assert course.ending(40) is None
    course.commands(41, (Operator.ESTOP,))
    ending = course.ending(41)
    assert ending is not None
    assert "still moving" not in ending.reason


def test_the_tick_of_the_first_fault_counts_and_all_that_followed_are_named():
    now = cycle(Mode.FAULT, mode_tick=40, faults=Fault.ESTOP)
    course = Course(now)
    assert course.ending(40) is None
    now.faults |= Fault.BUS
    ending = next((found for tick in range(45, 100) if (found := course.ending(tick))), None)
    assert ending is not None
    assert ending.fault_tick == 40
    assert ending.reason.startswith("latched fault ESTOP, BUS")


def test_a_fault_that_follows_does_not_begin_the_ten_seconds_of_a_held_platform_anew():
    now = cycle(Mode.HELD, faults=Fault.ESTOP, rate=MOVES)
    course, ended = Course(now), None
    for tick in range(2000):
        if tick == 600:
            now.faults |= Fault.BUS
        ended = ended or course.ending(tick)
    assert ended is not None
    assert ended.ticks == 1000


def test_a_run_that_parks_after_a_reset_has_no_tick_of_a_fault():
    now = cycle(Mode.FAULT, mode_tick=40, faults=Fault.ESTOP)
    course = Course(now)
    assert course.ending(40) is None
    now.mode, now.mode_tick, now.faults, now.reset_tick = Mode.PARKED, 60, Fault.NONE, 50
    ending = course.ending(60)
    assert ending is not None
    assert (ending.fault_tick, ending.trouble) == (-1, "")


def test_a_platform_that_moves_while_it_is_held_is_watched_for_ten_seconds_from_when_it_began_to_be_held():
    now = cycle(Mode.PARKING, rate=MOVES, faults=Fault.ESTOP)
    course = Course(now)
    assert first_end(course, 500) is None
    now.mode, now.mode_tick = Mode.HELD, 500
    assert all(course.ending(tick) is None for tick in range(500, 1500))
    assert course.ending(1500) is not None
