"""How a run begins and ends: the rule itself."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from drivers.protocol import DriveSetup
from drivers.signals import NEVER, DriveState, Fault, Mode, Reaction, Stop
from drivers.tick_columns import FIRST
from hil.contracts.records import altered, record_of
from hil.loop.modes import Durations
from hil.loop.run_end import Course, Ending
from hil.signals import Operator

RATE_Hz = 100.0
SET_UP = SimpleNamespace(
    fault_text=lambda _: "",
    traits=SimpleNamespace(stop_latches=True, force_on_brakes=True, has_watchdog=True),
)
HEARD = {"age": 0, "counted_age": 0, "drive_state": DriveState.OFF}


def cycle(mode, mode_tick=0, faults=Fault.NONE, stop=Stop.NONE, **measured):
    tick = record_of(**(HEARD | measured))
    return SimpleNamespace(
        mode=mode,
        mode_tick=mode_tick,
        faults=faults,
        stop_requested=stop,
        proven=True,
        tick=tick,
        last=tick,
        estop=False,
        homing=SimpleNamespace(refusal=""),
        operating=SimpleNamespace(trouble=""),
        reset_tick=None,
        end=SimpleNamespace(lacks=lambda: ("",) * 6),
        looked=True,
        durations=Durations(0.3, 0.1, 0.1),
        parts=SimpleNamespace(
            rate_Hz=RATE_Hz,
            fusion=None,
            protocol=SET_UP,
            setup=DriveSetup(0.01, Reaction.BRAKE, RATE_Hz),
            safety=SimpleNamespace(
                limits={"stale_fault_ticks": np.int64(5)},
                memory={"refused": 0b11111, "running": 0, "untrusted": 0},
            ),
        ),
    )


def states(*different):
    return np.array([*different, *[DriveState.OFF] * (6 - len(different))], np.int64)


def first_end(course, until):
    """Return the first ending, looked for in every tick."""
    for tick in range(until):
        ending = course.ending(tick)
        if ending is not None:
            return ending
    return None


def test_engages_once_idle_and_never_twice():
    now = cycle(Mode.WAITING)
    course = Course(now)
    assert course.commands(0) == ()
    now.mode = Mode.IDLE
    assert course.commands(1) == (Operator.ENGAGE,)
    assert course.commands(2) == ()


@pytest.mark.parametrize("armed", [True, False])
def test_a_consent_that_came_with_a_drive_that_was_switched_off_is_asked_for_again(armed):
    """The cycle went back to WAITING in the tick of the consent; later it has all drives again."""
    now = cycle(Mode.IDLE)
    course = Course(now, 5.0, armed=armed)
    said = () if armed else (Operator.ENGAGE,)
    assert course.commands(0, said) == (Operator.ENGAGE,)
    now.mode = Mode.WAITING
    assert course.commands(1) == ()
    now.mode = Mode.IDLE
    assert course.commands(2, said) == (Operator.ENGAGE,)
    now.mode = Mode.LOADING
    assert course.commands(3) == ()
    now.mode = Mode.WAITING  # parked, and reset by the operator
    course.commands(5000)
    now.mode = Mode.IDLE
    assert course.commands(5001) == (), "that needs a new word"


@pytest.mark.parametrize("duration_s", [None, 5.0])
def test_a_fault_before_the_platform_moved_takes_the_consent_back(duration_s):
    now = cycle(Mode.FAULT, faults=Fault.ESTOP)
    course = Course(now, duration_s)
    assert course.commands(0, (Operator.RESET,)) == (Operator.RESET,)
    now.mode = Mode.WAITING
    assert course.commands(1) == ()
    now.mode = Mode.IDLE
    assert course.commands(2) == ()
    assert course.waits_for_consent
    assert course.commands(3, (Operator.ENGAGE,)) == (Operator.ENGAGE,)


def test_a_reset_of_the_drives_while_they_are_waited_for_takes_no_consent_back():
    now = cycle(Mode.WAITING)
    course = Course(now)
    course.commands(0, (Operator.RESET,))
    now.mode = Mode.IDLE
    assert course.commands(1) == (Operator.ENGAGE,)


@pytest.mark.parametrize("mode", [Mode.FAULT, Mode.PARKED])
def test_a_run_that_stays_does_so_before_it_was_ever_armed(mode):
    now = cycle(mode, faults=Fault.ESTOP if mode is Mode.FAULT else Fault.NONE)
    course = Course(now, armed=False, goes_on=True)
    assert first_end(course, 1000) is None
    course.commands(1000, (Operator.END,))
    assert first_end(course, 1000) is not None


def test_a_leg_that_moves_after_a_fault_is_waited_for_ten_seconds_or_until_the_operator_leaves():
    now = cycle(Mode.FAULT, faults=Fault.ESTOP, rate=np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]))
    ending = first_end(Course(now), 2000)
    assert ending is not None
    assert ending.ticks == 1000
    assert ending.reason.endswith("; still moving: leg 2 at +0.020 m/s")
    course = Course(now, stays=True)
    assert first_end(course, 3000) is None
    course.commands(3000, (Operator.STOP,))
    assert course.ending(3000) is None
    course.commands(3001, (Operator.ESTOP,))
    ending = course.ending(3001)
    assert ending is not None
    assert "still moving: leg 2" in ending.reason


@pytest.mark.parametrize(("stays", "tick"), [(False, 100), (True, None)])
def test_a_platform_that_is_held_with_force_is_held_for_a_second_or_until_the_operator_releases_it(
    stays, tick
):
    ending = first_end(Course(cycle(Mode.HELD, faults=Fault.ESTOP), stays=stays), 2000)
    assert (ending.ticks if ending else None) == tick


@pytest.mark.parametrize(("stays", "tick"), [(False, 1000), (True, None)])
def test_a_platform_that_goes_to_closed_brakes_and_is_held_again_is_held_for_ten_seconds_in_all(stays, tick):
    """Where frames are lost no brake test comes to its end; 0.2 s of each in turn."""
    now = cycle(Mode.HELD, faults=Fault.STALE)
    course, found = Course(now, stays=stays), None
    for number in range(3000):
        if number % 20 == 0:
            now.mode, now.mode_tick = (Mode.HELD, Mode.UNLOADING)[number // 20 % 2], number
        found = found or course.ending(number)
    assert (found.ticks if found else None) == tick


def test_a_run_that_stays_and_finds_no_drives_ends():
    now = cycle(Mode.WAITING, age=NEVER)
    assert first_end(Course(now, armed=False, goes_on=True), 1000) is not None


def test_stops_once_at_its_duration_also_where_that_tick_is_skipped():
    course = Course(cycle(Mode.TRACKING), 0.5)
    assert course.commands(49) == ()
    assert course.commands(53) == (Operator.STOP,)
    assert course.commands(54) == ()


def test_resets_in_the_first_tick_alone_and_only_on_request():
    assert Course(cycle(Mode.WAITING)).commands(0) == ()
    course = Course(cycle(Mode.WAITING), reset=True)
    assert course.commands(0) == (Operator.RESET,)
    assert course.commands(1) == ()


def test_its_own_commands_come_before_the_operators():
    course = Course(cycle(Mode.IDLE), 0.01, reset=True)
    mine = (Operator.RESET, Operator.ENGAGE, Operator.STOP)
    assert course.commands(1, (Operator.ESTOP,)) == (*mine, Operator.ESTOP)


STALE_LIMIT = "limits.stale_fault_ticks is 5"
ENDS = {Mode.PARKED, Mode.FAULT, Mode.WAITING, Mode.HELD}


@pytest.mark.parametrize("mode", [m for m in Mode if m not in ENDS])
def test_goes_on_between_the_start_and_the_end(mode):
    assert first_end(Course(cycle(mode, drive_state=states(DriveState.FAULT))), 3000) is None


@pytest.mark.parametrize(("failed", "tick"), [({2}, 200), ({0, 1, 2, 3, 4, 5}, 200), (set(), 1000)])
def test_a_run_waits_two_seconds_for_drives_of_which_any_has_failed_and_ten_for_others(failed, tick):
    each = [DriveState.FAULT if leg in failed else DriveState.BOOT for leg in range(6)]
    ending = first_end(Course(cycle(Mode.WAITING, drive_state=states(*each))), 3000)
    assert ending is not None
    assert (ending.mode, ending.ticks, ending.success) == (Mode.WAITING, tick, False)


def test_ends_parked_as_soon_as_all_drives_are_off():
    now = cycle(Mode.PARKED, mode_tick=7, drive_state=states(*[DriveState.OFF] * 5, DriveState.READY))
    course = Course(now)
    assert course.ending(8) is None
    now.tick = altered(now.tick, drive_state=states())
    assert course.ending(9) == Ending(Mode.PARKED, Fault.NONE, "", 9)


def test_ends_parked_a_quarter_of_a_second_later_where_a_drive_does_not_report_off():
    ending = first_end(Course(cycle(Mode.PARKED, mode_tick=7, drive_state=states(DriveState.BOOT))), 1000)
    assert ending == Ending(Mode.PARKED, Fault.NONE, "", 7 + 25)


@pytest.mark.parametrize(
    ("duration_s", "operator", "requested"),
    [(None, (), False), (0.1, (), True), (None, (Operator.STOP,), True), (None, (Operator.ESTOP,), True)],
)
def test_a_stop_by_the_operator_or_the_duration_was_requested(duration_s, operator, requested):
    course = Course(cycle(Mode.PARKED), duration_s)
    course.commands(10, operator)
    ending = course.ending(10)
    assert ending is not None
    assert ending.requested is requested
    assert ending.success


@pytest.mark.parametrize(
    ("stop", "what"),
    [
        (Stop.MISSED, "limits.missed_stop_ticks"),
        (Stop.RECORDER, "recording.on_recorder_loss"),
        (Stop.STRETCHED, "limits.stretch_percent"),
    ],
)
def test_a_stop_by_safety_is_no_success_and_says_why(stop, what):
    ending = first_end(Course(cycle(Mode.PARKED, stop=stop)), 10)
    assert ending is not None
    assert (ending.success, ending.requested) == (False, False)
    assert what in ending.reason


def test_ends_a_quarter_of_a_second_after_a_fault_with_what_was_known_in_its_tick():
    now = cycle(Mode.FAULT, mode_tick=40, faults=Fault.STALE, counted_age=np.array([0, 0, 5, 0, 0, 0]))
    course = Course(now)
    assert course.ending(40) is None
    now.tick = altered(now.tick, counted_age=[9, 9, 30, 9, 9, 9])
    assert course.ending(64) is None
    text = "latched fault STALE (leg 2 not heard for 5 ticks, limits.stale_fault_ticks is 5)"
    assert course.ending(65) == Ending(Mode.FAULT, Fault.STALE, text, 65, 40)


@pytest.mark.parametrize(
    ("ages", "said"),
    [
        ([3, 3, 5, 1, 3, 1], f"(leg 2 not heard for 5 ticks, {STALE_LIMIT})"),
        ([0, 7, 5, 0, 0, 0], f"(leg 1, 2 not heard for 7, 5 ticks, {STALE_LIMIT})"),
        (
            [5, 6, 5, 5, 5, 5],
            f"(no leg heard for 5 ticks, {STALE_LIMIT}: the drives, the bus or this machine had stalled for 50 ms by then;",
        ),
    ],
)
def test_a_stale_fault_names_the_legs_that_reached_its_limit(ages, said):
    now = cycle(Mode.FAULT, mode_tick=1, faults=Fault.STALE, counted_age=np.array(ages))
    ending = first_end(Course(now), 100)
    assert ending is not None
    assert said in ending.reason


@pytest.mark.parametrize("asked", [(), (Operator.STOP,), (Operator.STOP, Operator.END)])
def test_a_run_that_was_over_before_its_drives_were_ready_is_no_success_but_on_request(asked):
    now = cycle(Mode.WAITING, age=NEVER)
    course = Course(now, duration_s=None if asked else 1.0)
    for tick in range(101):
        course.commands(tick, asked if tick == 100 else ())
    now.mode, now.mode_tick = Mode.PARKED, 101
    ending = first_end(course, 200)
    assert ending is not None
    assert ending.success == bool(asked)
    assert ("drive 0 never answered" in ending.reason) == (not asked)


def test_a_second_fault_after_a_reset_has_a_tail_and_a_text_of_its_own():
    now = cycle(Mode.FAULT, mode_tick=40, faults=Fault.ESTOP)
    course = Course(now)
    assert course.ending(50) is None
    now.mode, now.mode_tick, now.faults = Mode.FAULT, 60, Fault.BUS
    assert course.ending(60) is None
    assert course.ending(84) is None
    text = "latched fault BUS (the bus did not take our frames in 5 ticks in a row; 5 are a dead bus)"
    assert course.ending(85) == Ending(Mode.FAULT, Fault.BUS, text, 85, 60)


def test_a_slow_loop_still_tells_the_drives_to_switch_off_five_times():
    slow = cycle(Mode.FAULT, faults=Fault.BUS)
    slow.parts.rate_Hz = 5.0
    ending = first_end(Course(slow), 100)
    assert ending is not None
    assert ending.ticks == 5


def test_ends_after_two_seconds_without_any_drive():
    ending = first_end(Course(cycle(Mode.WAITING, age=FIRST["age"])), 3000)
    assert ending == Ending(Mode.WAITING, Fault.NONE, "no drives", 200)
    assert ending.mode is Mode.WAITING
    assert ending.faults is Fault.NONE


def test_one_drive_heard_is_waited_for_ten_seconds_and_the_others_are_named():
    age = FIRST["age"].copy()
    age[4] = 0
    ending = first_end(Course(cycle(Mode.WAITING, age=age)), 3000)
    assert ending is not None
    assert ending.ticks == 1000
    assert "drive 0 never answered" in ending.reason
    assert "drive 4" not in ending.reason


@pytest.mark.parametrize("leg", range(6))
def test_a_fault_that_a_drive_has_latched_before_ends_the_wait_after_two_seconds(leg):
    state = states()
    state[leg] = DriveState.FAULT
    ending = first_end(Course(cycle(Mode.WAITING, drive_state=state)), 3000)
    assert ending is not None
    assert ending.ticks == 200
    assert f"drive {leg} stays in FAULT" in ending.reason
    assert "--reset" in ending.reason


def test_what_the_plant_says_of_itself_comes_before_what_the_controller_saw_of_it():
    now = cycle(Mode.FAULT, mode_tick=1, faults=Fault.STALE, counted_age=np.array([5] * 6))
    ending = first_end(Course(now), 100)
    assert ending is not None
    assert ending.blamed("") is ending
    blamed = ending.blamed("my.fmu: the FMU did not step within 5 s")
    assert blamed.trouble.startswith(
        "my.fmu: the FMU did not step within 5 s; the controller: latched fault STALE"
    )
    assert blamed.story is not None
    assert blamed.story.lines()[0] == "plant: my.fmu: the FMU did not step within 5 s"
    assert next(iter(blamed.story.next)).startswith("mend the plant")
    parked = Ending(Mode.PARKED, Fault.NONE, "", 100, -1)
    assert parked.success
    assert not parked.blamed("the plant was killed").success
