"""Drives that have just been powered up: they hold, read and count from nothing, whoever starts them."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.config import DriveSettings
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Received
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.drive import Drives
from plant_fmu.drives.kernels import NEVER_NS
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.fault import Present
from plant_fmu.faults.kinds import EncoderFreeze, EncoderJump
from tests.drivers.legs_frames import command_frames, opening
from tests.plant_fmu.by_hand import actuate, encoders, enter, next_move_ns, obey
from tests.plant_fmu.test_nodes import MS, REST, Masses, Rig
from tests.plant_fmu.test_sensor_nodes import Mover, position

RATE = np.array([0.1, -0.2, 0.3, -0.4, 0.5, -0.6])
FORCE = np.array([100.0, -200.0, 300.0, -400.0, 500.0, -600.0])


def powered_up() -> Drives:
    return Drives(DriveSettings(), DriveEmulation(), 1e-4)


def test_drives_that_were_just_powered_up_hold_their_brakes_read_their_legs_and_have_nothing_to_come():
    drives = powered_up()
    assert next_move_ns(drives) == NEVER_NS
    length, rate, state = encoders(drives, REST, RATE)
    np.testing.assert_array_equal(length, REST)
    np.testing.assert_array_equal(rate, RATE)
    assert state.tolist() == [DriveState.BOOT] * 6
    np.testing.assert_allclose(encoders(drives, REST, RATE, 1e-3)[0], REST + 1e-3 * RATE, rtol=0, atol=1e-15)
    assert actuate(drives, REST, RATE, False, 0) is False
    assert drives.seen.brake.tolist() == [1.0] * 6
    assert drives.seen.force.tolist() == [0.0] * 6
    assert next_move_ns(drives) == NEVER_NS


def test_drives_that_were_just_powered_up_give_all_the_force_that_they_are_told():
    drives = powered_up()
    for leg in range(6):
        enter(drives, leg, int(DriveState.RUN), int(DriveFault.NONE))
    obey(drives, REST, RATE, np.arange(6), FORCE, int(DriveMode.RUN), 0, MS)
    np.testing.assert_array_equal(drives.seen.force, FORCE)
    assert drives.seen.brake.tolist() == [0.0] * 6
    assert next_move_ns(drives) == NEVER_NS, "of brakes that have opened nothing is to come"


@pytest.mark.parametrize(
    ("watchdog_ms", "open_ms", "slow_ms", "earliest_ms"),
    [(3.0, 4.0, 0, 3), (10.0, 4.0, 0, 4), (10.0, 4.0, 5, 4), (10.0, 0.0, 2, 2), (1.5, 0.0, 2, 1.5)],
)
def test_a_command_tells_when_the_first_watchdog_ends_or_brake_has_moved(
    watchdog_ms, open_ms, slow_ms, earliest_ms
):
    drives = Drives(DriveSettings(watchdog_ms=watchdog_ms), DriveEmulation(brake_open_ms=open_ms), 1e-4)
    slow = Present()
    slow.slow_ns[3] = slow_ms * MS
    drives.disturb(slow, 0)
    drives.seen.configured[:] = True
    for leg in range(6):
        enter(drives, leg, int(DriveState.READY), int(DriveFault.NONE))
    told = obey(drives, REST, RATE, np.arange(2, 6), FORCE[2:], int(DriveMode.RUN), 0, 7 * MS)
    assert told == (True, False, 0b111100, round((7 + earliest_ms) * MS))


@pytest.mark.parametrize("feeds", [True, False])
def test_a_drive_that_damps_goes_by_its_own_rate_when_others_are_told_something(feeds):
    drives = Drives(DriveSettings(), DriveEmulation(damping_N_s_m=1000.0), 1e-4)
    for leg in range(6):
        enter(drives, leg, int(DriveState.FAULT if leg == 4 else DriveState.RUN), int(DriveFault.NONE))
    drives.seen.acting[4] = int(Reaction.DAMP)
    others = np.array([0, 1, 2, 3, 5])
    told = obey(drives, REST, RATE, others, FORCE[others], int(DriveMode.RUN), 0, MS, feeds=feeds)
    fresh, controls, *_ = told
    assert (fresh, controls) == (True, True)
    np.testing.assert_allclose(drives.seen.force, [*FORCE[:4], -1000.0 * 0.5, FORCE[5]], rtol=1e-12)


def test_an_encoder_that_is_frozen_from_power_up_on_reads_the_first_length():
    rig = Rig("ideal", faults=[EncoderFreeze(leg=leg) for leg in range(6)])
    rig.run(1000.0)
    np.testing.assert_array_equal(rig.sync(5 * MS)["length"], REST)
    assert (rig.nodes.snapshot().length > REST).all()


def test_a_fault_of_one_nanosecond_at_power_up_is_over_after_it():
    rig = Rig("ideal", faults=[EncoderJump(leg=2, by_m=1e-3, for_s=1e-9)])
    assert rig.sync(0)["length"][2] == pytest.approx(REST[2] + 1e-3)
    np.testing.assert_array_equal(rig.sync(1 * MS)["length"], REST)


@pytest.mark.parametrize("k", range(4))
def test_the_truth_of_a_plant_is_told_at_whichever_step_it_is_asked_for_first(k):
    plant = Mover()
    nodes = Nodes(plant, LegsProtocol("fd", (1, 2, 3, 4, 5, 6)), DriveEmulation(), DriveSettings())
    nodes.start(0)
    nodes.step(k * MS // 10, [])
    truth = nodes.snapshot().truth
    assert truth is not None
    np.testing.assert_allclose(truth.p, position(1e-4 * k), rtol=0, atol=1e-12)


def test_drives_that_nobody_has_started_are_powered_up_at_0():
    nodes = Nodes(Masses(), LegsProtocol("fd", (1, 2, 3, 4, 5, 6)), DriveEmulation(), DriveSettings())
    assert nodes.now_ns == 0
    assert [(t, frame.id) for t, frame in nodes.step(0, [])] == [(0, 0x701)]


def test_syncs_commands_those_repeated_and_those_refused_are_counted_from_0():
    rig = Rig()
    snapshot = rig.nodes.snapshot()
    assert (snapshot.syncs, snapshot.commands, snapshot.repeated, snapshot.rejected) == (0, 0, 0, 0)
    rig.configure()
    frame = command_frames(rig.protocol, Command(DriveMode.READY, np.zeros(6)), 1)[0]
    damaged = frame._replace(data=frame.data[::-1])
    rig.at(1 * MS, *opening(rig.protocol, 1), frame, frame, frame, *[damaged] * 4)
    rig.at(2 * MS, *opening(rig.protocol, 2))
    rig.at(3 * MS, *opening(rig.protocol, 3))
    snapshot = rig.nodes.snapshot()
    assert (snapshot.syncs, snapshot.commands, snapshot.repeated, snapshot.rejected) == (3, 1, 2, 4)


def test_two_frames_are_heard_in_the_order_of_their_times():
    rig = Rig()
    rig.configure()
    rig.at(0, *opening(rig.protocol, 1))
    ready, off = (
        command_frames(rig.protocol, Command(mode, np.zeros(6)), 1)[0]
        for mode in (DriveMode.READY, DriveMode.OFF)
    )
    sent = rig.nodes.step(4 * MS, [Received(3 * MS, off), Received(2 * MS, ready)])
    assert [t for t, frame in sent if frame.id == 0x701] == [2 * MS]
    assert rig.states == [DriveState.READY] * 6, "the second has the counter of the first"


@pytest.mark.parametrize("feeds", [True, False])
@pytest.mark.parametrize("mode", [DriveMode.OFF, DriveMode.RESET])
@pytest.mark.parametrize("state", [DriveState.READY, DriveState.RUN])
def test_a_drive_that_a_command_switches_off_has_no_watchdog_any_more(feeds, mode, state):
    drives = Drives(DriveSettings(), DriveEmulation(), 1e-4)
    for leg in range(6):
        enter(drives, leg, int(state), int(DriveFault.NONE))
    drives.seen.configured[:], drives.seen.deadline_ns[:] = True, 3_000_000
    zero = np.zeros(6)
    obey(drives, zero, zero, np.arange(3), zero, int(mode), 0, 1_000_000, feeds=feeds)
    assert drives.seen.state.tolist() == [DriveState.OFF] * 3 + [state] * 3
    assert drives.seen.deadline_ns.tolist() == [NEVER_NS] * 3 + [3_000_000] * 3
