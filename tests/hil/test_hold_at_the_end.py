"""A hold is kept where the motion ends in the meantime: brakes open, no fault, until the operator goes on."""

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Mode
from hil.app.compose import build_cycle
from hil.config.operator import OperatorSettings
from hil.contracts.records import record_of
from hil.loop.cycle import REST_PATIENCE_S, Cycle
from hil.signals import Operator, Order
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.move import GeodesicMove
from tests.hil.cycle_bench import VIRTUAL, ticked
from tests.hil.test_operating import HOLD, KEY, PARK, START

END = 400
"""The tick at which the motion ends unless it is held."""
LATE = END - 20


def under_way(mode: Mode, stop_s: float, deadman_s: float | None = None) -> Cycle:
    """On the path, or on the way back to the first pose, a tenth of a metre long."""
    engage = VIRTUAL.engage.model_copy(update={"stop_s": stop_s})
    operator = OperatorSettings(deadman_s=deadman_s, setup_speed_m_s=0.5)
    cycle = build_cycle(VIRTUAL.model_copy(update={"engage": engage, "operator": operator}), 1000.0, 0.01)
    p, R = cycle.parts.home_p, cycle.parts.home_R
    cycle.motion.start(GeodesicMove(p, R, p + np.array([0.0, 0.0, 0.1]), R, 1e-3 * END), 0)
    cycle.operating.parks = mode is Mode.STOPPING
    cycle.mode = mode
    return cycle


def held(cycle: Cycle, first: int, last: int, *orders: Order) -> None:
    """Tick on while the platform has to stay as it is, with orders in the first tick."""
    mode = cycle.mode
    for number in range(first, last):
        ticked(cycle, number, orders=orders if number == first else ())
        assert (cycle.mode, cycle.faults) == (mode, Fault.NONE), number


@pytest.mark.parametrize("stop_s", [0.5, 4.0])
@pytest.mark.parametrize("mode", [Mode.TRACKING, Mode.STOPPING])
def test_a_hold_just_before_the_end_is_kept_until_start_which_parks(mode, stop_s):
    cycle = under_way(mode, stop_s)
    held(cycle, 1, LATE)
    held(cycle, LATE, 6000, HOLD)
    assert cycle.motion.finished(6000)
    assert cycle.motion.resting
    ticked(cycle, 6000, orders=(START,))
    assert (cycle.mode, cycle.faults) == (Mode.PARKING, Fault.NONE)


@pytest.mark.parametrize("mode", [Mode.TRACKING, Mode.STOPPING])
def test_a_key_that_is_let_go_just_before_the_end_is_a_hold_too(mode):
    cycle = under_way(mode, 0.5, deadman_s=0.01)
    cycle.operating.key_tick = LATE
    cycle.operating.speed = 1.0
    for number in range(1, LATE + 1):
        ticked(cycle, number, orders=(KEY,))
    held(cycle, LATE + 1, 2000)
    held(cycle, 2000, 2001, KEY)
    ticked(cycle, 2001, orders=(KEY, START))
    assert cycle.mode is Mode.PARKING


def test_legs_that_shake_at_the_start_after_such_a_hold_have_their_time_to_come_to_rest():
    cycle = under_way(Mode.TRACKING, 4.0)
    held(cycle, 1, LATE)
    held(cycle, LATE, 6000, HOLD)
    cycle.operating.step((START,), 6000, cycle.mode, cycle.motion)
    rows = record_of(drive_state=int(DriveState.RUN), dq=np.full(6, 0.1), J=np.eye(6))
    for number in range(6001, 6000 + round(1000 * REST_PATIENCE_S)):
        cycle.operating.step((), number, cycle.mode, cycle.motion)
        rows["tick"] = number
        assert not cycle._restless(rows)
        assert not cycle._finished(rows)


def parks(cycle: Cycle, first: int) -> list[Mode]:
    """Tick on until the brakes shut, without a fault; the modes on the way there."""
    modes: list[Mode] = []
    for number in range(first, first + 8000):
        ticked(cycle, number)
        assert not cycle.faults
        if cycle.mode is Mode.PARKING:
            return modes
        modes.append(cycle.mode)
    raise AssertionError(f"it stays in {cycle.mode}")


@pytest.mark.parametrize("word", ["stop", "park"])
def test_on_a_hold_at_the_end_stop_parks_there_and_park_at_the_first_pose(word):
    cycle = under_way(Mode.TRACKING, 0.5)
    held(cycle, 1, LATE)
    held(cycle, LATE, 2000, HOLD)
    ticked(cycle, 2000, *[Operator.STOP] * (word == "stop"), orders=(PARK,) * (word == "park"))
    modes = parks(cycle, 2001)
    rise = cycle.motion.sample(9999).p[2] - cycle.parts.home_p[2]
    if word == "stop":
        assert len(modes) <= 1
        assert rise == pytest.approx(0.1)
    else:
        assert set(modes) == {Mode.TRACKING, Mode.STOPPING}
        np.testing.assert_allclose(cycle.motion.sample(9999).p, cycle.first.p, atol=1e-12)


@pytest.mark.parametrize("word", [START, PARK])
def test_a_hold_just_before_the_end_of_the_way_back_to_the_path_is_no_fault(word):
    cycle = under_way(Mode.TRACKING, 2.5)
    motion, operating = cycle.motion, cycle.operating
    p, R = cycle.parts.home_p, cycle.parts.home_R
    held(cycle, 1, 100)
    operating.go = False
    motion.settle(100, 0.0)
    motion.leave(HoldTrajectory(p + np.array([0.01, 0.0, 0.0]), R), 100)
    held(cycle, 100, 101, START)
    number = 101
    while not (motion.override.full and motion.time(number) > 2.45):
        held(cycle, number, number + 1)
        number += 1
    assert motion.trajectory.duration_s == pytest.approx(2.5)
    held(cycle, number, number + 3000, HOLD)
    assert motion.time(number + 3000) > 2.5 + REST_PATIENCE_S
    held(cycle, number + 3000, number + 3001, word)
    parks(cycle, number + 3001)
