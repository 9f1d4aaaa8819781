"""Transitions of the modes."""

from __future__ import annotations

import pytest

from drivers.signals import DriveMode, DriveState, Fault, Mode
from hil.loop.modes import Durations, Facts, after_fault, drive_mode, next_mode, overdue
from hil.signals import Operator

DURATIONS = Durations(load=0.3, release=0.1, close=0.2)
QUIET = Facts(
    operator=(), drive_state=[DriveState.OFF] * 6, ready=True, elapsed=0.0, finished=False, stop=False
)


def after(mode, durations=DURATIONS, **facts):
    return next_mode(mode, QUIET._replace(**facts), durations)


def states(state, odd=None):
    return [state] * 5 + [state if odd is None else odd]


def test_idle_needs_all_six_drives_heard_and_off():
    assert after(Mode.WAITING) is Mode.IDLE
    assert after(Mode.WAITING, ready=False) is Mode.WAITING
    assert after(Mode.WAITING, drive_state=states(DriveState.OFF, DriveState.BOOT)) is Mode.WAITING


def test_nothing_moves_without_engage():
    assert after(Mode.IDLE, elapsed=1e6) is Mode.IDLE
    assert after(Mode.IDLE, operator=(Operator.ENGAGE,)) is Mode.LOADING


def test_brakes_open_only_with_all_six_drives_ready_and_the_force_built_up():
    ready = states(DriveState.READY)
    assert after(Mode.LOADING, elapsed=0.6, drive_state=ready) is Mode.RELEASING, "brake test, ramp"
    assert after(Mode.LOADING, elapsed=0.599, drive_state=ready) is Mode.LOADING
    one_off = states(DriveState.READY, DriveState.OFF)
    assert after(Mode.LOADING, elapsed=9.0, drive_state=one_off) is Mode.LOADING


def test_without_a_ramp_the_law_acts_as_soon_as_the_drives_are_ready():
    at_once = Durations(0.0, 0.0, 0.0)
    assert after(Mode.LOADING, at_once, drive_state=states(DriveState.READY)) is Mode.TRACKING
    assert after(Mode.LOADING, at_once, drive_state=states(DriveState.OFF)) is Mode.LOADING


def test_the_approach_waits_for_all_six_open_brakes():
    run = states(DriveState.RUN)
    assert after(Mode.RELEASING, elapsed=0.1, drive_state=run) is Mode.APPROACH
    assert (
        after(Mode.RELEASING, elapsed=9.0, drive_state=states(DriveState.RUN, DriveState.READY))
        is Mode.RELEASING
    )
    assert after(Mode.RELEASING, elapsed=0.05, drive_state=run) is Mode.RELEASING


def test_motions_follow_one_another():
    assert after(Mode.APPROACH, finished=True) is Mode.TRACKING
    assert after(Mode.TRACKING, finished=True) is Mode.PARKING
    assert after(Mode.STOPPING, finished=True) is Mode.PARKING


STOPPED = {
    Mode.WAITING: Mode.PARKED,
    Mode.IDLE: Mode.PARKED,
    Mode.LOADING: Mode.UNLOADING,
    Mode.RELEASING: Mode.PARKING,
    Mode.APPROACH: Mode.STOPPING,
    Mode.TRACKING: Mode.STOPPING,
    Mode.STOPPING: Mode.STOPPING,
    Mode.PARKING: Mode.PARKING,
    Mode.UNLOADING: Mode.UNLOADING,
    Mode.PARKED: Mode.PARKED,
    Mode.FAULT: Mode.FAULT,
    Mode.HELD: Mode.HELD,
}


@pytest.mark.parametrize("mode", Mode)
def test_a_stop_leads_to_rest_from_everywhere(mode):
    assert after(mode, operator=(Operator.STOP,)) is STOPPED[mode]
    assert after(mode, stop=True) is STOPPED[mode]


def test_a_stop_that_stays_requested_does_not_hold_up_the_way_to_rest():
    assert after(Mode.STOPPING, stop=True, finished=True) is Mode.PARKING
    assert after(Mode.PARKING, stop=True, elapsed=0.2, drive_state=states(DriveState.READY)) is Mode.UNLOADING
    assert after(Mode.UNLOADING, stop=True, elapsed=0.4) is Mode.PARKED


