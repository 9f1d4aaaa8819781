"""Common state of six drives: each leg counts, in either direction."""

import numpy as np
import pytest

from drivers.signals import LEGS, DriveFault, DriveState, Mode
from hil.contracts.records import record_of
from hil.loop.report import any_powered, confirmed, measured_at_rest, ready, unconfirmed
from hil.safety.motion import REST_m_s

ON_EACH_LEG = pytest.mark.parametrize("leg", range(LEGS))


def one(leg, value, others):
    """Six values with a different one for one leg."""
    return np.where(np.arange(LEGS) == leg, value, others)


def reported(leg, state, others, **columns):
    return record_of(drive_state=one(leg, state, others), **columns)


@ON_EACH_LEG
def test_drives_count_as_powered_if_at_least_one_is_powered(leg):
    for state in (DriveState.READY, DriveState.RUN):
        assert any_powered(reported(leg, state, DriveState.OFF))
    assert not any_powered(reported(leg, DriveState.FAULT, DriveState.OFF))


@ON_EACH_LEG
def test_another_drive_fault_does_not_confirm_the_emergency_stop(leg):
    stopped = record_of(drive_state=DriveState.FAULT, drive_fault=DriveFault.ESTOP)
    assert confirmed(stopped, latches=True)
    for other in set(DriveFault) - {DriveFault.ESTOP}:
        stopped["drive_fault"] = one(leg, other, DriveFault.ESTOP)
        assert unconfirmed(stopped, latches=True) == (leg,)
    stopped["drive_fault"] = one(leg, len(DriveFault), DriveFault.ESTOP)
    assert confirmed(stopped, latches=True), "the fault code of a maker does not prevent confirmation"
    off = reported(leg, DriveState.OFF, DriveState.FAULT, drive_fault=DriveFault.ESTOP)
    assert unconfirmed(off, latches=True) == (leg,)
    assert confirmed(off, latches=False)
    assert unconfirmed(reported(leg, DriveState.RUN, DriveState.OFF), latches=False) == (leg,)


@ON_EACH_LEG
def test_legs_are_not_at_rest_if_one_moves_is_silent_or_has_a_slipped_encoder(leg):
    assert measured_at_rest(record_of(age=0, rate=0.0))
    for way in (1.0, -1.0):
        assert measured_at_rest(record_of(age=0, rate=one(leg, way * 0.9 * REST_m_s, 0.0)))
        assert not measured_at_rest(record_of(age=0, rate=one(leg, way * REST_m_s, 0.0)))
    assert not measured_at_rest(record_of(age=one(leg, 1, 0), rate=0.0))
    assert not measured_at_rest(record_of(age=0, rate=0.0, legs_slipped=1 << leg))


@ON_EACH_LEG
def test_drives_are_ready_when_all_six_report_and_are_set_up(leg):
    waiting, every, but_one = Mode.WAITING, [True] * LEGS, [k != leg for k in range(LEGS)]
    assert ready(record_of(age=one(leg, 1, 0)), waiting, every, located=True)
    assert not ready(record_of(age=one(leg, 1, 0)), waiting, every, located=False)
    assert not ready(record_of(age=one(leg, 2, 0)), waiting, every, located=True)
    assert not ready(record_of(age=0), waiting, but_one, located=True)
    assert ready(record_of(age=one(leg, 9, 0)), Mode.IDLE, every, located=True), "silent drives do not block"
    assert not ready(record_of(age=0), Mode.IDLE, but_one, located=True)
    assert ready(record_of(age=0, altered=1 << leg), Mode.IDLE, but_one, located=True), "has its own fault"
