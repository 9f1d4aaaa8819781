"""Transitions of the modes."""

from __future__ import annotations

import math

import pytest

from drivers.signals import DriveMode, DriveState, Fault, Mode
from hil.config.limits import ReactionSettings
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


AT_ONCE, NO_TEST = Durations(0.0, 0.0, 0.0), Durations(0.0, 0.1, 0.2)
OFF, READY, RUN, FAILED = DriveState.OFF, DriveState.READY, DriveState.RUN, DriveState.FAULT
ENGAGE, STOP, RESET = (Operator.ENGAGE,), (Operator.STOP,), (Operator.RESET,)
TRANSITIONS = [
    # idle needs all six drives ready and off
    (Mode.WAITING, {}, Mode.IDLE),
    (Mode.WAITING, {"ready": False}, Mode.WAITING),
    (Mode.WAITING, {"drive_state": states(OFF, DriveState.BOOT)}, Mode.WAITING),
    # nothing moves without ENGAGE, nor where a drive was switched off meanwhile
    (Mode.IDLE, {"elapsed": 1e6}, Mode.IDLE),
    (Mode.IDLE, {"operator": ENGAGE}, Mode.LOADING),
    (Mode.IDLE, {"ready": False}, Mode.WAITING),
    (Mode.IDLE, {"ready": False, "operator": ENGAGE}, Mode.WAITING),
    (Mode.IDLE, {"ready": False, "operator": STOP}, Mode.PARKED),
    # brakes open with all six drives ready and the force built up: brake test, ramp
    (Mode.LOADING, {"elapsed": 0.6, "drive_state": states(READY)}, Mode.RELEASING),
    (Mode.LOADING, {"elapsed": 0.599, "drive_state": states(READY)}, Mode.LOADING),
    (Mode.LOADING, {"elapsed": 9.0, "drive_state": states(READY, OFF)}, Mode.LOADING),
    (Mode.LOADING, {"durations": AT_ONCE, "drive_state": states(READY)}, Mode.TRACKING),
    (Mode.LOADING, {"durations": AT_ONCE}, Mode.LOADING),
    # the approach waits for all six open brakes, and motions follow one another
    (Mode.RELEASING, {"elapsed": 0.1, "drive_state": states(RUN)}, Mode.APPROACH),
    (Mode.RELEASING, {"elapsed": 9.0, "drive_state": states(RUN, READY)}, Mode.RELEASING),
    (Mode.RELEASING, {"elapsed": 0.05, "drive_state": states(RUN)}, Mode.RELEASING),
    (Mode.APPROACH, {"finished": True}, Mode.TRACKING),
    (Mode.TRACKING, {"finished": True}, Mode.PARKING),
    (Mode.STOPPING, {"finished": True}, Mode.PARKING),
    # a stop that stays requested does not hold up the way to rest
    (Mode.STOPPING, {"stop": True, "finished": True}, Mode.PARKING),
    (Mode.PARKING, {"stop": True, "elapsed": 0.2, "drive_state": states(READY)}, Mode.UNLOADING),
    (Mode.UNLOADING, {"stop": True, "elapsed": 0.4}, Mode.PARKED),
    # the force stays until all six brakes are shut; a drive that has failed has shut its own
    (Mode.PARKING, {"elapsed": 0.2, "drive_state": states(READY)}, Mode.UNLOADING),
    (Mode.PARKING, {"elapsed": 0.19, "drive_state": states(READY)}, Mode.PARKING),
    (Mode.PARKING, {"elapsed": 9.0, "drive_state": states(READY, RUN)}, Mode.PARKING),
    (Mode.PARKING, {"elapsed": 0.2, "drive_state": states(READY, FAILED)}, Mode.UNLOADING),
    (Mode.PARKING, {"elapsed": 0.2, "drive_state": states(READY, OFF)}, Mode.PARKING),
    # ramp, and 0.1 s without any force; without a ramp there is no test
    (Mode.UNLOADING, {"elapsed": 0.4}, Mode.PARKED),
    (Mode.UNLOADING, {"elapsed": 0.39}, Mode.UNLOADING),
    (Mode.UNLOADING, {"durations": NO_TEST}, Mode.PARKED),
    # a fault stays until RESET, a parked platform where the run does not stay
    (Mode.FAULT, {"operator": ENGAGE, "elapsed": 1e6}, Mode.FAULT),
    (Mode.FAULT, {"operator": RESET}, Mode.WAITING),
    (Mode.PARKED, {"operator": RESET, "stays": True}, Mode.WAITING),
    (Mode.PARKED, {"operator": RESET}, Mode.PARKED),
    (Mode.PARKED, {"operator": ENGAGE, "stays": True}, Mode.PARKED),
    # a held platform is tested again at rest, and let go of where there is no force
    (Mode.HELD, {"elapsed": 0.2, "drive_state": states(READY), "provable": True}, Mode.UNLOADING),
    (Mode.HELD, {"elapsed": 0.19, "drive_state": states(READY), "provable": True}, Mode.HELD),
    (Mode.HELD, {"elapsed": 9.0, "drive_state": states(READY)}, Mode.HELD),
    (Mode.HELD, {"elapsed": 9.0, "drive_state": states(READY, RUN), "provable": True}, Mode.HELD),
    (Mode.HELD, {"drive_state": states(FAILED, READY)}, Mode.HELD),
    (Mode.HELD, {"drive_state": states(FAILED)}, Mode.FAULT),
]


