"""Watchdogs, reactions, emergency stop, and brakes that take time to open and close."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest

from drivers.signals import DriveFault, DriveMode, DriveState, Reaction
from plant_fmu.config import DriveEmulation
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import BrakeStuckOpen
from tests.plant_fmu.rig import MASS, MS, REST, US, Rig, push, starve


@pytest.mark.parametrize("last_us", [0, 3000, 4049, 7777])
def test_drive_watchdog_reacts_within_one_plant_step_of_its_timeout(last_us):
    rig = Rig()
    rig.run(100.0)
    if last_us:
        rig.command(last_us * US, DriveMode.RUN, 100.0)
    rig.plant.calls.clear()
    started = round(last_us / 100) * 100  # us, present grid point of the plant
    sent = rig.at(30 * MS)
    free = sum(dt for dt, _, brake in rig.plant.calls if brake[0] == 0.0)
    stopped_us = started + free * 1e6
    assert last_us + 10_000 - 50 <= stopped_us <= last_us + 10_000 + 100
    told = [
        (t, frame.data[:2]) for t, frame in sent if frame.id == 0x701 and frame.data[0] == DriveState.FAULT
    ]
    assert told[0] == (last_us * US + 10 * MS, bytes([DriveState.FAULT, DriveFault.WATCHDOG]))


def test_watchdog_time_and_reaction_may_differ_between_the_drives():
    rig = Rig()
    watchdog_ms = [30, 5, 10, 25, 15, 20]
    reactions = [Reaction(leg % 4) for leg in range(6)]
    sets = [
        rig.protocol.configure(1e-3 * ms, each)[leg]
        for leg, (ms, each) in enumerate(zip(watchdog_ms, reactions, strict=True))
    ]
    rig.at(0, *sets)
    rig.command(0, DriveMode.READY)
    rig.command(0, DriveMode.RUN)
    for t_ms in range(2, 35, 5):
        told = {frame.id: frame.data[:2] for _, frame in rig.at(t_ms * MS) if frame.id > 0x700}
        over = [ms < t_ms for ms in watchdog_ms]
        assert rig.states == [DriveState.FAULT if each else DriveState.RUN for each in over]
        braked = [each and kind is Reaction.BRAKE for each, kind in zip(over, reactions, strict=True)]
        assert rig.brakes == braked
        for leg, ms in enumerate(watchdog_ms):
            if t_ms - 5 <= ms < t_ms:
                assert told[0x701 + leg] == bytes([DriveState.FAULT, DriveFault.WATCHDOG])


def test_command_at_the_instant_of_the_watchdog_timeout_is_in_time():
    rig = Rig()
    rig.run()
    rig.command(10 * MS, DriveMode.RUN)
    assert rig.states == [DriveState.RUN] * 6
    rig.at(20 * MS + 1)
    assert rig.states == [DriveState.FAULT] * 6


def test_drive_watchdog_runs_in_ready_but_not_in_off():
    rig = Rig()
    rig.configure()
    rig.at(100 * MS)
    assert rig.states == [DriveState.OFF] * 6
    rig.command(100 * MS, DriveMode.READY)
    rig.command(105 * MS, DriveMode.OFF)
    rig.at(200 * MS)
    assert rig.states == [DriveState.OFF] * 6
    rig.command(200 * MS, DriveMode.READY)
    rig.at(211 * MS)
    assert rig.states == [DriveState.FAULT] * 6


def test_watchdog_reaction_brake_stops_the_leg_zero_coasts_and_damp_slows_it_exponentially():
    stopped, travelled = starve(Reaction.BRAKE, seconds=0.1, load=-2000.0)
    coasting, _ = starve(Reaction.ZERO, seconds=3.0)
    damped, _ = starve(Reaction.DAMP, seconds=0.02)
    for rig, moved, brake in ((stopped, 0.0, 1.0), (coasting, 0.1 * 3.0, 0.0)):
        snapshot = rig.nodes.snapshot()
        np.testing.assert_allclose(snapshot.length, REST + travelled + moved, rtol=0, atol=1e-11)
        assert (snapshot.force.tolist(), snapshot.brake.tolist()) == ([0.0] * 6, [brake] * 6)
    snapshot = damped.nodes.snapshot()
    # m dv = -c v with c = 20000 N s/m; a drive that samples at h = 100 us gives (1 - c h / m)^n
    np.testing.assert_allclose(snapshot.rate, 0.1 * (1 - 20_000 * 1e-4 / MASS) ** 200, rtol=1e-9)
    travel = 0.1 * MASS / 20_000 * (1 - exp(-0.02 * 20_000 / MASS))
    np.testing.assert_allclose(snapshot.length, REST + travelled + travel, rtol=0, atol=0.02 * travel)
    assert snapshot.brake.tolist() == [0.0] * 6


def test_watchdog_reaction_hold_returns_to_the_length_at_the_fault_minus_the_sag_under_load():
    rig, travelled = starve(Reaction.HOLD, seconds=1.0, load=-2000.0)
    snapshot = rig.nodes.snapshot()
    sag = 2000.0 / 2e6
    np.testing.assert_allclose(snapshot.length, REST + travelled - sag, rtol=0, atol=1e-7)
    np.testing.assert_allclose(snapshot.rate, 0.0, atol=1e-6)
    assert snapshot.brake.tolist() == [0.0] * 6


@pytest.mark.parametrize("mode", [DriveMode.READY, DriveMode.RUN])
@pytest.mark.parametrize("reaction", [Reaction.ZERO, Reaction.DAMP, Reaction.HOLD])
def test_commands_other_than_off_and_reset_do_not_end_a_watchdog_reaction(reaction, mode):
    rig, _ = starve(reaction, seconds=0.005)
    other, _ = starve(reaction, seconds=0.005)
    for t_ms in (16, 17, 18):
        rig.command(t_ms * MS, mode, 500.0)
    rig.at(20 * MS)
    other.at(20 * MS)
    told, left = rig.nodes.snapshot(), other.nodes.snapshot()
    assert told.state.tolist() == [DriveState.FAULT] * 6
    assert told.brake.tolist() == [0.0] * 6
    assert not told.command.any()
    np.testing.assert_allclose(told.rate, left.rate, rtol=0, atol=1e-12)


@pytest.mark.parametrize("reaction", list(Reaction))
def test_emergency_stop_closes_the_brake_in_every_drive_state_with_any_watchdog_reaction(reaction):
    for path in ([], [DriveMode.READY], [DriveMode.READY, DriveMode.RUN]):
        rig = Rig(reaction=reaction, faults=[push(-2000.0)])
        rig.configure()
        for mode in path:
            rig.command(0, mode)
        rig.at(1 * MS, *rig.protocol.traits.emergency_stop)
        stopped = rig.nodes.snapshot()
        rig.at(50 * MS)
        snapshot = rig.nodes.snapshot()
        assert rig.states == [DriveState.FAULT] * 6
        assert snapshot.brake.tolist() == [1.0] * 6
        assert not snapshot.force.any()
        np.testing.assert_array_equal(snapshot.length, stopped.length)
        assert len(path) == 2 or (snapshot.length == REST).all(), "no fault opens a closed brake"


@pytest.mark.parametrize("reaction", [Reaction.ZERO, Reaction.DAMP, Reaction.HOLD])
def test_emergency_stop_and_off_close_the_brake_of_a_drive_during_its_watchdog_reaction(reaction):
    for stop in ("estop", "off"):
        rig, _ = starve(reaction, seconds=0.01)
        assert rig.nodes.snapshot().brake.tolist() == [0.0] * 6
        if stop == "estop":
            rig.at(20 * MS, *rig.protocol.traits.emergency_stop)
        else:
            rig.command(20 * MS, DriveMode.OFF)
        snapshot = rig.nodes.snapshot()
        expected = DriveFault.ESTOP if stop == "estop" else DriveFault.WATCHDOG
        assert snapshot.fault.tolist() == [expected] * 6
        assert snapshot.brake.tolist() == [1.0] * 6
        assert not snapshot.force.any()


# brakes with closing times

OPEN_MS, CLOSE_MS = 50, 30
SLOW = DriveEmulation(encoder_resolution_m=0.0, brake_open_ms=OPEN_MS, brake_close_ms=CLOSE_MS)
LOAD = 2000.0
"""Force that holds each mass against its load, N."""


def rig(*faults: Fault, reaction: Reaction = Reaction.BRAKE) -> Rig:
    return Rig(emulation=SLOW, faults=[push(-LOAD), *faults], reaction=reaction)


def feed(rig: Rig, first_ms: int, last_ms: int, mode: DriveMode, force: float = LOAD) -> None:
    """Send a command every 5 ms, from the first to the last instant."""
    for t in range(first_ms, last_ms + 1, 5):
        rig.command(t * MS, mode, force)


def running(rig: Rig, until_ms: int = 100, force: float = LOAD) -> None:
    """Bring all drives to RUN at 0, with open brakes long before `until_ms`."""
    rig.run(force)
    feed(rig, 5, until_ms, DriveMode.RUN, force)


def free_ms(rig: Rig, leg: int = 0) -> float:
    """Time for which a leg's brake was open since the calls of the plant were cleared, ms."""
    return 1e3 * sum(dt for dt, _, brake in rig.plant.calls if brake[leg] == 0.0)


