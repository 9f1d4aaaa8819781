"""Six emulated CiA 402 drives behind one bus: each hears, answers and remembers what is its own."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from drivers.cia402.states import State
from drivers.errors import ProtocolError
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.signals import DriveState
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.messages import Alive, Answer, Sync
from tests.drivers.cia402_drives import changed, drives, holding, made
from tests.drivers.spoken_drives import UNLIKE, UNLIKE_GEAR

NODES = (11, 12, 13, 14, 15, 16)
P = ByValue(made(NODES, UNLIKE_GEAR, force_limit_N=100.0))
RUNNING = np.full(6, DriveState.RUN)
SIX = np.arange(1.0, 7.0)


def running() -> Remembered:
    """Return drives that are set up and enabled."""
    return holding(P.protocol, RUNNING)


def write(leg: int, text: str) -> Frame:
    return Frame(0x600 + NODES[leg], bytes.fromhex(text))


def test_a_sync_is_answered_by_drives_in_operational_that_send_something_and_ends_a_fault_reaction():
    memory = changed(changed(running(), 1, nmt=127), 2, nmt=4)
    memory = changed(memory, 4, state=State.FAULT_REACTION)
    for at in (0x1800, 0x1801):
        memory, _ = P.parse(memory, write(3, f"23{at & 0xFF:02x}{at >> 8:02x}0180010080"))
    after, messages = P.parse(memory, Frame(0x80, b""))
    assert messages == (Sync(0, (0, 4, 5)),)
    assert after.state["state"].tolist() == [State.FAULT if leg == 4 else State.ENABLED for leg in range(6)]


def test_a_heartbeat_is_heard_by_the_drives_that_watch_its_node():
    memory, messages = running(), {}
    for leg, node in ((1, 9), (4, 9), (5, 0)):
        memory, _ = P.parse(memory, write(leg, f"23161001e803{node:02x}00"))
    for node in (9, 127, 5, 0):
        messages[node] = P.parse(memory, Frame(0x700 + node, b"\5"))[1]
    assert messages == {9: (Alive((1, 4)),), 127: (Alive((0, 2, 3)),), 5: (), 0: (Alive((5,)),)}
    memory, _ = P.parse(memory, write(0, "2316100100007f00"))
    assert P.parse(memory, Frame(0x77F, b"\5"))[1] == (Alive((2, 3)),), "no time is set"


@pytest.mark.parametrize("flag", [EXTENDED, FD, REMOTE, ERROR])
def test_a_frame_that_cannot_be_ours_changes_nothing(flag):
    memory = running()
    for frame in (Frame(0x80, b"", flag), Frame(0x20B, bytes(4), flag), Frame(0, b"\2\0", flag)):
        assert P.parse(memory, frame) == (memory, ())


def test_each_drive_answers_with_its_own_position_speed_and_torque():
    length, rate, force = UNLIKE.length(0.001 * SIX), UNLIKE.rate(0.002 * SIX), 3.0 * UNLIKE.N_per_Nm
    rate = rate * [1, -1, 1, 1, -1, 1]
    _, sent = P.answer(running(), Sync(0), length, rate, force, RUNNING)
    places = {leg: struct.unpack("<Hih", f.data) for leg, f in sent if len(f.data) == 8}
    speeds = {leg: struct.unpack("<i", f.data)[0] for leg, f in sent if len(f.data) == 4}
    counts = UNLIKE.counts
    assert [places[leg][1] for leg in range(6)] == np.rint(counts * 0.001 * SIX).tolist()
    assert [speeds[leg] for leg in range(6)] == np.rint(counts * 0.002 * SIX * [1, -1, 1, 1, -1, 1]).tolist()
    # 3 N m without losses are 333.3 thousandths of 9 N m
    shares = UNLIKE.torque(force, rate) / 3.0
    assert len({round(share, 3) for share in shares}) > 2
    assert [places[leg][2] for leg in range(6)] == np.rint(1e3 / 3.0 * shares).tolist()


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_never_sends_what_is_no_number(leg):
    for at in range(3):
        given = [np.full(6, 1.0) for _ in range(3)]
        given[at][leg] = np.nan
        with pytest.raises(ProtocolError, match="not a number"):
            P.answer(running(), Sync(0), given[0], given[1], given[2], RUNNING)


@pytest.mark.parametrize("leg", range(6))
def test_what_a_drive_sends_and_hears_follows_what_was_written_to_it_alone(leg):
    before = running()
    node = NODES[leg]
    memory, _ = P.parse(before, write(leg, "2300180180010080"))
    sent = [each for each, _ in P.answer(memory, Sync(0), SIX, SIX, SIX, RUNNING)[1]]
    assert [sent.count(each) for each in range(6)] == [1 if each == leg else 2 for each in range(6)]
    memory, _ = P.parse(memory, write(leg, f"23001401{node:02x}020080"))
    assert P.parse(memory, Frame(0x200 + node, bytes.fromhex("0f000000")))[1] == ()
    other = NODES[(leg + 1) % 6]
    assert P.parse(memory, Frame(0x200 + other, bytes.fromhex("0f000000")))[1] != ()
    memory, _ = P.parse(memory, write(leg, f"23001401{node:02x}030000"))
    heard = {at for at in range(0x200, 0x380) if P.parse(memory, Frame(at, bytes.fromhex("0f000000")))[1]}
    assert heard == {0x200 + each for each in NODES if each != node} | {0x300 + node}


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_that_was_switched_off_and_on_sends_nothing_until_it_is_set_up_anew(leg):
    started = running()._replace(started=True)
    states = RUNNING.copy()
    states[leg] = DriveState.BOOT
    memory, sent = P.answer(started, Sync(0), SIX, SIX, SIX, states)
    assert {each for each, _ in sent} == set(range(6)) - {leg}
    assert list(memory.nmt) == [0 if each == leg else 5 for each in range(6)]
    states[leg] = DriveState.OFF
    _, sent = P.answer(memory, Sync(0), SIX, SIX, SIX, states)
    assert {each for each, _ in sent} == set(range(6)) - {leg}


def test_each_drive_says_the_counts_of_its_own_encoder():
    counts = [1000, 2000, 3000, 4000, 5000, 6000]
    protocol, found = ByValue(drives(NODES, counts_per_turn=counts)), []
    memory = protocol.power_up()._replace(nmt=127)
    for leg in range(6):
        (answer,) = protocol.parse(memory, write(leg, "408f600100000000"))[1]
        assert isinstance(answer, Answer)
        found.append(int.from_bytes(answer.frame.data[4:], "little"))
    assert found == counts
