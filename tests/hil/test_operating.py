"""Operator commands that move the platform: orders, the held key, and the modes in which they apply."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.config.running import OperatorSettings
from hil.loop.jogging import Jogging
from hil.loop.motion import Motion
from hil.loop.operating import NO_KEY, Inspection, Operating
from hil.signals import Operator, Order
from hil.trajectory.move import GeodesicMove

EYE, HERE, THERE = np.eye(3), np.zeros(3), np.array([0.1, 0.0, 0.0])
START, HOLD, PARK, KEY = (
    Order(each) for each in (Operator.START, Operator.HOLD, Operator.PARK, Operator.KEY)
)


def no_jogging(rate_Hz):
    settings = OperatorSettings()
    return Jogging(settings, rate_Hz, build_platform(load("lab").platform), None, lambda *_: False)


def free(name, move):
    """Inspection of a path on which no pose is refused."""
    return Inspection(build_platform(load("lab").platform), lambda _: 0, name, move)


def made(rate_Hz=1000.0, **settings):
    operating = Operating(OperatorSettings(**settings), rate_Hz, 0.5, no_jogging(rate_Hz), free)
    motion = Motion(1.0 / rate_Hz, HERE, EYE, 0.5)
    motion.start(GeodesicMove(HERE, EYE, THERE, EYE, 60.0), 0)
    return operating, motion


def run(both, ticks, orders, mode=Mode.TRACKING):
    """Sigma (speed factor) at each tick, with orders by tick."""
    operating, motion = both
    found = []
    for tick in range(ticks):
        operating.step(orders.get(tick, ()), tick, mode, motion)
        found.append(motion.override.sigma)
    return np.array(found)


def test_hold_start_and_speed_change_the_speed_along_the_path():
    slower = Order(Operator.SPEED, (0.4,))
    sigma = run(made(), 3000, {100: [HOLD], 1000: [START], 1700: [slower], 2500: [HOLD, START]})
    assert (sigma[:101] == 1.0).all()
    assert sigma[101] < 1.0
    assert (sigma[610:1000] == 0.0).all()
    assert (sigma[1510:1700] == 1.0).all()
    np.testing.assert_array_equal(sigma[2200:], 0.4)


def test_a_speed_set_on_hold_applies_from_the_start():
    sigma = run(made(), 2000, {0: [HOLD], 900: [Order(Operator.SPEED, (0.3,))], 1000: [START]})
    assert (sigma[700:1001] == 0.0).all()
    assert sigma[-1] == 0.3


# -- the key


@pytest.mark.parametrize(("rate_Hz", "deadman_s", "ticks"), [(1000.0, 0.1, 100), (250.0, 0.05, 12)])
def test_stop_begins_deadman_s_after_the_last_frame_of_the_deadman_key(rate_Hz, deadman_s, ticks):
    operating, motion = made(rate_Hz, deadman_s=deadman_s)
    sigma = run((operating, motion), 400, {tick: [KEY] for tick in range(0, 101, 10)})
    slower = int(np.flatnonzero(sigma < 1.0)[0])
    assert slower == 100 + ticks + 1
    assert not operating.go


@pytest.mark.parametrize(
    ("deadman_s", "ticks"),
    [(0.0004, 1), (0.0019, 1), (0.002, 2), (0.1, 100), (0.0289999999995, 29), (0.0289999999985, 28)],
)
def test_deadman_key_is_valid_for_whole_ticks_and_for_at_least_one(deadman_s, ticks):
    operating, motion = made(deadman_s=deadman_s)
    assert not operating.holds_key(0)
    operating.step([KEY], 7, Mode.TRACKING, motion)
    assert [operating.holds_key(7 + n) for n in (0, ticks - 1, ticks)] == [True, True, False]


def test_deadman_key_pressed_again_moves_nothing_without_a_new_start():
    operating, motion = made(deadman_s=0.05)
    orders = {tick: [KEY] for tick in [0, *range(700, 2000, 20)]}
    assert (run((operating, motion), 2000, orders)[600:] == 0.0).all()
    operating.step([START], 2000, Mode.TRACKING, motion)
    assert operating.answers == [""]
    assert operating.go


@pytest.mark.parametrize("order", [START, PARK])
def test_start_and_park_without_the_deadman_key_are_refused(order):
    operating, motion = made(deadman_s=0.05)
    run((operating, motion), 700, {0: [KEY]})
    operating.step([order], 700, Mode.TRACKING, motion)
    assert operating.answers == [NO_KEY]
    assert not operating.go
    assert not operating.parks
    operating.step([KEY, order], 701, Mode.TRACKING, motion)
    assert operating.answers == ["", ""]


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING])
def test_releasing_the_deadman_key_holds_a_platform_on_its_way_to_park(mode):
    operating, motion = made(deadman_s=0.05)
    operating.step([KEY, PARK], 10, Mode.TRACKING, motion)
    held = []
    for tick in range(11, 700):
        operating.step([], tick, mode, motion)
        held.append(operating.go)
    assert held == [True] * 49 + [False] * 640
    assert operating.parks
    assert motion.resting


# -- where an order counts


@pytest.mark.parametrize("mode", sorted(set(Mode) - {Mode.APPROACH, Mode.TRACKING}))
def test_start_hold_and_park_are_refused_in_modes_without_motion(mode):
    operating, motion = made()
    operating.step([START, HOLD, PARK], 0, mode, motion)
    assert [mode.name in answer for answer in operating.answers] == [True] * 3
    assert operating.go
    assert not operating.parks


def test_the_operator_cannot_delay_a_controlled_stop():
    operating, motion = made(deadman_s=0.05)
    operating.key_tick = 0
    motion.stop(10, 0.5)
    run((operating, motion), 300, {100: [HOLD], 200: [START]}, Mode.STOPPING)
    assert motion.override.full, "the stop's own trajectory slows down"
    assert not motion.sample(600).twist.any()


@pytest.mark.parametrize("order", [HOLD, START])
def test_park_waits_for_rest_and_is_cancelled_by_hold_or_start(order):
    operating, motion = made()
    run((operating, motion), 700, {100: [PARK]})
    assert operating.parks
    assert operating.stays(Mode.TRACKING)
    assert motion.resting
    operating.step([order], 700, Mode.TRACKING, motion)
    assert not operating.parks


@pytest.mark.parametrize(("order", "go"), [(START, True), (HOLD, False)])
def test_hold_and_start_on_the_way_to_the_first_pose_do_not_cancel_parking(order, go):
    operating, motion = made()
    operating.go, operating.parks = not go, True
    operating.step([order], 9, Mode.STOPPING, motion)
    assert operating.answers == [""]
    assert (operating.go, operating.parks) == (go, True)


@pytest.mark.parametrize("parks", [False, True])
@pytest.mark.parametrize("go", [False, True])
@pytest.mark.parametrize("mode", Mode)
def test_mode_start_and_park_determine_operator_motion_and_whether_brakes_stay_open(mode, go, parks):
    operating = made()[0]
    operating.go, operating.parks = go, parks
    back = mode is Mode.STOPPING and parks
    assert operating.moves(mode) == (mode in {Mode.APPROACH, Mode.TRACKING} or back)
    open_in = {Mode.TRACKING: parks or not go, Mode.STOPPING: parks and not go}
    assert operating.stays(mode) == open_in.get(mode, False)
