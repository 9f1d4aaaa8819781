"""What a held platform makes of silence and of further faults, and who is told the forces that were sent."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveMode, DriveState, Fault, Mode
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import loads
from hil.contracts.records import record_of
from hil.loop.cycle import Cycle
from hil.signals import Operator
from tests.hil.test_cycle import Bench
from tests.hil.test_cycle_again import BRISK, VIRTUAL, a_bench
from tests.hil.test_modes import FOLLOW


@pytest.mark.parametrize(
    ("silent", "mode"),
    [({0}, Mode.HELD), ({5}, Mode.HELD), ({0, 1, 2, 3, 4}, Mode.HELD), (set(range(6)), Mode.FAULT)],
    ids=str,
)
def test_the_force_stays_on_as_long_as_one_drive_is_heard_and_ends_a_second_after_the_last(silent, mode):
    bench = a_bench()
    bench.until(Mode.APPROACH)
    bench.drives.silent = silent
    modes = []
    for _ in range(1200):
        bench.step()
        modes.append(bench.cycle.mode)
    assert set(modes[5:950]) == {Mode.HELD}
    assert set(modes[1005:]) == {mode}
    asked = DriveMode.READY if mode is Mode.HELD else DriveMode.OFF
    assert bench.drives.commands[-1].mode == asked
    assert (min(bench.drives.commands[-1].force) > 3000.0) == (mode is Mode.HELD)


@pytest.fixture(scope="module")
def cycle() -> Cycle:
    return build_cycle(VIRTUAL, 1000.0, 0.01)


@pytest.mark.parametrize("fault", [*FOLLOW, Fault.DRIVE, Fault.SET_UP])
@pytest.mark.parametrize("before", [Fault.DRIVE, Fault.BRAKE, Fault.STALE, Fault.ENCODER | Fault.BRAKE])
def test_a_fault_of_the_pose_is_news_to_a_held_platform_unless_a_leg_was_not_measured_before(
    cycle, fault, before
):
    cycle.reset()
    cycle.mode, cycle.faults = Mode.HELD, before
    cycle.tick = record_of(tick=9, age=0)
    quiet: Any = SimpleNamespace(operator=())
    cycle._react(quiet, fault)
    measured = not before & (Fault.STALE | Fault.ENCODER)
    assert cycle.faults == (before | fault if measured or fault not in FOLLOW else before)
    assert cycle.mode == Mode.HELD


@pytest.mark.parametrize("fault", [*FOLLOW, Fault.DRIVE])
def test_on_the_way_to_a_second_proof_a_fault_of_the_pose_is_news_again_and_a_lost_measurement_ends_it(
    cycle, fault
):
    cycle.reset()
    cycle.mode, cycle.faults = Mode.UNLOADING, Fault.STALE
    cycle.tick = record_of(tick=9, age=0)
    quiet: Any = SimpleNamespace(operator=())
    cycle._react(quiet, fault)
    assert cycle.faults == Fault.STALE | fault
    believed = Fault.STROKE | Fault.SPEED | Fault.FOLLOWING | Fault.DRIVE
    assert cycle.mode is (Mode.UNLOADING if fault & believed else Mode.HELD)


def test_predictor_and_observer_follow_the_forces_that_were_sent_and_none_once_the_drives_are_off():
    damping = "  damping_ratio: 1\n"
    delay = "  delay_compensation: {bus_ms: 0.5, drive_lag_ms: 0.8, hold_ms: 0.5}\n"
    observer = "\nestimation: {wrench: {source: observer, bandwidth_Hz: 5, bus_ms: 0.5, drive_lag_ms: 0.8}}\n"
    text = VIRTUAL.text.replace(damping, damping + delay) + observer
    c = loads(text, VIRTUAL.name, VIRTUAL.folder).model_copy(update={"engage": BRISK})
    bench = Bench(c)
    parts: Any = bench.cycle.parts
    bench.until(Mode.APPROACH)
    bench.step(bus_off=True)
    sent = np.array([command.force for command in bench.drives.commands])
    assert sent.max() > 3000.0
    assert not sent[-1].any()
    for who in (parts.predictor, parts.wrench.observer):
        np.testing.assert_allclose(who.path._sent, sent[:-3:-1], atol=0.5)


@pytest.mark.parametrize("leg", [0, 3, 5])
@pytest.mark.parametrize("by_m", [4e-4, -4e-4])
def test_a_platform_that_is_not_measured_is_held_by_the_same_force_whatever_its_legs_say(leg, by_m):
    bench = a_bench()
    bench.until(Mode.APPROACH)
    bench.drives.silent = {leg}
    while bench.cycle.mode is not Mode.HELD:
        bench.step()
        assert bench.tick < 2000
    holding = bench.cycle.effort.holding.copy()
    assert holding.min() > 3000.0
    bench.drives.silent = set()
    bench.drives.length = bench.drives.length + by_m * (np.arange(6) == leg)
    for _ in range(4):
        bench.step()
        np.testing.assert_array_equal(bench.cycle.tick["tau_asked"], holding)
        assert bench.cycle.mode is Mode.HELD


@pytest.mark.parametrize(
    ("rivals", "latches", "sent"),
    [(False, False, [1, 0, 0, 0]), (False, True, [1, 1, 1, 1]), (True, False, [1, 1, 1, 1])],
)
def test_the_stop_is_repeated_where_drives_keep_it_or_another_controller_commands_them_else_off_is_the_stop(
    monkeypatch, rivals, latches, sent
):
    """Drives that go on in RUN whatever they are told."""
    bench = a_bench()
    protocol = bench.cycle.parts.protocol
    monkeypatch.setattr(protocol, "traits", replace(protocol.traits, stop_latches=latches))
    bench.until(Mode.APPROACH)
    told: list[int] = []
    for _ in range(4):
        if rivals:
            bench.cycle.faults |= Fault.SECOND_CONTROLLER
        before = bench.drives.estops
        bench.step((Operator.ESTOP,) * (not told))
        told.append(bench.drives.estops - before)
        bench.drives.state = [DriveState.RUN] * 6
    assert told == sent
    assert bench.drives.commands[-1].mode == DriveMode.OFF