def test_a_drive_follows_force_commands_while_its_brake_closes():
    a = rig()
    running(a)
    a.plant.calls.clear()
    feed(a, 105, 200, DriveMode.READY, LOAD + 200.0)
    assert free_ms(a) == pytest.approx(5 + CLOSE_MS)
    # 5 ms in balance, then 1 m/s^2 until the brake has closed
    np.testing.assert_allclose(a.nodes.snapshot().length, REST + 0.5 * 0.030**2, rtol=0, atol=1e-12)
    assert a.nodes.snapshot().force.tolist() == [LOAD + 200.0] * 6, "READY: the force stage is on"


@pytest.mark.parametrize("end", ["off", "estop", "watchdog", "reset"])
def test_a_drive_keeps_its_last_force_until_its_brake_has_closed(end):
    a = rig()
    running(a)
    a.plant.calls.clear()
    begun = 100
    match end:
        case "off":
            a.command(100 * MS, DriveMode.OFF)
        case "reset":
            a.command(100 * MS, DriveMode.RESET)
        case "estop":
            a.at(100 * MS, *a.protocol.traits.emergency_stop)
        case _:
            begun = 110
    for t in range(101, 200):
        a.at(t * MS)
        snapshot = a.nodes.snapshot()
        np.testing.assert_allclose(snapshot.length, REST, rtol=0, atol=1e-12, err_msg="nothing falls")
        closed = t >= begun + CLOSE_MS
        assert snapshot.brake.tolist() == [float(closed)] * 6
        assert snapshot.force.tolist() == [0.0 if closed else LOAD] * 6
        if t > begun:
            assert not snapshot.command.any(), "no valid command any more"
    assert free_ms(a) == pytest.approx(begun - 100 + CLOSE_MS)


