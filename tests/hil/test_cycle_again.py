"""A second time in one cycle: what a stop, a RESET and a fault leave behind does not act on what follows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Mode, Refusal, Stop
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load, loads
from hil.config.reference import LiveReference
from hil.contracts.records import record_of
from hil.loop.cycle import Cycle
from hil.loop.ramps import tau_at_rest
from hil.signals import Operator, Order, SetPoint
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import PoseSample
from tests.hil.control.test_pid import pid
from tests.hil.test_cycle import Bench, held_to
from tests.live_reference import LIVE_REFERENCE

VIRTUAL = load("virtual")
BRISK = VIRTUAL.engage.model_copy(
    update={"force_ramp_s": 0.02, "brake_release_s": 0.005, "brake_close_s": 0.005, "blend_s": 0.05}
)
LIVE = LiveReference.model_validate(LIVE_REFERENCE)
HIGHER = (0.0, 0.0, 1.02, 0.0, 0.0, 0.0)


def a_bench(**changes: Any) -> Bench:
    """A bench that is quickly under way."""
    return Bench(VIRTUAL.model_copy(update={"engage": BRISK} | changes))


# -- a stop on the way back to the first pose


def on_the_way_back(speed: float) -> Cycle:
    """Parking: a tenth of a metre to go, at a share of the speed."""
    cycle = build_cycle(VIRTUAL, 1000.0, 0.01)
    parts, motion, operating = cycle.parts, cycle.motion, cycle.operating
    here = parts.home_p + np.array([0.0, 0.0, 0.1])
    motion.start(GeodesicMove(here, parts.home_R, parts.home_p, parts.home_R, 1.0), 0)
    motion.settle(0, speed)
    operating.go = operating.parks = True
    operating.speed = speed
    cycle.mode = Mode.STOPPING
    return cycle


def ticked(cycle: Cycle, number: int, *operator: Operator, orders: tuple[Order, ...] = ()) -> None:
    """What a tick with all drives in RUN and the legs at rest makes of orders and of the mode."""
    inp: Any = SimpleNamespace(tick=number, operator=operator)
    cycle.operating.step(orders, number, cycle.mode, cycle.motion)
    home = {"p": cycle.parts.home_p, "R": cycle.parts.home_R}
    cycle._change_mode(inp, record_of(tick=number, drive_state=int(DriveState.RUN), J=np.eye(6), **home))


@pytest.mark.parametrize("speed", [1.0, 0.5])
@pytest.mark.parametrize("cause", ["the operator", "safety", "a fault"])
def test_a_stop_on_the_way_back_stands_whoever_asked_for_it_and_whatever_is_said_after(cause, speed):
    cycle = on_the_way_back(speed)
    for number in range(1, 300):
        ticked(cycle, number)
    assert cycle.mode_tick == 0
    if cause == "safety":
        cycle.stop_requested = Stop.MISSED
    if cause == "a fault":
        cycle.faults = Fault.CERTIFICATE
        assert cycle._under_control & Fault.CERTIFICATE, "it leads to a stop"
    begun = cycle.motion.sample(300).p[2]
    ticked(cycle, 300, *[Operator.STOP] * (cause == "the operator"))
    assert (cycle.mode, cycle.mode_tick) == (Mode.STOPPING, 300)
    heights = []
    for number in range(301, 1200):
        said = Order(Operator.START), Order(Operator.KEY), Order(Operator.SPEED, (1.0,))
        ticked(cycle, number, orders=said)
        if cycle.mode is not Mode.STOPPING:
            break
        assert cycle.mode_tick == 300, "it begins once"
        heights.append(cycle.motion.sample(number).p[2])
    assert cycle.mode is Mode.PARKING
    assert number <= 300 + 1.34 * 1000.0 * VIRTUAL.engage.stop_s
    assert np.diff(heights).max() <= 1e-12, "it goes on, and comes to rest"
    assert cycle.parts.home_p[2] + 0.01 < heights[-1] < begun


def on_the_path(text: str) -> Cycle:
    """Half-way along a straight path of 20 mm/s that begins at home."""
    cycle = build_cycle(loads(text), 1000.0, 0.01)
    parts = cycle.parts
    there = parts.home_p + np.array([0.0, 0.0, 0.1])
    cycle.motion.start(GeodesicMove(parts.home_p, parts.home_R, there, parts.home_R, 10.0), 0)
    cycle.mode = Mode.TRACKING
    return cycle


KEYED = VIRTUAL.text.replace("\nreference: ", "\noperator: {deadman_s: 0.1}\n\nreference: ")
KEY, PARK, START = Order(Operator.KEY), Order(Operator.PARK), Order(Operator.START)


def test_the_way_back_begins_where_the_reference_rests_and_its_rates_do_not_jump():
    cycle = on_the_path(VIRTUAL.text)
    rates = []
    for number in range(5000, 7000):
        resting = cycle.motion.resting
        ticked(cycle, number, orders=(PARK,) * (number == 5000))
        rates.append(cycle.motion.sample(number).twist[2])
        if cycle.mode is not Mode.TRACKING:
            break
        assert cycle.mode_tick == 0
    assert cycle.mode is Mode.STOPPING
    assert resting
    assert number - 5000 > 1000.0 * VIRTUAL.engage.stop_s
    assert rates[0] > 0.01
    assert np.abs(np.diff(rates)).max() < 2.0 * 1.5 / VIRTUAL.engage.stop_s * 0.02 * 1e-3


def test_without_the_key_the_way_back_does_not_begin():
    cycle = on_the_path(KEYED)
    for number in range(5000, 7500):
        said = (*(KEY,) * (number < 5100), *(PARK,) * (number == 5000))
        ticked(cycle, number, orders=said)
        assert cycle.mode is Mode.TRACKING
    assert cycle.motion.resting
    assert not cycle.operating.go
    for number in range(7500, 9000):
        ticked(cycle, number, orders=(KEY, PARK) if number == 7500 else (KEY,))
        if cycle.mode is not Mode.TRACKING:
            break
    assert cycle.mode is Mode.STOPPING


# -- armed a second time


@pytest.fixture(scope="module")
def live() -> Cycle:
    return build_cycle(VIRTUAL.model_copy(update={"reference": LIVE}), 1000.0, 0.01)


@pytest.mark.parametrize(("before", "mode"), [(Mode.RELEASING, Mode.APPROACH), (Mode.LOADING, Mode.TRACKING)])
def test_a_live_reference_that_is_armed_again_begins_at_its_start_and_follows_set_points(live, before, mode):
    live.reset()
    steering: Any = live.parts.steering
    trajectory = steering.trajectory
    steering.take([SetPoint(*HIGHER)], tracking=True)
    trajectory.advance(200, steering.judge)
    trajectory.brake()
    steering.take([], tracking=False)
    trajectory.advance(600, steering.judge)
    assert trajectory.sample(0.0).p[2] > 1.005
    assert trajectory.duration_s is not None
    live.mode = before
    live._enter(mode, record_of(tick=1000, p=live.parts.home_p, R=np.eye(3), J=np.eye(6)))
    np.testing.assert_array_equal(trajectory.sample(0.0).p, live.parts.home_p)
    assert trajectory.duration_s is None, "no end of its own"
    steering.take([SetPoint(*HIGHER)], tracking=True)
    trajectory.advance(1, steering.judge)
    steering.take([], tracking=True)
    trajectory.advance(2000, steering.judge)
    np.testing.assert_allclose(trajectory.sample(0.0).p, HIGHER[:3], atol=1e-12)


def test_a_set_point_after_park_is_refused():
    bench = a_bench(reference=LIVE)
    bench.until(Mode.TRACKING)
    point = (SetPoint(*HIGHER),)
    assert not bench.step(setpoints=point).row["setpoint_refusal"]
    bench.step(orders=(Order(Operator.PARK),))
    counts = []
    for _ in range(3):
        row = bench.step(setpoints=point).row
        counts.append((int(row["setpoints_taken"]), int(row["setpoint_refusal"])))
    assert counts == [(1, Refusal.NOT_TRACKING)] * 3
    assert bench.cycle.operating.parks


# -- after a RESET


def test_brakes_that_opened_are_not_proven_by_a_reset_and_a_stop():
    bench = a_bench()
    bench.until(Mode.APPROACH)
    assert bench.cycle.durations.load > 0.0
    modes = []
    for operator in ((), (Operator.RESET,), (Operator.STOP,)):
        bench.step(operator, bus_off=not operator)
        modes.append(bench.cycle.mode)
        assert not bench.cycle.proven
    assert modes == [Mode.FAULT, Mode.WAITING, Mode.PARKED]


def test_a_reset_forgets_what_safety_has_counted():
    bench = a_bench()
    bench.until(Mode.APPROACH)
    memory = bench.cycle.parts.safety.memory
    memory["stretched_ns"] = 10**12
    memory["refused"] = memory["untrusted"] = 0xFFFF
    bench.step((Operator.ESTOP,))
    bench.step((Operator.RESET,))
    assert [int(memory[name]) for name in ("stretched_ns", "refused", "untrusted")] == [0, 0, 0]
    bench.until(Mode.APPROACH)
    bench.step()
    assert bench.cycle.mode is Mode.APPROACH
    assert bench.cycle.stop_requested is Stop.NONE
    assert not bench.cycle.faults


# -- where the platform is not on its path in time


@pytest.mark.parametrize("order", [Order(Operator.SPEED, (0.5,)), Order(Operator.HOLD)])
def test_a_table_made_for_the_path_at_full_speed_is_not_used_below_it(order):
    """t_d is what tells an offline feed-forward its row."""
    bench = a_bench()
    bench.until(Mode.TRACKING)
    bench.step()
    tick = bench.cycle.tick
    assert tick["t_d"] == tick["reference_time_s"] > 0.0
    bench.step(orders=(order,))
    for _ in range(3):
        bench.step()
        assert np.isnan(bench.cycle.tick["t_d"])
        assert bench.cycle.mode is Mode.TRACKING


# -- the force that comes back


def test_the_force_comes_back_whole_in_the_tick_after_a_brake_has_failed_its_test():
    """The step from tick to tick is made for a law that goes on."""
    gentle = VIRTUAL.limits.model_copy(update={"force_step_N": 200.0})
    bench = a_bench(limits=gentle, engage=BRISK.model_copy(update={"force_ramp_s": 0.1}))
    bench.until(Mode.APPROACH)
    bench.step((Operator.STOP,))
    while min(bench.drives.commands[-1].force) > 1000.0:
        bench.step()
        assert bench.tick < 2000
    modes = [bench.cycle.mode]
    with held_to(bench, standstill_m=-1.0):
        bench.step()
    modes.append(bench.cycle.mode)
    assert modes == [Mode.UNLOADING, Mode.HELD]
    bench.step()
    np.testing.assert_allclose(bench.drives.commands[-1].force, 3618.625746, atol=1.0)


def test_a_law_that_is_asked_what_it_asks_for_at_rest_keeps_nothing_of_it():
    """Its integral would be in the entry offset and in the law: the force would count it twice."""
    parts = build_cycle(VIRTUAL, 1000.0, 0.01).parts
    law, tick = pid(), record_of(R=np.eye(3), J=np.eye(6))
    home = PoseSample(parts.home_p, parts.home_R, np.zeros(6), np.zeros(6))
    law.xi[:] = 700.0
    asked = [tau_at_rest(law, parts.platform, tick, home, on_it=False) for _ in range(2)]
    assert asked[0].any()
    np.testing.assert_array_equal(asked[0], asked[1])
    assert not law.xi.any()


# -- a drive that is switched off and on before the platform is armed


@pytest.mark.parametrize("operator", [(), (Operator.ENGAGE,)])
@pytest.mark.parametrize("what", ["its turn", "its set-up"])
def test_a_drive_that_was_switched_off_while_the_operator_was_waited_for_is_not_armed(operator, what):
    cycle: Any = build_cycle(VIRTUAL, 1000.0, 0.01)
    cycle.end = SimpleNamespace(legs_set_up=lambda: [True] * 6)
    tick = record_of(tick=5, drive_state=int(DriveState.OFF), p=cycle.parts.home_p, R=np.eye(3), J=np.eye(6))
    cycle.mode = Mode.IDLE
    cycle._change_mode(SimpleNamespace(tick=5, operator=()), tick)
    assert cycle.mode == Mode.IDLE, "all is ready"
    if what == "its turn":
        cycle.homing = SimpleNamespace(known=False)
    else:
        cycle.end.legs_set_up = lambda: [True, True, False, True, True, True]
    cycle._change_mode(SimpleNamespace(tick=6, operator=operator), tick)
    assert cycle.mode == Mode.WAITING
