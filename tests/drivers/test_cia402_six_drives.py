"""Six emulated CiA 402 drives behind one bus: each hears, answers and remembers what is its own."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from drivers.cia402 import objects as o
from drivers.cia402.states import State
from drivers.errors import ProtocolError
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.signals import INVALID, DriveState
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.messages import Alive, Answer, EmergencyStop, Rejected, Sync
from tests.drivers.cia402_drives import changed, drives, holding, made
from tests.drivers.motor_families import UNLIKE, UNLIKE_GEAR

NODES = (11, 12, 13, 14, 15, 16)
P = ByValue(made(NODES, UNLIKE_GEAR, force_limit_N=100.0))
RUNNING = np.full(6, DriveState.RUN)
SIX = np.arange(1.0, 7.0)


def running() -> Remembered:
    """Return drives that are set up and enabled."""
    return holding(P.protocol, RUNNING)


def write(leg: int, text: str) -> Frame:
    return Frame(0x600 + NODES[leg], bytes.fromhex(text))


def test_sync_is_answered_by_drives_in_operational_with_a_tpdo():
    memory = changed(changed(running(), 1, nmt=127), 2, nmt=4)
    memory = changed(memory, 4, state=State.FAULT_REACTION)
    for at in (0x1800, 0x1801):
        memory, _ = P.parse(memory, write(3, f"23{at & 0xFF:02x}{at >> 8:02x}0180010080"))
    after, messages = P.parse(memory, Frame(0x80, b""))
    assert messages == (Sync(0, (0, 4, 5)),)
    assert after.state["state"].tolist() == [State.FAULT if leg == 4 else State.ENABLED for leg in range(6)]


def test_heartbeat_feeds_the_drives_that_watch_its_node():
    memory, messages = running(), {}
    for leg, node in ((1, 9), (4, 9), (5, 0)):
        memory, _ = P.parse(memory, write(leg, f"23161001e803{node:02x}00"))
    for node in (9, 127, 5, 0):
        messages[node] = P.parse(memory, Frame(0x700 + node, b"\5"))[1]
    assert messages == {9: (Alive((1, 4)),), 127: (Alive((0, 2, 3)),), 5: (), 0: (Alive((5,)),)}
    memory, _ = P.parse(memory, write(0, "2316100100007f00"))
    assert P.parse(memory, Frame(0x77F, b"\5"))[1] == (Alive((2, 3)),), "no time is set"


@pytest.mark.parametrize("flag", [EXTENDED, FD, REMOTE, ERROR])
def test_frame_with_another_flag_changes_nothing(flag):
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
def test_identifiers_of_a_drive_follow_what_was_written_to_it_alone(leg):
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
def test_drive_that_was_switched_off_and_on_sends_nothing_until_it_is_set_up(leg):
    started = running()._replace(started=True)
    states = RUNNING.copy()
    states[leg] = DriveState.BOOT
    memory, sent = P.answer(started, Sync(0), SIX, SIX, SIX, states)
    assert {each for each, _ in sent} == set(range(6)) - {leg}
    assert list(memory.nmt) == [0 if each == leg else 5 for each in range(6)]
    states[leg] = DriveState.OFF
    _, sent = P.answer(memory, Sync(0), SIX, SIX, SIX, states)
    assert {each for each, _ in sent} == set(range(6)) - {leg}


@pytest.mark.parametrize("node", range(7))
def test_nmt_stop_takes_the_force_of_every_enabled_drive_that_it_addresses(node):
    protocol = ByValue(drives())
    states = [DriveState.RUN, DriveState.OFF, DriveState.RUN, DriveState.RUN, DriveState.OFF, DriveState.RUN]
    addressed = [leg for leg in range(6) if node in (0, leg + 1)]
    enabled = [leg for leg in addressed if states[leg] == DriveState.RUN]
    stop = Frame(0x000, bytes((0x02, node)))
    memory, messages = protocol.parse(holding(protocol.protocol, states), stop)
    assert messages == tuple(EmergencyStop((leg,)) for leg in enabled)
    assert [leg for leg in range(6) if memory.nmt[leg] == o.STOPPED] == addressed
    assert [leg for leg in range(6) if memory.state["state"][leg] == State.QUICK_STOP] == enabled
    assert protocol.parse(memory, stop)[1] == ()


def test_answers_saturate_and_come_from_the_drives_that_run_and_have_a_position():
    protocol = ByValue(drives(velocity=False))
    memory = holding(protocol.protocol, [3] * 6)
    states = np.array([0, 1, 2, 3 | INVALID, 4, 3])
    gear = protocol.transmission
    length = gear.length(np.array([1, 2, 3, 4, 1e12, -1e12]) / gear.counts)
    _, sent = protocol.answer(memory, Sync(0, (0, 1, 3, 4, 5)), length, np.zeros(6), np.zeros(6), states)
    assert [leg for leg, _ in sent] == [1, 4, 5]
    assert [struct.unpack("<Hih", frame.data)[1] for _, frame in sent] == [2, 2**31 - 1, -(2**31)]
    for frame in (Frame(0, b"\1"), Frame(0x77F, b"\5\5"), Frame(0x601, bytes(7))):
        assert protocol.parse(memory, frame) == (memory, (Rejected(),))
    assert protocol.parse(memory, Frame(0x607, bytes(8))) == (memory, ())


@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("leg", range(6))
def test_drive_never_sends_what_is_not_a_number(leg, which):
    given = [np.full(6, 1.0) for _ in range(3)]
    given[which][leg] = np.nan
    with pytest.raises(ProtocolError, match="not a number"):
        P.answer(running(), Sync(0), *given, RUNNING)


def test_each_drive_reports_the_counts_of_its_own_encoder():
    counts = [1000, 2000, 3000, 4000, 5000, 6000]
    protocol, found = ByValue(drives(NODES, counts_per_turn=counts)), []
    memory = protocol.power_up()._replace(nmt=127)
    for leg in range(6):
        (answer,) = protocol.parse(memory, write(leg, "408f600100000000"))[1]
        assert isinstance(answer, Answer)
        found.append(int.from_bytes(answer.frame.data[4:], "little"))
    assert found == counts