def test_drive_removes_its_force_after_the_closing_time_even_if_its_brake_stays_open():
    """The drive has no sensor for its brake, only a timer."""
    a = rig(BrakeStuckOpen(leg=2))
    running(a)
    a.command(105 * MS, DriveMode.OFF)
    a.at((105 + CLOSE_MS + 10) * MS)
    expected = np.zeros(6)
    expected[2] = -LOAD / MASS * 0.010
    np.testing.assert_allclose(a.nodes.snapshot().rate, expected, atol=1e-12)


def test_brake_commanded_open_again_before_it_has_closed_stays_open():
    a = rig()
    running(a)
    a.plant.calls.clear()
    feed(a, 105, 125, DriveMode.READY)
    feed(a, 130, 200, DriveMode.RUN)
    assert free_ms(a) == pytest.approx(100.0), "25 ms of closing are not enough"
    feed(a, 205, 260, DriveMode.READY)
    assert a.brakes == [1.0] * 6, "the next closing takes the whole time again"
    assert free_ms(a) == pytest.approx(105.0 + CLOSE_MS)


@pytest.mark.parametrize("reaction", [Reaction.DAMP, Reaction.HOLD])
def test_watchdog_reactions_damp_and_hold_close_the_brake_after_brake_after_ms(reaction):
    """brake_after_ms is 1 s: from the watchdog's fault at 110 ms to 1110 ms, plus the closing time."""
    a = rig(reaction=reaction)
    running(a)
    a.at(1110 * MS)
    assert a.states == [DriveState.FAULT] * 6
    assert a.brakes == [0.0] * 6
    a.at((1110 + CLOSE_MS - 1) * MS)
    last = a.nodes.snapshot()
    assert last.brake.tolist() == [0.0] * 6
    np.testing.assert_allclose(last.force, LOAD, rtol=0.01, err_msg="the drive carries the load until then")
    a.at((1110 + CLOSE_MS + 1) * MS)
    assert a.brakes == [1.0] * 6
    assert not a.nodes.snapshot().force.any()
    assert a.nodes.snapshot().fault.tolist() == [DriveFault.WATCHDOG] * 6
