"""A second time in one cycle: a stop, a RESET, a fault, a hold or an arming do not act on what follows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.signals import Fault, Mode, Refusal, Stop
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import loads
from hil.contracts.records import record_of
from hil.loop.cycle import Cycle
from hil.signals import Operator, Order
from hil.trajectory.move import GeodesicMove
from tests.hil.cycle_bench import (
    BRISK,
    HIGHER,
    HOLDING_N,
    LIVE,
    VIRTUAL,
    Bench,
    a_bench,
    held_to,
    ticked,
)

# -- a stop on the way back to the first pose


def on_the_way_back(speed: float) -> Cycle:
    """Return a cycle that parks: a tenth of a metre to go, at a share of the speed."""
    cycle = build_cycle(VIRTUAL, 1000.0, 0.01)
    parts, motion, operating = cycle.parts, cycle.motion, cycle.operating
    here = parts.home_p + np.array([0.0, 0.0, 0.1])
    motion.start(GeodesicMove(here, parts.home_R, parts.home_p, parts.home_R, 1.0), 0)
    motion.settle(0, speed)
    operating.go = operating.parks = True
    operating.speed = speed
    cycle.mode = Mode.STOPPING
    return cycle


@pytest.mark.parametrize("speed", [1.0, 0.5])
@pytest.mark.parametrize("cause", ["operator", "safety", "fault"])
def test_a_stop_on_the_way_back_stands_whoever_asked_and_whatever_is_said_after(cause, speed):
    cycle = on_the_way_back(speed)
    for number in range(1, 300):
        ticked(cycle, number)
    assert cycle.mode_tick == 0
    if cause == "safety":
        cycle.stop_requested = Stop.MISSED
    if cause == "fault":
        cycle.faults = Fault.CERTIFICATE
    begun = cycle.motion.sample(300).p[2]
    ticked(cycle, 300, *[Operator.STOP] * (cause == "operator"))
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
    """Return a cycle half-way along a straight path of 20 mm/s that begins at home."""
    cycle = build_cycle(loads(text), 1000.0, 0.01)
    parts = cycle.parts
    there = parts.home_p + np.array([0.0, 0.0, 0.1])
    cycle.motion.start(GeodesicMove(parts.home_p, parts.home_R, there, parts.home_R, 10.0), 0)
    cycle.mode = Mode.TRACKING
    return cycle


KEYED = VIRTUAL.text.replace("\nreference: ", "\noperator: {deadman_s: 0.1}\n\nreference: ")
KEY, PARK = Order(Operator.KEY), Order(Operator.PARK)


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


# -- armed a second time, and after a RESET


@pytest.mark.parametrize(("before", "mode"), [(Mode.RELEASING, Mode.APPROACH), (Mode.LOADING, Mode.TRACKING)])
def test_a_live_reference_that_is_armed_again_begins_at_its_start(before, mode):
    live = build_cycle(VIRTUAL.model_copy(update={"reference": LIVE}), 1000.0, 0.01)
    steering: Any = live.parts.steering
    trajectory = steering.trajectory
    steering.take([HIGHER], tracking=True)
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
    steering.take([HIGHER], tracking=True)
    trajectory.advance(1, steering.judge)
    steering.take([], tracking=True)
    trajectory.advance(2000, steering.judge)
    np.testing.assert_allclose(trajectory.sample(0.0).p, HIGHER[:3], atol=1e-12)


def test_a_set_point_after_park_is_refused():
    bench = a_bench(reference=LIVE)
    bench.until(Mode.TRACKING)
    assert not bench.step(setpoints=(HIGHER,)).row["setpoint_refusal"]
    bench.step(orders=(PARK,))
    for _ in range(3):
        row = bench.step(setpoints=(HIGHER,)).row
        assert (int(row["setpoints_taken"]), int(row["setpoint_refusal"])) == (1, Refusal.NOT_TRACKING)
    assert bench.cycle.operating.parks


def test_brakes_that_opened_are_not_proven_by_a_reset_and_a_stop():
    bench = a_bench()
    bench.until(Mode.APPROACH)
    modes = []
    for operator in ((), (Operator.RESET,), (Operator.STOP,)):
        bench.step(operator, bus_off=not operator)
        modes.append(bench.cycle.mode)
        assert not bench.cycle.proven
    assert modes == [Mode.FAULT, Mode.WAITING, Mode.PARKED]


def test_without_a_ramp_the_law_begins_again_and_no_brake_counts_as_proven(monkeypatch):
    bench, begun = a_bench(engage=VIRTUAL.engage.model_copy(update={"force_ramp_s": 0.0})), []
    monkeypatch.setattr(bench.cycle.parts.law, "reset", lambda: begun.append(bench.tick))
    bench.cycle.effort.offset = np.full(6, 500.0)
    assert bench.cycle.proven
    bench.until(Mode.TRACKING)
    assert begun[-1] == bench.tick
    assert not bench.cycle.proven
    assert not bench.cycle.effort.offset.any()
    bench.step((Operator.STOP,))
    bench.go_on(Mode.PARKED, 5000)
    assert not bench.cycle.proven


# -- a platform that is held


def test_the_force_comes_back_whole_in_the_tick_after_a_brake_has_failed_its_test():
    """The step from tick to tick is made for a law that goes on."""
    gentle = VIRTUAL.limits.model_copy(update={"force_step_N": 200.0})
    bench = a_bench(limits=gentle, engage=BRISK.model_copy(update={"force_ramp_s": 0.1}))
    bench.stopped(Mode.UNLOADING)
    while bench.force.min() > 1000.0:
        bench.step()
    assert bench.cycle.mode is Mode.UNLOADING
    with held_to(bench, standstill_m=-1.0):
        bench.step()
    assert bench.cycle.mode is Mode.HELD
    bench.step()
    np.testing.assert_allclose(bench.force, HOLDING_N, atol=1.0)


def test_a_platform_not_measured_any_more_while_it_parks_is_held_by_the_last_force():
    bench = Bench()
    bench.stopped(Mode.PARKING)
    bench.drives.silent = {2}
    while bench.cycle.mode is Mode.PARKING:
        last = bench.cycle.tick["tau"].copy()
        bench.drives.length = bench.drives.length + 1e-6  # which the law pushes against
        bench.step()
    assert bench.cycle.mode is Mode.HELD
    np.testing.assert_array_equal(bench.cycle.effort.holding, last)
    bench.step()
    np.testing.assert_array_equal(bench.cycle.tick["tau_asked"], last)


@pytest.mark.parametrize("by_m", [4e-4, -4e-4])
def test_a_platform_not_measured_is_held_by_the_same_force_whatever_its_legs_say(by_m):
    bench = a_bench()
    bench.until(Mode.APPROACH)
    bench.drives.silent = {3}
    bench.go_on(Mode.HELD)
    holding = bench.cycle.effort.holding.copy()
    assert holding.min() > 3000.0
    bench.drives.silent = set()
    bench.drives.length = bench.drives.length + by_m * (np.arange(6) == 3)
    for _ in range(4):
        bench.step()
        np.testing.assert_array_equal(bench.cycle.tick["tau_asked"], holding)
        assert bench.cycle.mode is Mode.HELD


def test_the_reference_stays_with_a_platform_that_yields_until_the_brakes_are_shut():
    bench = a_bench()
    bench.stopped(Mode.PARKING)
    with held_to(bench, following_error_m=-1.0):
        bench.step()
    modes = []
    for _ in range(12):
        bench.drives.length = bench.drives.length + 2e-6
        bench.step()
        modes.append(bench.cycle.mode)
        tick = bench.cycle.tick
        if modes[-1] is Mode.PARKING:
            np.testing.assert_array_equal(tick["p_d"], tick["p"])
    assert modes[:3] == [Mode.PARKING] * 3
    assert modes[-2:] == [Mode.UNLOADING] * 2
    assert np.abs(tick["p_d"] - tick["p"]).max() > 1e-6, "there the legs have to stand"


def test_predictor_and_observer_follow_the_forces_sent_and_none_once_the_drives_are_off():
    damping = "  damping_ratio: 1\n"
    delay = "  delay_compensation: {bus_ms: 0.5, drive_lag_ms: 0.8, hold_ms: 0.5}\n"
    observer = "\nestimation: {wrench: {source: observer, bandwidth_Hz: 5, bus_ms: 0.5, drive_lag_ms: 0.8}}\n"
    text = VIRTUAL.text.replace(damping, damping + delay) + observer
    bench = Bench(loads(text, VIRTUAL.name, VIRTUAL.folder).model_copy(update={"engage": BRISK}))
    parts: Any = bench.cycle.parts
    bench.until(Mode.APPROACH)
    bench.step(bus_off=True)
    sent = np.array([command.force for command in bench.drives.commands])
    assert sent.max() > 3000.0
    assert not sent[-1].any()
    for who in (parts.predictor, parts.wrench.observer):
        np.testing.assert_allclose(who.path._sent, sent[:-3:-1], atol=0.5)
