"""Emulated CiA 402 drives, request by request: NMT, SDO, PDO, heartbeats, faults and their reports."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.cia402 import objects as o
from drivers.cia402.states import State
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.signals import INVALID, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.drives_end import plain
from hil.contracts.messages import (
    Alive,
    Answer,
    Configure,
    DeviceCommand,
    EmergencyStop,
    Rejected,
    Status,
    Sync,
)
from plant_fmu.drives.cia402_dictionary import PLACE
from tests.drivers.cia402_drives import changed, drives, holding

LEG, NODE = 3, 4
P = ByValue(drives((1, 2, 3, NODE, 5, 6), lead_m=2 * np.pi * 9e-3 / 2.5, counts_per_turn=4096))
"""Force at leg 3 per permille: -2.5 N."""
ALL_RUN = np.full(6, DriveState.RUN)
HELD = holding(P.protocol, ALL_RUN)
OFF, READY, RUN, RESET = DriveMode


def drive(**fields: Any) -> Remembered:
    """Configured drives; the drive of leg 3 has changed objects and fields."""
    objects = {o.CONSUMER_HEARTBEAT: 127 << 16, o.PRODUCER_HEARTBEAT: 0, o.FAULT_REACTION: 2} | fields.pop(
        "objects", {}
    )
    return changed(HELD, LEG, objects, **{"started": True, "commands": 7} | fields)


def field(memory: Remembered, name: str) -> int:
    return int(memory.state[name][LEG])


def raw(memory: Remembered, key: tuple[int, int]) -> int:
    return int(memory.state["values"][LEG][PLACE[key]])


def command(mode: DriveMode, counter: int, force: float = 0.0) -> tuple[Any, ...]:
    return ((LEG,), mode, [force], counter)


def said(messages: Any) -> list[Any]:
    """Messages: a command as its fields, an answer as its bytes."""
    found = [tuple(each) if isinstance(each, DeviceCommand | Sync) else each for each in plain(messages)]
    return [each.frame.data.hex() if isinstance(each, Answer) else each for each in found]


def given(memory: Remembered, identifier: int, data: bytes) -> tuple[Remembered, list[Any]]:
    memory, messages = P.parse(memory, Frame(identifier, data))
    return memory, said(messages)


def control(memory: Remembered, word: int, torque: int = 0) -> tuple[Remembered, list[Any]]:
    return given(memory, 0x200 + NODE, struct.pack("<Hh", word, torque))


def report(
    memory: Remembered, state: DriveState, fault: DriveFault = DriveFault.NONE
) -> tuple[Remembered, list[str]]:
    memory, frames = P.report(memory, Status(LEG, int(state), int(fault)))
    return memory, [f"{frame.id:x} {frame.data.hex()}" for frame in frames]


@pytest.mark.parametrize(
    ("number", "nmt", "state", "messages"),
    [
        (1, 5, State.ENABLED, [Configure(LEG, 1e6, Reaction.DAMP)]),
        (128, 127, State.ENABLED, []),
        (2, 4, State.QUICK_STOP, [EmergencyStop((LEG,))]),
        (129, 127, State.DISABLED, [command(OFF, 8), "00"]),
        (130, 127, State.DISABLED, [command(OFF, 8), "00"]),
        (3, 5, State.ENABLED, []),
    ],
)
def test_nmt_command_is_obeyed_except_while_the_drive_boots(number, nmt, state, messages):
    memory, found = given(drive(), 0, bytes((number, NODE)))
    assert (field(memory, "nmt"), field(memory, "state"), found) == (nmt, state, messages)
    assert given(drive(nmt=0), 0, bytes((number, NODE))) == (drive(nmt=0), [])


@pytest.mark.parametrize("node", [0, 1, 2])
def test_nmt_stop_removes_the_force_of_each_addressed_enabled_drive(node):
    states = [DriveState.RUN, DriveState.OFF, DriveState.RUN, DriveState.RUN, DriveState.OFF, DriveState.RUN]
    addressed = [leg for leg in range(6) if node in (0, leg + 1)]
    memory, found = given(holding(P.protocol, states), 0, bytes((0x02, node)))
    assert found == [EmergencyStop((leg,)) for leg in addressed if states[leg] == DriveState.RUN]
    assert [leg for leg in range(6) if memory.nmt[leg] == o.STOPPED] == addressed
    assert given(memory, 0, bytes((0x02, node)))[1] == []


@pytest.mark.parametrize(("time_ms", "reaction"), [(50, 2), (50, 1), (50, 0), (0, 0)])
def test_heartbeat_time_and_fault_reaction_set_the_watchdog_reaction(time_ms, reaction):
    held = {o.CONSUMER_HEARTBEAT: 127 << 16 | time_ms, o.FAULT_REACTION: reaction}
    expected = Configure(LEG, 1e-3 * time_ms or 1e6, Reaction.DAMP if reaction else Reaction.BRAKE)
    assert given(drive(objects=held), 0, bytes((1, NODE)))[1] == [expected]
    for nmt in (0, 4, 5):
        (alive,) = given(drive(objects=held, nmt=nmt), 0x77F, b"\5")[1]
        assert alive == Alive(tuple(leg for leg in range(6) if leg != LEG or (time_ms and nmt)))
    assert given(drive(objects=held), 0x77E, b"\5")[1] == []


@pytest.mark.parametrize(
    ("before", "word", "after", "messages"),
    [
        (State.SWITCHED_ON, 0x0F, State.ENABLED, [command(READY, 8, -250.0), command(RUN, 9, -250.0)]),
        (State.ENABLED, 0x0F, State.ENABLED, [command(RUN, 9, -250.0)]),
        (State.ENABLED, 0x02, State.QUICK_STOP, [EmergencyStop((LEG,))]),
        (State.QUICK_STOP, 0x02, State.QUICK_STOP, []),
        (State.ENABLED, 0x06, State.READY_TO_SWITCH_ON, [command(OFF, 8)]),
        (State.ENABLED, 0x07, State.SWITCHED_ON, [command(OFF, 8)]),
        (State.FAULT, 0x80, State.DISABLED, [command(RESET, 8)]),
        (State.FAULT, 0x00, State.FAULT, []),
        (State.DISABLED, 0x06, State.READY_TO_SWITCH_ON, [command(RESET, 8)]),
        (State.DISABLED, 0x00, State.DISABLED, []),
        (State.SWITCHED_ON, 0x07, State.SWITCHED_ON, []),
    ],
)
def test_controlword_changes_state_and_force_as_the_cia402_automaton(before, word, after, messages):
    memory, found = control(drive(state=before), word, 100)
    assert found == messages
    assert (field(memory, "state"), field(memory, "commands")) == (after, 9)
    assert (raw(memory, o.CONTROLWORD), raw(memory, o.TARGET_TORQUE)) == (word, 100)
    held = drive(state=State.FAULT, objects={o.CONTROLWORD: 0x80})
    assert field(control(held, 0x80)[0], "state") == State.FAULT, "no rising edge"


@pytest.mark.parametrize(("torque", "taken"), [(600, 500), (499, 499), (-600, -500), (-499, -499)])
def test_torque_saturates_at_max_torque_and_is_zero_without_a_mode(torque, taken):
    assert control(drive(objects={o.MAX_TORQUE: 500}), 0x0F, torque)[1] == [command(RUN, 9, -2.5 * taken)]
    assert control(drive(objects={o.MODE: 0}), 0x0F, torque)[1] == [command(RUN, 9)]


def test_quick_stop_reports_quick_stop_active_once_and_with_option_0_disables_the_drive_at_once():
    memory = drive()
    for _ in range(2):
        memory, _ = control(memory, 0x02)
        for state in (State.QUICK_STOP, State.DISABLED):
            memory, _ = report(memory, DriveState.FAULT, DriveFault.ESTOP)
            assert field(memory, "state") == state
        for word in (0x06, 0x07, 0x0F):
            memory, _ = control(memory, word)
        assert field(memory, "state") == State.ENABLED
    memory, found = control(drive(objects={o.QUICK_STOP: 0}), 0x02)
    assert (field(memory, "state"), found) == (State.DISABLED, [command(OFF, 8)])


def test_pdo_acts_on_a_drive_in_operational_only_and_a_short_pdo_causes_an_emcy():
    assert given(drive(), 0x204, struct.pack("<Hhx", 0x0F, 100))[1] == [command(RUN, 9, -250.0)]
    for nmt in (0, 4, 127):
        assert control(drive(nmt=nmt), 0x0F, 100) == (drive(nmt=nmt), [])
    assert given(drive(), 0x204, b"\x0f\0\1")[1] == [Rejected(), "1082010000000000"]
    for flag in (EXTENDED, FD, REMOTE, ERROR):
        for frame in (Frame(0x80, b"", flag), Frame(0x204, bytes(4), flag), Frame(0, b"\2\0", flag)):
            assert P.parse(HELD, frame) == (HELD, ())


@pytest.mark.parametrize(
    ("fault", "emcy"),
    [
        (DriveFault.WATCHDOG, "3081110000000000"),
        (DriveFault.OVERFORCE, "1183010000000000"),
        (DriveFault.SENSOR, "0573010000000000"),
        (DriveFault.STROKE, "1286010000000000"),
        (DriveFault.ESTOP, ""),
    ],
)
def test_drive_sends_one_emcy_when_a_fault_begins_and_one_when_the_fault_ends(fault, emcy):
    memory = drive(objects={o.COMMUNICATION_ERROR: 1})
    for _ in range(2):
        for state, data in ((DriveState.FAULT, emcy), (DriveState.OFF, "0000000000000000")):
            sent = []
            for _ in range(3):
                memory, more = report(memory, state, fault if state == DriveState.FAULT else DriveFault.NONE)
                sent += more
            assert sent == ([f"84 {data}"] if emcy else [])
    assert (raw(memory, o.ERROR_CODE), raw(memory, o.ERROR_REGISTER)) == (0, 0)
    for reaction, nmt, after in ((0, 5, 127), (1, 5, 5), (0, 4, 4)):
        memory, _ = report(drive(objects={o.COMMUNICATION_ERROR: reaction}, nmt=nmt), DriveState.FAULT, fault)
        assert field(memory, "nmt") == (after if fault == DriveFault.WATCHDOG else nmt)


def test_sync_is_answered_only_by_operational_drives_with_a_valid_position():
    zeros = np.zeros(6)
    for lost in range(6):
        states = np.array([1, 2, 3, 4, 3, 3])
        states[lost] |= INVALID
        answered = [leg for leg, _ in P.answer(HELD, Sync(0), zeros + 0.7, zeros, zeros, states)[1]]
        assert answered == [leg for leg in range(6) if leg != lost for _ in range(2)]
    states = ALL_RUN.copy()
    states[LEG] = DriveState.BOOT
    memory, sent = P.answer(drive(), Sync(0), zeros, zeros, zeros, states)
    assert {leg for leg, _ in sent} == set(range(6)) - {LEG}
    assert list(memory.nmt) == [0 if leg == LEG else 5 for leg in range(6)]
    answers = P.answer(memory, Sync(0), zeros, zeros, zeros, ALL_RUN)[1]
    assert {leg for leg, _ in answers} == set(range(6)) - {LEG}
    memory = changed(changed(changed(HELD, 1, nmt=127), 2, nmt=4), 4, state=State.FAULT_REACTION)
    memory, messages = P.parse(memory, Frame(0x80, b""))
    assert messages == (Sync(0, (0, 3, 4, 5)),), "in Operational"
    assert memory.state["state"].tolist() == [State.FAULT if leg == 4 else State.ENABLED for leg in range(6)]
