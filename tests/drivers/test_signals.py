"""Numbers in a log: states count from 0 without a gap, and each reason of a mask has one bit."""

from __future__ import annotations

import pytest

from drivers import signals

STATES = {
    signals.BusState: "UNKNOWN ACTIVE WARNING PASSIVE OFF",
    signals.DriveMode: "OFF READY RUN RESET",
    signals.DriveState: "BOOT OFF READY RUN FAULT",
    signals.Reaction: "BRAKE DAMP HOLD ZERO",
    signals.DriveFault: "NONE WATCHDOG ESTOP OVERFORCE SENSOR STROKE",
    signals.Mode: (
        "WAITING IDLE LOADING RELEASING APPROACH TRACKING STOPPING PARKING UNLOADING PARKED FAULT HELD"
    ),
    signals.Doubt: "NONE JUMP SLIP LEAP STILL SECOND EITHER",
    signals.Stop: "NONE MISSED RECORDER STRETCHED",
}
MASKS = {
    signals.Refusal: "NOT_TRACKING NOT_A_POSE STROKE CONDITION FORCE ON_THE_WAY SPEED",
    signals.Fault: (
        "STALE DRIVE BUS STROKE SPEED FOLLOWING KINEMATICS ASSEMBLY CONDITION NOT_FINITE ESTOP LAW ENCODER "
        "UNCERTAIN CERTIFICATE BRAKE SECOND_CONTROLLER DUPLICATE_NODE REFUSED_FRAMES SET_UP"
    ),
    signals.Foreign: "SYNC COMMAND CONFIG ESTOP",
    signals.Warn: (
        "STALE LATE DEGRADED FORCE_LIMIT FORCE_STEP FORCE_WINDOW REJECTED RECORDER BUS SETPOINT ENCODER "
        "SENSOR CERTIFICATE"
    ),
}


@pytest.mark.parametrize("kind", [*STATES, *MASKS], ids=lambda kind: kind.__name__)
def test_numbers_of_logged_states_and_bits_of_logged_masks_never_change(kind):
    found = {name: int(member) for name, member in kind.__members__.items()}
    if kind in STATES:
        assert found == {name: number for number, name in enumerate(STATES[kind].split())}
    else:
        assert found == {"NONE": 0} | {name: 1 << bit for bit, name in enumerate(MASKS[kind].split())}


def test_flag_for_an_invalid_encoder_is_a_bit_that_no_drive_state_uses():
    assert signals.INVALID == 8
    assert max(signals.DriveState) < signals.INVALID