def test_the_force_stays_until_all_six_brakes_are_shut():
    ready = states(DriveState.READY)
    assert after(Mode.PARKING, elapsed=0.2, drive_state=ready) is Mode.UNLOADING
    assert after(Mode.PARKING, elapsed=0.19, drive_state=ready) is Mode.PARKING
    assert (
        after(Mode.PARKING, elapsed=9.0, drive_state=states(DriveState.READY, DriveState.RUN)) is Mode.PARKING
    )
    assert after(Mode.UNLOADING, elapsed=0.4) is Mode.PARKED, "ramp, and 0.1 s without any force"
    assert after(Mode.UNLOADING, elapsed=0.39) is Mode.UNLOADING
    assert after(Mode.UNLOADING, Durations(0.0, 0.1, 0.2)) is Mode.PARKED, "without a ramp there is no test"


@pytest.mark.parametrize(("mode", "least"), [(Mode.LOADING, 0.6), (Mode.RELEASING, 0.1), (Mode.PARKING, 0.2)])
def test_a_drive_is_waited_for_one_second_and_no_longer(mode, least):
    assert not overdue(mode, least + 0.999, DURATIONS)
    assert overdue(mode, least + 1.001, DURATIONS)


def test_other_modes_wait_for_no_drive():
    waiting = {Mode.LOADING, Mode.RELEASING, Mode.PARKING}
    assert not any(overdue(mode, 1e6, DURATIONS) for mode in Mode if mode not in waiting)


def test_a_fault_stays_until_reset():
    assert after(Mode.FAULT, operator=(Operator.ENGAGE,), elapsed=1e6) is Mode.FAULT
    assert after(Mode.FAULT, operator=(Operator.RESET,)) is Mode.WAITING


def test_a_held_platform_is_let_go_of_by_the_operators_release_and_nothing_else():
    for operator in Operator:
        expected = Mode.FAULT if operator is Operator.RELEASE else Mode.HELD
        assert after(Mode.HELD, operator=(operator,), stop=True, finished=True, elapsed=1e6) is expected
    for mode in set(Mode) - {Mode.HELD}:
        assert after(mode, operator=(Operator.RELEASE,)) is after(mode)


LOST = (Fault.ESTOP, Fault.DRIVE, Fault.BUS)


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault])
@pytest.mark.parametrize("mode", Mode)
def test_a_fault_leaves_the_force_on_where_it_alone_may_hold_the_platform(mode, fault):
    braked = {Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED}
    held = mode in {Mode.PARKING, Mode.UNLOADING, Mode.HELD} or (mode in braked and fault is Fault.BRAKE)
    expected = Mode.HELD if held and fault not in LOST else Mode.FAULT
    assert after_fault(mode, fault, located=True) is expected
    for lost in LOST:
        assert after_fault(mode, fault | lost, located=True) is Mode.FAULT


def test_where_the_pose_was_never_found_no_force_comes_back():
    assert after_fault(Mode.PARKED, Fault.BRAKE, located=False) is Mode.FAULT
    assert after_fault(Mode.UNLOADING, Fault.BRAKE, located=False) is Mode.HELD, "its force is known"


DRIVES = {
    Mode.WAITING: DriveMode.OFF,
    Mode.IDLE: DriveMode.OFF,
    Mode.LOADING: DriveMode.READY,
    Mode.RELEASING: DriveMode.RUN,
    Mode.APPROACH: DriveMode.RUN,
    Mode.TRACKING: DriveMode.RUN,
    Mode.STOPPING: DriveMode.RUN,
    Mode.PARKING: DriveMode.READY,
    Mode.UNLOADING: DriveMode.READY,
    Mode.PARKED: DriveMode.OFF,
    Mode.FAULT: DriveMode.OFF,
    Mode.HELD: DriveMode.READY,
}


@pytest.mark.parametrize("mode", Mode)
def test_brakes_are_open_only_while_a_law_acts(mode):
    assert drive_mode(mode) is DRIVES[mode]
