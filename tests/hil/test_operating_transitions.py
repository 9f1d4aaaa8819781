"""What the operator allowed, carried from one motion to the next: engagement, entry, stop, and the look ahead."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode
from hil.loop.motion import Motion
from hil.loop.operating import NO_KEY
from hil.signals import Operator, Order
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.override import Override
from tests.hil.motions import ahead
from tests.hil.test_operating import EYE, HERE, HOLD, KEY, PARK, START, made, run

T = 1e-3
SLOW = Order(Operator.SPEED, (0.4,))


def test_a_reset_forgets_every_order_the_key_the_ways_back_and_the_jog():
    operating: Any = made(deadman_s=0.05)[0]
    told: list[str] = []
    operating.jogging = SimpleNamespace(reset=lambda: told.append("jogging"))
    names = ("go", "speed", "parks", "_way_back", "_inspection", "trouble", "key_tick", "answers")
    for name in names:
        setattr(operating, name, "of the run before")
    operating.reset()
    assert [getattr(operating, name) for name in names] == [True, 1.0, False, None, None, "", None, []]
    assert told == ["jogging"]


@pytest.mark.parametrize("parks", [False, True])
@pytest.mark.parametrize("mode", Mode)
def test_the_operator_moves_the_platform_on_its_way_and_on_the_way_back_that_he_asked_for(mode, parks):
    operating = made()[0]
    operating.parks = parks
    back = mode is Mode.STOPPING and parks
    assert operating.moves(mode) == (mode in {Mode.APPROACH, Mode.TRACKING} or back)


@pytest.mark.parametrize(("go", "parks"), [(False, False), (False, True), (True, False), (True, True)])
@pytest.mark.parametrize("mode", Mode)
def test_at_the_end_of_a_motion_the_brakes_stay_open_on_hold_and_before_the_way_back(mode, go, parks):
    operating = made()[0]
    operating.go, operating.parks = go, parks
    open_in = {Mode.TRACKING: parks or not go, Mode.STOPPING: parks and not go}
    assert operating.stays(mode) == open_in.get(mode, False)


@pytest.mark.parametrize(
    ("deadman_s", "ticks"),
    [
        (0.0004, 1),
        (0.001, 1),
        (0.0019, 1),
        (0.002, 2),
        (0.003, 3),
        (0.1, 100),
        (0.0289999999995, 29),
        (0.0289999999985, 28),
    ],
)
def test_a_key_counts_as_held_for_the_whole_ticks_of_its_time_and_for_one_at_least(deadman_s, ticks):
    operating, motion = made(deadman_s=deadman_s)
    assert not operating.holds_key(0)
    operating.step([KEY], 7, Mode.TRACKING, motion)
    assert [operating.holds_key(7 + n) for n in (0, ticks - 1, ticks, ticks + 1)] == [
        True,
        True,
        False,
        False,
    ]


def test_a_key_frame_in_every_tick_holds_a_key_that_is_shorter_than_a_tick():
    operating, motion = made(deadman_s=0.0004)
    sigma = run((operating, motion), 200, {tick: [KEY] for tick in range(101)})
    assert (sigma[:102] == 1.0).all()
    assert sigma[103] < 1.0


@pytest.mark.parametrize(("key_tick", "sigma"), [(90, 0.4), (40, 0.0), (None, 0.0)])
def test_a_motion_begins_at_the_speed_asked_for_and_without_the_key_not_at_all(key_tick, sigma):
    operating, motion = made(deadman_s=0.05)
    operating.step([SLOW], 99, Mode.IDLE, motion)
    operating.key_tick, operating.parks = key_tick, True
    operating.engage(100, motion)
    assert motion.override.sigma == sigma
    assert operating.go == (sigma > 0.0)
    assert not operating.parks, "of the motion before"


@pytest.mark.parametrize(("key_tick", "go"), [(90, True), (40, False)])
def test_the_path_begins_with_the_key_only(key_tick, go):
    operating, motion = made(deadman_s=0.05)
    operating.key_tick = key_tick
    operating.enter(Mode.TRACKING, 100, motion)
    assert operating.go is go
    assert motion.override.sigma == float(go)


def test_a_hold_in_the_approach_holds_at_the_start_of_the_path():
    operating, motion = made()
    operating.step([HOLD], 50, Mode.APPROACH, motion)
    operating.enter(Mode.TRACKING, 51, motion)
    assert not operating.go
    assert motion.resting


def test_a_start_on_the_path_takes_a_park_back_and_on_the_way_back_it_does_not():
    for mode, parks in ((Mode.TRACKING, False), (Mode.STOPPING, True)):
        operating, motion = made()
        operating.step([PARK], 10, Mode.TRACKING, motion)
        operating.step([START], 20, mode, motion)
        assert operating.parks is parks
        assert operating.go


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING])
def test_a_key_that_is_let_go_of_holds_a_platform_that_is_to_park_wherever_it_is_on_its_way(mode):
    operating, motion = made(deadman_s=0.05)
    operating.step([KEY, PARK], 10, Mode.TRACKING, motion)
    held = []
    for tick in range(11, 700):
        operating.step([], tick, mode, motion)
        held.append(operating.go)
    assert held == [True] * 49 + [False] * 640
    assert operating.parks
    assert motion.resting


def test_a_park_without_the_key_is_refused_and_moves_nothing():
    operating, motion = made(deadman_s=0.05)
    run((operating, motion), 700, {0: [KEY]})
    operating.step([PARK], 700, Mode.TRACKING, motion)
    assert operating.answers == [NO_KEY]
    assert not operating.go
    assert not operating.parks


def test_a_speed_that_is_set_at_once_changes_no_more():
    override = Override(T, 0.5)
    override.aim(0, 0.0)
    override.advance(200)
    assert override.dsigma < 0.0
    override.settle(200, 0.0)
    assert override.resting
    before = override.time(200)
    override.advance(300)
    assert override.time(300) == before


def test_a_path_begins_at_the_speed_that_there_was():
    override = Override(T, 0.5)
    override.settle(0, 0.3)
    override.begin(100)
    assert (override.sigma, override.target) == (0.3, 0.3)
    assert override.time(110) == pytest.approx(0.3 * 10 * T)


@pytest.mark.parametrize("tick", [30, 100, 250, 400, 490])
def test_the_look_ahead_while_the_speed_changes_is_where_path_time_gets_to(tick):
    h = 2 * T
    motion, later = made()[1], made()[1]
    for each, until in ((motion, tick), (later, tick + 2)):
        each.aim(0, 0.0, go=True)
        each.advance(until)
    s, sigma, dsigma = motion.override.ahead(tick, h)
    curvature = 4.5 / 0.5**2
    assert s == pytest.approx(later.time(tick + 2), abs=curvature * h**3 / 6 + 1e-15)
    assert sigma == pytest.approx(later.override.sigma, abs=curvature * h**2 / 2 + 1e-15)
    assert dsigma == pytest.approx(later.override.dsigma, abs=curvature * h + 1e-15)
    seen, _ = ahead(motion, tick, h)
    there = later.sample(tick + 2)
    np.testing.assert_allclose(seen.p, there.p, atol=1e-9)
    np.testing.assert_allclose(seen.twist, there.twist, atol=1e-6)


def test_a_live_reference_has_the_clock_s_time_whatever_the_speed_before():
    motion = made()[1]
    motion.settle(10, 0.2)
    motion.start(LiveTrajectory(np.zeros(6), np.ones((3, 6)), T), 20)
    assert motion.override.full


def test_a_stop_on_hold_is_at_its_end_at_once():
    motion = Motion(T, HERE, EYE, 0.5)
    motion.settle(10, 0.0)
    motion.stop(20, 0.5)
    assert motion.finished(20)