@pytest.mark.parametrize(("mode", "facts", "expected"), TRANSITIONS)
def test_mode_changes_with_drive_states_operator_commands_and_time_as_specified(mode, facts, expected):
    assert after(mode, **facts) is expected


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
def test_a_stop_leads_to_rest_from_every_mode(mode):
    assert after(mode, operator=(Operator.STOP,)) is STOPPED[mode]
    assert after(mode, stop=True) is STOPPED[mode]


def test_mode_that_waits_for_a_drive_waits_one_extra_second():
    even = Durations(load=0.25, release=0.5, close=0.125)
    for mode, least in ((Mode.LOADING, 0.5), (Mode.RELEASING, 0.5), (Mode.PARKING, 0.125)):
        assert not overdue(mode, least + 1.0, even)
        assert overdue(mode, math.nextafter(least + 1.0, 2.0), even)


def test_modes_other_than_loading_releasing_and_parking_never_wait_for_a_drive():
    waiting = {Mode.LOADING, Mode.RELEASING, Mode.PARKING}
    assert not any(overdue(mode, 1e6, DURATIONS) for mode in Mode if mode not in waiting)


def test_only_the_operators_release_ends_the_held_mode():
    for operator in Operator:
        expected = Mode.FAULT if operator is Operator.RELEASE else Mode.HELD
        assert after(Mode.HELD, operator=(operator,), stop=True, finished=True, elapsed=1e6) is expected
    for mode in set(Mode) - {Mode.HELD}:
        assert after(mode, operator=(Operator.RELEASE,)) is after(mode)


NOBODY = (Fault.ESTOP, Fault.BUS, Fault.SECOND_CONTROLLER)
UNSEEN = (
    *(Fault.STALE, Fault.ENCODER, Fault.UNCERTAIN, Fault.KINEMATICS, Fault.ASSEMBLY, Fault.CONDITION),
    *(Fault.NOT_FINITE, Fault.LAW, Fault.DUPLICATE_NODE),
)
"""Without measurement of a leg, or without a law, no brake can be proven."""
FOLLOW = (
    *(Fault.KINEMATICS, Fault.ASSEMBLY, Fault.CONDITION, Fault.STROKE, Fault.SPEED, Fault.FOLLOWING),
    *(Fault.NOT_FINITE, Fault.UNCERTAIN, Fault.ENCODER),
)
"""Faults that follow by themselves if a leg is not measured."""
DEFAULT = ReactionSettings()


def leads(mode, fault, reactions=DEFAULT, *, located=True, heard=True):
    ss1, sto = reactions.led_to("ss1"), reactions.led_to("sto")
    return after_fault(mode, fault, ss1, sto, located=located, heard=heard)


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault])
def test_each_fault_belongs_to_the_right_fault_groups(
    fault,
):
    assert bool(fault & NOBODY_OBEYS) == (fault in NOBODY)
    assert bool(fault & NOT_MEASURED) == (fault in UNSEEN)
    assert bool(fault & OF_THE_POSE) == (fault in FOLLOW)
    heard_again = fault is Fault.STALE
    assert bool(fault & NO_PROOF) == (fault is Fault.BRAKE or (fault in UNSEEN and not heard_again))


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault])
@pytest.mark.parametrize("mode", Mode)
def test_fault_keeps_the_leg_forces_if_only_they_may_carry_the_platform(mode, fault):
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
def test_a_fault_with_reaction_sto_removes_the_force_in_every_mode(mode, name):
    off, fault = ReactionSettings.model_validate({name: "sto"}), Fault[name.upper()]
    assert leads(mode, fault, off) is Mode.FAULT
    assert leads(mode, fault | Fault.STALE | Fault.BRAKE, off) is Mode.FAULT, "sto has priority"


def test_every_fault_has_a_reaction_unless_it_is_fixed():
    assert Fault.STALE in DEFAULT.led_to("sbc")
    assert Fault.CERTIFICATE in DEFAULT.led_to("ss1")
    assert DEFAULT.led_to("sto") is Fault.NONE
    named = DEFAULT.led_to("ss1") | DEFAULT.led_to("sbc")
    assert {f for f in Fault if f and f not in named} == {*NOBODY, Fault.BRAKE}
    with pytest.raises(ValueError, match="ss1"):
        ReactionSettings.model_validate({"stale": "ss1"})


def test_brake_fault_after_parking_restores_no_force_without_a_known_pose():
    assert leads(Mode.PARKED, Fault.BRAKE, located=False) is Mode.FAULT
    assert leads(Mode.UNLOADING, Fault.BRAKE, located=False) is Mode.HELD, "the last force needs no pose"


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
def test_each_mode_belongs_to_the_right_mode_groups(mode):
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
