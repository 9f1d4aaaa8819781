"""Transitions of the modes."""

from __future__ import annotations

import pytest

from drivers.signals import DriveMode, DriveState, Mode
from hil.loop.modes import Durations, Facts, drive_mode, next_mode, overdue
from hil.signals import Operator

DURATIONS = Durations(load=0.3, release=0.1)
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
    assert after(Mode.LOADING, elapsed=0.3, drive_state=ready) is Mode.RELEASING
    assert after(Mode.LOADING, elapsed=0.299, drive_state=ready) is Mode.LOADING
    one_off = states(DriveState.READY, DriveState.OFF)
    assert after(Mode.LOADING, elapsed=9.0, drive_state=one_off) is Mode.LOADING


def test_without_a_ramp_the_law_acts_as_soon_as_the_drives_are_ready():
    at_once = Durations(0.0, 0.0)
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
}


@pytest.mark.parametrize("mode", Mode)
def test_a_stop_leads_to_rest_from_everywhere(mode):
    assert after(mode, operator=(Operator.STOP,)) is STOPPED[mode]
    assert after(mode, stop=True) is STOPPED[mode]


def test_a_stop_that_stays_requested_does_not_hold_up_the_way_to_rest():
    assert after(Mode.STOPPING, stop=True, finished=True) is Mode.PARKING
    assert after(Mode.PARKING, stop=True, elapsed=0.1, drive_state=states(DriveState.READY)) is Mode.UNLOADING
    assert after(Mode.UNLOADING, stop=True, elapsed=0.3) is Mode.PARKED


def test_the_force_stays_until_all_six_brakes_are_shut():
    ready = states(DriveState.READY)
    assert after(Mode.PARKING, elapsed=0.1, drive_state=ready) is Mode.UNLOADING
    assert after(Mode.PARKING, elapsed=0.09, drive_state=ready) is Mode.PARKING
    assert (
        after(Mode.PARKING, elapsed=9.0, drive_state=states(DriveState.READY, DriveState.RUN)) is Mode.PARKING
    )
    assert after(Mode.UNLOADING, elapsed=0.3) is Mode.PARKED
    assert after(Mode.UNLOADING, elapsed=0.29) is Mode.UNLOADING


@pytest.mark.parametrize(("mode", "least"), [(Mode.LOADING, 0.3), (Mode.RELEASING, 0.1), (Mode.PARKING, 0.1)])
def test_a_drive_is_waited_for_one_second_and_no_longer(mode, least):
    assert not overdue(mode, least + 0.999, DURATIONS)
    assert overdue(mode, least + 1.001, DURATIONS)


def test_other_modes_wait_for_no_drive():
    waiting = {Mode.LOADING, Mode.RELEASING, Mode.PARKING}
    assert not any(overdue(mode, 1e6, DURATIONS) for mode in Mode if mode not in waiting)


def test_a_fault_stays_until_reset():
    assert after(Mode.FAULT, operator=(Operator.ENGAGE,), elapsed=1e6) is Mode.FAULT
    assert after(Mode.FAULT, operator=(Operator.RESET,)) is Mode.WAITING


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
}


@pytest.mark.parametrize("mode", Mode)
def test_brakes_are_open_only_while_a_law_acts(mode):
    assert drive_mode(mode) is DRIVES[mode]
