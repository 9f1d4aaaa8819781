"""Transitions of the modes."""

from __future__ import annotations

import math

import pytest

from drivers.signals import DriveMode, DriveState, Fault, Mode
from hil.config.reactions import ReactionSettings
from hil.loop.modes import (
    BEFORE,
    BRAKED,
    CONTROLLED,
    ENDING,
    MOVING,
    NO_PROOF,
    NOBODY_OBEYS,
    NOT_MEASURED,
    OF_THE_POSE,
    STEERED,
    UNPROVEN,
    Durations,
    Facts,
    after_fault,
    drive_mode,
    next_mode,
    overdue,
)
from hil.signals import Operator

DURATIONS = Durations(load=0.3, release=0.1, close=0.2)
QUIET = Facts(
    operator=(),
    drive_state=[DriveState.OFF] * 6,
    ready=True,
    elapsed=0.0,
    finished=False,
    stop=False,
    provable=False,
    stays=False,
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


def test_a_drive_that_was_switched_off_while_the_operator_was_waited_for_is_waited_for_again():
    assert after(Mode.IDLE, ready=False) is Mode.WAITING
    assert after(Mode.IDLE, ready=False, operator=(Operator.ENGAGE,)) is Mode.WAITING, "whatever was said"
    assert after(Mode.IDLE, ready=False, operator=(Operator.STOP,)) is Mode.PARKED


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


def test_a_drive_that_comes_with_the_last_moment_of_its_second_is_in_time():
    even = Durations(load=0.25, release=0.5, close=0.125)
    for mode, least in ((Mode.LOADING, 0.5), (Mode.RELEASING, 0.5), (Mode.PARKING, 0.125)):
        assert not overdue(mode, least + 1.0, even)
        assert overdue(mode, math.nextafter(least + 1.0, 2.0), even)


def test_other_modes_wait_for_no_drive():
    waiting = {Mode.LOADING, Mode.RELEASING, Mode.PARKING}
    assert not any(overdue(mode, 1e6, DURATIONS) for mode in Mode if mode not in waiting)


def test_a_fault_stays_until_reset():
    assert after(Mode.FAULT, operator=(Operator.ENGAGE,), elapsed=1e6) is Mode.FAULT
    assert after(Mode.FAULT, operator=(Operator.RESET,)) is Mode.WAITING


def test_a_parked_platform_is_made_ready_again_by_reset_only_where_the_run_stays():
    assert after(Mode.PARKED, operator=(Operator.RESET,), stays=True) is Mode.WAITING
    assert after(Mode.PARKED, operator=(Operator.RESET,)) is Mode.PARKED
    assert after(Mode.PARKED, operator=(Operator.ENGAGE,), stays=True) is Mode.PARKED


def test_a_held_platform_is_let_go_of_by_the_operators_release_and_nothing_else():
    for operator in Operator:
        expected = Mode.FAULT if operator is Operator.RELEASE else Mode.HELD
        assert after(Mode.HELD, operator=(operator,), stop=True, finished=True, elapsed=1e6) is expected
    assert after(Mode.HELD, drive_state=states(DriveState.FAULT, DriveState.READY)) is Mode.HELD
    for state, elapsed, provable, expected in (
        (DriveState.READY, 0.2, True, Mode.UNLOADING),
        (DriveState.READY, 0.19, True, Mode.HELD),
        (DriveState.READY, 9.0, False, Mode.HELD),
        (DriveState.RUN, 9.0, True, Mode.HELD),
    ):
        found = after(
            Mode.HELD, drive_state=states(DriveState.READY, state), elapsed=elapsed, provable=provable
        )
        assert found is expected
    assert after(Mode.HELD, drive_state=states(DriveState.FAULT)) is Mode.FAULT, "there is no force"
    for mode in set(Mode) - {Mode.HELD}:
        assert after(mode, operator=(Operator.RELEASE,)) is after(mode)


NOBODY = (Fault.ESTOP, Fault.BUS, Fault.SECOND_CONTROLLER)
UNSEEN = (
    *(Fault.STALE, Fault.ENCODER, Fault.UNCERTAIN, Fault.KINEMATICS, Fault.ASSEMBLY, Fault.CONDITION),
    *(Fault.NOT_FINITE, Fault.LAW, Fault.DUPLICATE_NODE),
)
"""Where a leg is not measured, or no law can be evaluated, no brake is seen to hold."""
FOLLOW = (
    *(Fault.KINEMATICS, Fault.ASSEMBLY, Fault.CONDITION, Fault.STROKE, Fault.SPEED, Fault.FOLLOWING),
    *(Fault.NOT_FINITE, Fault.UNCERTAIN, Fault.ENCODER),
)
"""Faults that follow by themselves where a leg is not measured."""
DEFAULT = ReactionSettings()


def leads(mode, fault, reactions=DEFAULT, *, located=True, heard=True):
    ss1, sto = reactions.led_to("ss1"), reactions.led_to("sto")
    return after_fault(mode, fault, ss1, sto, located=located, heard=heard)


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault])
def test_after_each_fault_it_is_known_who_obeys_what_is_measured_what_follows_and_whether_a_brake_is_proven(
    fault,
):
    assert bool(fault & NOBODY_OBEYS) == (fault in NOBODY)
    assert bool(fault & NOT_MEASURED) == (fault in UNSEEN)
    assert bool(fault & OF_THE_POSE) == (fault in FOLLOW)
    heard_again = fault is Fault.STALE
    assert bool(fault & NO_PROOF) == (fault is Fault.BRAKE or (fault in UNSEEN and not heard_again))


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault])
@pytest.mark.parametrize("mode", Mode)
def test_a_fault_leaves_the_force_on_where_it_alone_may_hold_the_platform(mode, fault):
    match mode:
        case _ if fault in NOBODY or mode is Mode.FAULT:
            expected = Mode.FAULT
        case Mode.PARKING | Mode.UNLOADING | Mode.HELD:
            expected = Mode.HELD if fault is Fault.BRAKE or fault in UNSEEN else mode
        case Mode.IDLE | Mode.LOADING | Mode.PARKED:
            expected = Mode.HELD if fault is Fault.BRAKE else Mode.FAULT
        case Mode.WAITING:
            expected = Mode.FAULT
        case _ if fault in UNSEEN:
            expected = Mode.HELD
        case Mode.APPROACH | Mode.TRACKING | Mode.STOPPING if fault in DEFAULT.led_to("ss1"):
            expected = Mode.STOPPING
        case _:
            expected = Mode.PARKING
    assert leads(mode, fault) is expected
    assert leads(mode, fault, heard=False) is Mode.FAULT
    for lost in NOBODY:
        assert leads(mode, fault | lost) is Mode.FAULT


