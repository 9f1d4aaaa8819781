"""What six drives say together: each leg counts, in either direction."""

import numpy as np
import pytest

from drivers.compiled.compiler import kernel, record
from drivers.signals import LEGS, DriveFault, DriveState, Mode
from drivers.tick_columns import TICK
from hil.contracts.records import record_of
from hil.loop.compiled_pass import all_free
from hil.loop.drives_say import any_powered, confirmed, measured_at_rest, ready, unconfirmed
from hil.safety.motion import REST_m_s


def one(leg, value, others):
    """Return six values, that of one leg different."""
    return np.where(np.arange(LEGS) == leg, value, others)


def said(leg, state, others, **columns):
    return record_of(drive_state=one(leg, state, others), **columns)


@pytest.mark.parametrize("leg", range(LEGS))
def test_the_brakes_are_open_when_the_last_of_six_is(leg):
    free = kernel(record(TICK, "drive_state"))(all_free)
    assert free(record_of(drive_state=DriveState.RUN))
    assert not free(said(leg, DriveState.READY, DriveState.RUN))
    assert not free(said(leg, DriveState.RUN, DriveState.READY))


@pytest.mark.parametrize("leg", range(LEGS))
@pytest.mark.parametrize("state", [DriveState.READY, DriveState.RUN])
def test_one_powered_drive_is_enough(leg, state):
    assert any_powered(said(leg, state, DriveState.OFF))
    assert not any_powered(said(leg, DriveState.FAULT, DriveState.OFF))


@pytest.mark.parametrize("leg", range(LEGS))
def test_a_drive_that_failed_for_another_reason_has_not_confirmed_the_emergency_stop(leg):
    stopped = record_of(drive_state=DriveState.FAULT, drive_fault=DriveFault.ESTOP)
    assert confirmed(stopped, latches=True)
    for other in set(DriveFault) - {DriveFault.ESTOP}:
        stopped["drive_fault"] = one(leg, other, DriveFault.ESTOP)
        assert unconfirmed(stopped, latches=True) == (leg,)
    stopped["drive_fault"] = one(leg, len(DriveFault), DriveFault.ESTOP)
    assert confirmed(stopped, latches=True), "a code of its maker"
    off = said(leg, DriveState.OFF, DriveState.FAULT, drive_fault=DriveFault.ESTOP)
    assert unconfirmed(off, latches=True) == (leg,)
    assert confirmed(off, latches=False)
    assert unconfirmed(said(leg, DriveState.RUN, DriveState.OFF), latches=False) == (leg,)


@pytest.mark.parametrize("leg", range(LEGS))
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_leg_that_moves_either_way_is_not_at_rest(leg, way):
    assert measured_at_rest(record_of(age=0, rate=0.0))
    assert measured_at_rest(record_of(age=0, rate=one(leg, way * 0.9 * REST_m_s, 0.0)))
    assert not measured_at_rest(record_of(age=0, rate=one(leg, way * REST_m_s, 0.0)))


@pytest.mark.parametrize("leg", range(LEGS))
def test_a_leg_that_is_not_heard_or_not_believed_is_not_known_to_be_at_rest(leg):
    assert not measured_at_rest(record_of(age=one(leg, 1, 0), rate=0.0))
    assert not measured_at_rest(record_of(age=0, rate=0.0, legs_slipped=1 << leg))


@pytest.mark.parametrize("leg", range(LEGS))
def test_ready_needs_all_six_heard_lately_and_all_set_up(leg):
    waiting = Mode.WAITING
    assert ready(record_of(age=one(leg, 1, 0)), waiting, [True] * LEGS, located=True)
    assert not ready(record_of(age=one(leg, 1, 0)), waiting, [True] * LEGS, located=False)
    assert not ready(record_of(age=one(leg, 2, 0)), waiting, [True] * LEGS, located=True)
    assert not ready(record_of(age=0), waiting, [k != leg for k in range(LEGS)], located=True)


@pytest.mark.parametrize("leg", range(LEGS))
def test_in_idle_a_drive_that_is_to_be_set_up_again_is_waited_for_and_one_that_was_altered_faults(leg):
    others = [k != leg for k in range(LEGS)]
    assert ready(record_of(age=one(leg, 9, 0)), Mode.IDLE, [True] * LEGS, located=True), (
        "not heard: it may come"
    )
    assert not ready(record_of(age=0), Mode.IDLE, others, located=True)
    assert ready(record_of(age=0, altered=1 << leg), Mode.IDLE, others, located=True)
