"""Repeated events in one cycle: a stop, RESET, fault, hold or arming does not affect later ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.signals import Fault, Mode, Refusal, Stop
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import loads
from hil.config.running import OperatorSettings
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
from tests.hil.test_operating import HOLD, KEY, PARK, START

# -- a stop on the way back to the first pose


def on_the_way_back(speed: float) -> Cycle:
    """A cycle on its way to park: 0.1 m to go, at a share of the speed."""
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
def test_stop_during_the_return_to_the_first_pose_holds_whatever_caused_or_follows_it(cause, speed):
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
        assert cycle.mode_tick == 300, "the mode must be entered once"
        heights.append(cycle.motion.sample(number).p[2])
    assert cycle.mode is Mode.PARKING
    assert number <= 300 + 1.34 * 1000.0 * VIRTUAL.engage.stop_s
    assert np.diff(heights).max() <= 1e-12, "the platform must move in one direction only and come to rest"
    assert cycle.parts.home_p[2] + 0.01 < heights[-1] < begun


def on_the_path(text: str) -> Cycle:
    """A cycle half-way along a straight path of 20 mm/s that begins at home."""
    cycle = build_cycle(loads(text), 1000.0, 0.01)
    parts = cycle.parts
    there = parts.home_p + np.array([0.0, 0.0, 0.1])
    cycle.motion.start(GeodesicMove(parts.home_p, parts.home_R, there, parts.home_R, 10.0), 0)
    cycle.mode = Mode.TRACKING
    return cycle


KEYED = VIRTUAL.text.replace("\nreference: ", "\noperator: {deadman_s: 0.1}\n\nreference: ")


def test_return_to_the_first_pose_needs_the_deadman_key():
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


def test_a_set_point_after_park_is_refused():
    bench = a_bench(reference=LIVE)
    bench.until(Mode.TRACKING)
    assert not bench.step(setpoints=(HIGHER,)).row["setpoint_refusal"]
    bench.step(orders=(PARK,))
    for _ in range(3):
        row = bench.step(setpoints=(HIGHER,)).row
        assert (int(row["setpoints_taken"]), int(row["setpoint_refusal"])) == (1, Refusal.NOT_TRACKING)
    assert bench.cycle.operating.parks


def test_reset_and_stop_do_not_mark_brakes_as_proven_that_were_open():
    bench = a_bench()
    bench.until(Mode.APPROACH)
    modes = []
    for operator in ((), (Operator.RESET,), (Operator.STOP,)):
        bench.step(operator, bus_off=not operator)
        modes.append(bench.cycle.mode)
        assert not bench.cycle.proven
    assert modes == [Mode.FAULT, Mode.WAITING, Mode.PARKED]


# -- a platform that is held


def test_the_full_force_returns_one_tick_after_a_failed_brake_test():
    """The limit of the force step is meant for a continuous law."""
    gentle = VIRTUAL.limits.model_copy(update={"force_step_N": 200.0})
    bench = a_bench(limits=gentle, engage=BRISK.model_copy(update={"force_ramp_s": 0.1}))
    bench.stopped(Mode.UNLOADING)
    while bench.force.min() > 1000.0:
        bench.step()
    mode = bench.cycle.mode
    assert mode is Mode.UNLOADING
    with held_to(bench, standstill_m=-1.0):
        bench.step()
    assert bench.cycle.mode is Mode.HELD
    bench.step()
    np.testing.assert_allclose(bench.force, HOLDING_N, atol=1.0)


def test_a_platform_that_loses_feedback_while_parking_keeps_its_last_force():
    bench = a_bench(engage=BRISK.model_copy(update={"brake_close_s": 0.1}))
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
def test_without_feedback_the_holding_force_ignores_leg_readings(by_m):
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


def test_the_reference_follows_a_yielding_platform_until_brakes_engage():
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


def test_predictor_and_observer_use_the_forces_sent_and_zero_if_off():
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


# -- a hold where the motion ends meanwhile


END = 400
"""Tick at which the motion ends unless it is held."""
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
    """Run ticks in which the mode must stay, with orders in the first tick."""
    mode = cycle.mode
    for number in range(first, last):
        ticked(cycle, number, orders=orders if number == first else ())
        assert (cycle.mode, cycle.faults) == (mode, Fault.NONE), number


@pytest.mark.parametrize("stop_s", [0.5, 4.0])
@pytest.mark.parametrize("mode", [Mode.TRACKING, Mode.STOPPING])
def test_hold_just_before_the_end_of_the_path_lasts_until_start_and_then_parks(mode, stop_s):
    cycle = under_way(mode, stop_s)
    held(cycle, 1, LATE)
    held(cycle, LATE, 6000, HOLD)
    assert cycle.motion.finished(6000)
    assert cycle.motion.resting
    ticked(cycle, 6000, orders=(START,))
    assert (cycle.mode, cycle.faults) == (Mode.PARKING, Fault.NONE)


def parks(cycle: Cycle, first: int) -> list[Mode]:
    """Run until PARKING, without a fault; return the modes before it."""
    modes: list[Mode] = []
    for number in range(first, first + 8000):
        ticked(cycle, number)
        assert not cycle.faults
        if cycle.mode is Mode.PARKING:
            return modes
        modes.append(cycle.mode)
    raise AssertionError(f"it stays in {cycle.mode}")


@pytest.mark.parametrize("word", ["stop", "park"])
def test_stop_after_a_hold_at_the_path_end_parks_there_and_park_at_the_first_pose(word):
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
