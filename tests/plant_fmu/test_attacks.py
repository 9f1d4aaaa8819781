"""Old, repeated or forged frames at the drives' end: they are rejected and counted, and feed no watchdog."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.protocol import Frame
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, Status
from tests.drivers.legs_frames import command_frames, opening
from tests.plant_fmu.rig import MS, Rig

LAYOUTS = ("classic", "fd", "ideal")


def commands(rig: Rig, tick: int, force: float = 5.0, mode: DriveMode = DriveMode.RUN) -> tuple[Frame, ...]:
    return command_frames(rig.protocol, Command(mode, np.full(6, force)), tick)


def sync(rig: Rig, tick: int) -> Frame:
    return opening(rig.protocol, tick)[0]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_alternating_old_command_frames_do_not_keep_the_drives_in_run(layout):
    rig = Rig(layout)
    rig.run()
    old = [commands(rig, rig.tick - 1, 3e3), commands(rig, rig.tick - 2, 4e3)]
    for k in range(1, 15):
        rig.tick += 1
        rig.at(k * MS, sync(rig, rig.tick), *old[k % 2])
    snapshot = rig.nodes.snapshot()
    assert snapshot.state.tolist() == [DriveState.FAULT] * 6
    assert snapshot.fault.tolist() == [DriveFault.WATCHDOG] * 6
    assert (snapshot.commands, snapshot.repeated) == (2 * len(old[0]), 0)
    assert snapshot.rejected == 14 * len(old[0])
    assert not snapshot.command.any()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("ahead", [-8, -1, 1, 2, 7])
def test_drives_reject_a_command_that_belongs_to_another_sync(layout, ahead):
    rig = Rig(layout)
    rig.run(100.0)
    before = rig.nodes.snapshot()
    rig.at(0, *commands(rig, rig.tick + ahead, 9e3, DriveMode.OFF))
    after = rig.nodes.snapshot()
    np.testing.assert_array_equal(after.command, before.command)
    assert after.state.tolist() == [DriveState.RUN] * 6
    assert after.rejected - before.rejected == (2 if layout == "classic" else 1)


def test_second_command_after_one_sync_has_no_effect_on_the_drives():
    rig = Rig()
    rig.run()
    rig.tick += 1
    rig.at(1 * MS, sync(rig, rig.tick), *commands(rig, rig.tick, 10.0), *commands(rig, rig.tick, 9e3))
    snapshot = rig.nodes.snapshot()
    assert snapshot.command.tolist() == [10.0] * 6
    assert snapshot.repeated == 1


@pytest.mark.parametrize("layout", LAYOUTS)
def test_commands_without_a_sync_have_no_effect_on_the_drives(layout):
    rig = Rig(layout)
    rig.configure()
    for tick in range(256):
        rig.at(tick * 1000, *commands(rig, tick, mode=DriveMode.READY))
    assert rig.states == [DriveState.OFF] * 6
    assert rig.nodes.snapshot().commands == 0


def test_drives_reject_a_sync_with_any_flipped_bit():
    rig = Rig()
    rig.run()
    good = sync(rig, rig.tick + 1)
    for bit in range(16):
        data = bytearray(good.data)
        data[bit // 8] ^= 1 << bit % 8
        assert not [
            f
            for _, f in rig.at(0, good._replace(data=bytes(data)))
            if f.id in rig.protocol.traits.feedback_ids
        ]
    assert rig.nodes.snapshot().rejected == 16
    rig.at(0, *commands(rig, rig.tick + 1, 77.0))
    assert not rig.nodes.snapshot().command.any()
    rig.at(0, good, *commands(rig, rig.tick + 1, 77.0))
    assert rig.nodes.snapshot().command.tolist() == [77.0] * 6


def test_drives_answer_a_repeated_sync_only_once():
    rig = Rig()
    frame = sync(rig, 9)
    answers = [f for _, f in rig.at(1 * MS, frame, frame) if f.id in rig.protocol.traits.feedback_ids]
    assert len(answers) == 6
    assert rig.nodes.snapshot().rejected == 1


@pytest.mark.parametrize("data", [b"", b"\xff", b"\x55" * 8])
@pytest.mark.parametrize("state", [DriveState.BOOT, DriveState.OFF, DriveState.RUN])
def test_drives_obey_and_confirm_an_emergency_stop_frame_with_any_payload(data, state):
    rig = Rig()
    if state is DriveState.OFF:
        rig.configure()
    elif state is DriveState.RUN:
        rig.run(500.0)
    sent = rig.at(1 * MS, Frame(0x001, data))
    told = [frame.data[:2] for _, frame in sent if 0x700 < frame.id < 0x707]
    assert told[-6:] == [bytes([DriveState.FAULT, DriveFault.ESTOP])] * 6
    assert rig.brakes == [1.0] * 6
    assert rig.states == [DriveState.FAULT] * 6


def test_drives_confirm_every_config_frame_at_once_with_their_new_settings():
    rig = Rig()
    rig.at(0)  # the first heartbeat
    ours = rig.at(1 * MS, *rig.protocol.configure(0.01, Reaction.BRAKE))
    theirs = rig.at(2 * MS, *rig.protocol.configure(4000.0, Reaction.ZERO))
    for sent, watchdog_s, reaction in ((ours, 0.01, Reaction.BRAKE), (theirs, 4000.0, Reaction.ZERO)):
        expected = [
            reports(rig.protocol, Status(leg, DriveState.OFF, 0, Configure(leg, watchdog_s, reaction)))[0]
            for leg in range(6)
        ]
        assert [frame for _, frame in sent] == expected
    assert len({frame.data[2:4] for _, frame in ours + theirs}) == 12, "watchdog, reaction and leg all count"
