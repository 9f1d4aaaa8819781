"""What the operator lets the platform do: orders, the key, and where each counts."""

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.config.operator import OperatorSettings
from hil.loop.jogging import Jogging
from hil.loop.motion import Motion
from hil.loop.operating import Operating
from hil.loop.setup_moves import Inspection, at_setup_speed
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
    """A way on which nothing is refused."""
    return Inspection(build_platform(load("lab").platform), lambda _: 0, name, move)


def made(rate_Hz=1000.0, **settings):
    operating = Operating(OperatorSettings(**settings), rate_Hz, 0.5, no_jogging(rate_Hz), free)
    motion = Motion(1.0 / rate_Hz, HERE, EYE, 0.5)
    motion.start(GeodesicMove(HERE, EYE, THERE, EYE, 60.0), 0)
    return operating, motion


def run(both, ticks, orders, mode=Mode.TRACKING):
    """Sigma of each tick, with orders by tick."""
    operating, motion = both
    found = []
    for tick in range(ticks):
        operating.step(orders.get(tick, ()), tick, mode, motion)
        found.append(motion.override.sigma)
    return np.array(found)


def test_without_orders_nothing_is_slower():
    assert (run(made(), 1000, {}) == 1.0).all()


def test_hold_start_and_speed():
    sigma = run(
        made(),
        3000,
        {100: [HOLD], 1000: [START], 1700: [Order(Operator.SPEED, (0.4,))], 2500: [HOLD, START]},
    )
    assert (sigma[:101] == 1.0).all()
    assert sigma[101] < 1.0
    assert (sigma[610:1000] == 0.0).all()
    assert (sigma[1510:1700] == 1.0).all()
    np.testing.assert_array_equal(sigma[2200:], 0.4)


def test_a_speed_that_is_set_on_hold_counts_from_the_start():
    sigma = run(made(), 2000, {0: [HOLD], 900: [Order(Operator.SPEED, (0.3,))], 1000: [START]})
    assert (sigma[700:1001] == 0.0).all()
    assert sigma[-1] == 0.3


@pytest.mark.parametrize(
    ("rate_Hz", "deadman_s", "ticks"), [(1000.0, 0.1, 100), (500.0, 0.1, 50), (250.0, 0.05, 12)]
)
def test_the_stop_begins_that_many_ticks_after_the_last_key_frame(rate_Hz, deadman_s, ticks):
    operating, motion = made(rate_Hz, deadman_s=deadman_s)
    sigma = run((operating, motion), 400, {tick: [KEY] for tick in range(0, 101, 10)})
    slower = int(np.flatnonzero(sigma < 1.0)[0])
    assert slower == 100 + ticks + 1
    assert not operating.go


def test_keys_that_come_again_move_nothing_without_a_new_start():
    operating, motion = made(deadman_s=0.05)
    orders = {tick: [KEY] for tick in [0, *range(700, 2000, 20)]}
    assert (run((operating, motion), 2000, orders)[600:] == 0.0).all()
    operating.step([START], 2000, Mode.TRACKING, motion)
    assert operating.answers == [""]
    assert operating.go


def test_a_start_without_the_key_is_refused():
    operating, motion = made(deadman_s=0.05)
    run((operating, motion), 100, {})
    operating.step([START], 100, Mode.TRACKING, motion)
    assert operating.answers[0].startswith("the key is not held")
    operating.step([KEY, START], 101, Mode.TRACKING, motion)
    assert operating.answers == ["", ""]


@pytest.mark.parametrize("mode", sorted(set(Mode) - {Mode.APPROACH, Mode.TRACKING}))
def test_where_nothing_moves_there_is_nothing_to_start_hold_or_park(mode):
    operating, motion = made()
    operating.step([START, HOLD, PARK], 0, mode, motion)
    assert all(mode.name in answer for answer in operating.answers)
    assert len(operating.answers) == 3
    assert operating.go
    assert not operating.parks
    operating.step([], 1, mode, motion)
    assert operating.answers == []


def test_a_controlled_stop_is_not_the_operators_to_hold_up():
    operating, motion = made(deadman_s=0.05)
    operating.key_tick = 0
    motion.stop(10, 0.5)
    run((operating, motion), 300, {100: [HOLD], 200: [START]}, Mode.STOPPING)
    assert motion.override.full, "the stop's own trajectory slows down"
    assert not motion.sample(600).twist.any()


def test_park_waits_for_rest_and_hold_takes_it_back():
    operating, motion = made()
    run((operating, motion), 700, {100: [PARK]})
    assert operating.parks
    assert operating.stays(Mode.TRACKING)
    assert motion.resting
    operating.step([HOLD], 700, Mode.TRACKING, motion)
    assert not operating.parks


def test_the_way_back_is_nowhere_faster_than_the_set_up_speed():
    operating, motion = made(setup_speed_m_s=0.02, setup_speed_deg_s=3.0)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    here = motion.sample(0)
    for there, limit, part in (
        (here._replace(p=np.array([0.03, 0.04, 0.0])), 0.02, slice(3)),
        (here._replace(R=turned), np.deg2rad(3.0), slice(3, 6)),
    ):
        back = at_setup_speed(operating.settings, 0.5, there, here)
        speeds = [
            float(np.linalg.norm(back.sample(t).twist[part])) for t in np.linspace(0, back.duration_s, 1001)
        ]
        assert max(speeds) == pytest.approx(limit, rel=1e-6)
    assert at_setup_speed(operating.settings, 0.5, here._replace(p=here.p + 1e-6), here).duration_s == 0.5