def test_of_several_faults_the_strongest_reaction_counts():
    assert leads(Mode.TRACKING, Fault.CERTIFICATE | Fault.SET_UP) is Mode.STOPPING
    assert leads(Mode.TRACKING, Fault.CERTIFICATE | Fault.SPEED) is Mode.PARKING
    assert leads(Mode.STOPPING, Fault.SPEED) is Mode.PARKING
    assert leads(Mode.TRACKING, Fault.CERTIFICATE | Fault.SPEED | Fault.STALE) is Mode.HELD
    off = ReactionSettings(speed="sto")
    assert leads(Mode.TRACKING, Fault.CERTIFICATE | Fault.SPEED, off) is Mode.FAULT
    assert leads(Mode.TRACKING, Fault.SPEED, ReactionSettings(speed="ss1")) is Mode.STOPPING


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("name", ["speed", "following", "drive"])
def test_a_fault_whose_reaction_is_sto_takes_the_torque_off_in_every_mode(mode, name):
    off, fault = ReactionSettings.model_validate({name: "sto"}), Fault[name.upper()]
    assert leads(mode, fault, off) is Mode.FAULT
    assert leads(mode, fault | Fault.STALE | Fault.BRAKE, off) is Mode.FAULT, "whatever else has struck"


def test_every_fault_has_a_reaction_or_none_that_could_be_chosen():
    assert Fault.STALE in DEFAULT.led_to("sbc")
    assert Fault.CERTIFICATE in DEFAULT.led_to("ss1")
    assert DEFAULT.led_to("sto") is Fault.NONE
    named = DEFAULT.led_to("ss1") | DEFAULT.led_to("sbc")
    assert {f for f in Fault if f and f not in named} == {*NOBODY, Fault.BRAKE}
    with pytest.raises(ValueError, match="ss1"):
        ReactionSettings.model_validate({"stale": "ss1"})


def test_a_drive_that_has_shut_its_brake_by_itself_does_not_keep_the_others_waiting():
    for odd, expected in (
        (DriveState.FAULT, Mode.UNLOADING),
        (DriveState.OFF, Mode.PARKING),
        (DriveState.RUN, Mode.PARKING),
    ):
        assert after(Mode.PARKING, elapsed=0.2, drive_state=states(DriveState.READY, odd)) is expected


def test_where_the_pose_was_never_found_no_force_comes_back():
    assert leads(Mode.PARKED, Fault.BRAKE, located=False) is Mode.FAULT
    assert leads(Mode.UNLOADING, Fault.BRAKE, located=False) is Mode.HELD, "its force is known"


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


OPEN = {Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING}
"""Modes with open brakes."""


@pytest.mark.parametrize("mode", Mode)
def test_of_each_mode_it_is_known_what_carries_the_platform_and_what_ends_it(mode):
    assert (mode in MOVING) == (mode in OPEN)
    assert (mode in CONTROLLED) == (mode in {*OPEN, Mode.PARKING, Mode.HELD})
    assert (mode in BRAKED) == (mode in {Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED})
    assert (mode in UNPROVEN) == (mode in {Mode.PARKING, Mode.UNLOADING, Mode.HELD})
    assert (mode in BEFORE) == (mode in {Mode.WAITING, Mode.IDLE})
    assert (mode in ENDING) == (mode in OPEN - {Mode.RELEASING})
    assert (mode in STEERED) == (mode in OPEN - {Mode.RELEASING, Mode.APPROACH})


@pytest.mark.parametrize("mode", Mode)
def test_brakes_are_open_only_while_a_law_acts(mode):
    assert drive_mode(mode) is DRIVES[mode]
