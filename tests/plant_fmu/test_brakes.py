"""Brakes that take their time: what holds each leg from the command to the brake that has moved."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from plant_fmu.config import DriveEmulation
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import BrakeStuckOpen
from tests.drivers.legs_frames import command_frames, opening
from tests.plant_fmu.test_nodes import MASS, MS, REST, Rig, push

OPEN_MS, CLOSE_MS = 50, 30
SLOW = DriveEmulation(encoder_resolution_m=0.0, brake_open_ms=OPEN_MS, brake_close_ms=CLOSE_MS)
LOAD = 2000.0
"""N, as gravity: it takes so much force to hold each mass."""


def rig(*faults: Fault, reaction: Reaction = Reaction.BRAKE) -> Rig:
    return Rig(emulation=SLOW, faults=[push(-LOAD), *faults], reaction=reaction)


def feed(rig: Rig, first_ms: int, last_ms: int, mode: DriveMode, force: float = LOAD) -> None:
    """Give a command every 5 ms, from the first to the last."""
    for t in range(first_ms, last_ms + 1, 5):
        rig.command(t * MS, mode, force)


def running(rig: Rig, until_ms: int = 100, force: float = LOAD) -> None:
    """Bring all drives to RUN at 0, with open brakes long before `until_ms`."""
    rig.run(force)
    feed(rig, 5, until_ms, DriveMode.RUN, force)


def free_ms(rig: Rig, leg: int = 0) -> float:
    """Return how long a leg's brake was open since the calls of the plant were cleared, ms."""
    return 1e3 * sum(dt for dt, _, brake in rig.plant.calls if brake[leg] == 0.0)


def test_a_brake_holds_until_it_has_opened():
    a = rig()
    a.run(3 * LOAD)
    feed(a, 5, 60, DriveMode.RUN, 3 * LOAD)
    assert free_ms(a) == pytest.approx(60 - OPEN_MS)
    np.testing.assert_allclose(a.nodes.snapshot().rate, 2 * LOAD / MASS * 0.010)


def test_a_brake_is_open_until_it_has_closed_and_the_drive_obeys_meanwhile():
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


def test_a_drive_whose_brake_does_not_close_lets_go_when_it_should_have():
    """It knows its brake by the time alone."""
    a = rig(BrakeStuckOpen(leg=2))
    running(a)
    a.command(105 * MS, DriveMode.OFF)
    a.at((105 + CLOSE_MS + 10) * MS)
    expected = np.zeros(6)
    expected[2] = -LOAD / MASS * 0.010
    np.testing.assert_allclose(a.nodes.snapshot().rate, expected, atol=1e-12)


def test_a_brake_that_is_called_back_has_not_moved():
    a = rig()
    running(a)
    a.plant.calls.clear()
    feed(a, 105, 125, DriveMode.READY)
    feed(a, 130, 200, DriveMode.RUN)
    assert free_ms(a) == pytest.approx(100.0), "25 ms of closing are not enough"
    feed(a, 205, 260, DriveMode.READY)
    assert a.brakes == [1.0] * 6, "the next time it takes its whole time anew"
    assert free_ms(a) == pytest.approx(105.0 + CLOSE_MS)


@pytest.mark.parametrize("reaction", [Reaction.DAMP, Reaction.HOLD])
def test_damping_and_holding_end_in_the_brake_after_the_stated_time(reaction):
    """drives.brake_after_ms, 1 s: from the watchdog's fault at 110 ms to 1110 ms, and the brake's own time."""
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
    at = a.nodes.snapshot().length
    a.at(3000 * MS)
    np.testing.assert_array_equal(a.nodes.snapshot().length, at)
    a.command(3001 * MS, DriveMode.RESET)
    a.at(3100 * MS)
    assert a.states == [DriveState.OFF] * 6, "and nothing is left of it after a reset"


def test_brakes_without_a_time_move_at_once():
    a = Rig()
    a.run()
    assert a.brakes == [0.0] * 6
    a.command(1 * MS, DriveMode.OFF)
    assert a.brakes == [1.0] * 6


@pytest.mark.parametrize("half", [0, 1])
def test_brakes_of_three_legs_alone_open_and_close_on_time_while_the_others_stay(half):
    """No command, heartbeat or watchdog falls between the command and the brakes that have moved."""
    a = Rig("classic", emulation=DriveEmulation(encoder_resolution_m=0.0, brake_open_ms=4, brake_close_ms=2))
    a.configure(watchdog_s=0.5)
    a.command(0, DriveMode.READY)
    asked = [leg // 3 == half for leg in range(6)]
    for mode, at_ms, until_ms, free_for_ms in ((DriveMode.RUN, 1, 7, 2.0), (DriveMode.READY, 8, 13, 2.0)):
        a.tick += 1
        frames = command_frames(a.protocol, Command(mode, np.zeros(6)), a.tick)
        a.at(at_ms * MS, *opening(a.protocol, a.tick))
        a.plant.calls.clear()
        a.at(at_ms * MS, frames[half])
        a.at(until_ms * MS)
        free = [free_ms(a, leg) for leg in range(6)]
        np.testing.assert_allclose(free, np.where(asked, free_for_ms, 0.0), rtol=0, atol=1e-9)
    assert a.brakes == [1.0] * 6


def test_brakes_close_on_time_after_an_emergency_stop_between_two_heartbeats():
    a = Rig(emulation=DriveEmulation(encoder_resolution_m=0.0, brake_close_ms=2))
    a.configure(watchdog_s=0.5)
    a.command(0, DriveMode.READY)
    a.command(0, DriveMode.RUN)
    a.at(1 * MS, *a.protocol.traits.emergency_stop)
    a.plant.calls.clear()
    a.at(6 * MS)
    assert [free_ms(a, leg) for leg in range(6)] == pytest.approx([2.0] * 6)


def test_each_drive_ends_its_own_reaction_in_the_brake_if_it_damps_or_holds():
    """1 s after the fault at 10 ms; legs 0 and 4 brake at once, and those that let go never do."""
    a = Rig(emulation=DriveEmulation(encoder_resolution_m=0.0))
    kinds = (Reaction.BRAKE, Reaction.DAMP, Reaction.HOLD, Reaction.ZERO, Reaction.BRAKE, Reaction.HOLD)
    a.at(0, *[a.protocol.configure(0.01, kind)[leg] for leg, kind in enumerate(kinds)])
    a.command(0, DriveMode.READY)
    a.command(0, DriveMode.RUN)
    a.at(1009 * MS)
    assert a.states == [DriveState.FAULT] * 6
    assert a.brakes == [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    a.at(1011 * MS)
    assert a.brakes == [1.0, 1.0, 1.0, 0.0, 1.0, 1.0]
    a.at(3000 * MS)
    assert a.brakes == [1.0, 1.0, 1.0, 0.0, 1.0, 1.0]
