"""An emulated CiA 402 drive, request by request: NMT, SDO, PDO, its faults and what it reports of them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.cia402 import objects as o
from drivers.cia402.states import State
from drivers.protocol import Frame
from drivers.signals import DriveFault, DriveMode, DriveState, Reaction
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
from plant_fmu.drives.cia402_dictionary import ENTRIES, PLACE
from tests.drivers.cia402_drives import changed, drives, holding

LEG, NODE = 3, 4
P = ByValue(drives((1, 2, 3, NODE, 5, 6), lead_m=2 * np.pi * 9e-3 / 2.5, counts_per_turn=4096))
"""Force at leg 3 of a permille: -2.5 N."""
NEW = P.power_up()


def drive(memory: Remembered = NEW, **fields: Any) -> Remembered:
    """Return drives of which that of leg 3 is in Operational with a mode of operation."""
    objects = {o.MODE: 10} | fields.pop("objects", {})
    known = {"nmt": 5, "state": State.ENABLED, "started": True, "commands": 7}
    return changed(memory, LEG, objects, **known | fields)


def field(memory: Remembered, name: str) -> int:
    return int(memory.state[name][LEG])


def raw(memory: Remembered, key: tuple[int, int]) -> int:
    return int(memory.state["values"][LEG][PLACE[key]])


def hears(memory: Remembered, node: int) -> bool:
    return P.parse(memory, Frame(0x700 + node, b"\5"))[1] == (Alive((LEG,)),)


def mapped(memory: Remembered, index: int, keys: tuple[tuple[int, int], ...]) -> Remembered:
    """Return the drives, of leg 3's the first RPDO (0x1600) or TPDO (0x1A00) made of some objects."""
    entries = {(index, k + 1): o.mapped(key, 8 * ENTRIES[key].size) for k, key in enumerate(keys)}
    return changed(memory, LEG, {(index, 0): len(keys), (o.TPDO, 2): o.AT_EVERY_SYNC} | entries)


def on_rpdo(memory: Remembered, keys: tuple[tuple[int, int], ...], data: bytes) -> tuple[Remembered, Any]:
    return P.parse(mapped(memory, o.RPDO_MAP, keys), Frame(0x200 + NODE, data))


def control(memory: Remembered, word: int, torque: int) -> tuple[Remembered, Any]:
    return on_rpdo(memory, (o.CONTROLWORD, o.TARGET_TORQUE), struct.pack("<Hh", word, torque))


def on_nmt(memory: Remembered, number: int) -> tuple[Remembered, Any]:
    return P.parse(memory, Frame(0x000, bytes((number, NODE))))


def content(memory: Remembered, keys: tuple[tuple[int, int], ...], actual: tuple[int, int, int]) -> bytes:
    """Return the first TPDO of leg 3's drive that reads a position, a speed and a torque."""
    memory, t = mapped(memory, o.TPDO_MAP, keys), P.transmission
    length = t.length(np.full(6, float(actual[0])) / t.counts)
    rate = t.m_per_turn / t.counts * actual[1]
    force = t.N_per_Nm * actual[2] * 9e-3
    state = np.full(6, DriveState.RUN, np.int64)
    _, ((_, frame),) = P.answer(memory, Sync(0, (LEG,)), length, rate, force, state)
    return frame.data


def command(mode: DriveMode, counter: int, force: float = 0.0) -> tuple[Any, ...]:
    return ((LEG,), mode, [force], counter)


def said(messages: Any) -> list[Any]:
    """Return messages, of commands what they say."""
    return [tuple(each) if isinstance(each, DeviceCommand | Sync) else each for each in plain(messages)]


def test_new_drive_has_its_own_values_and_boots_into_pre_operational():
    fields = ("nmt", "state", "commands", "started", "stops")
    assert [field(NEW, name) for name in fields] == [0, State.NOT_READY, 0, 0, 0]
    keys = (o.RATED_TORQUE, o.ENCODER_INCREMENTS, o.MOTOR_REVOLUTIONS, o.SERIAL)
    assert [raw(NEW, key) for key in keys] == [9000, 4096, 1, NODE]
    memory, sent = report(NEW, DriveState.BOOT)
    assert (field(memory, "nmt"), field(memory, "state"), sent) == (127, State.DISABLED, ["704 00"])
    fresh, _ = report(drive(objects={o.CONTROLWORD: 15, o.TARGET_TORQUE: 3}), DriveState.BOOT)
    assert fresh == changed(memory, LEG, commands=8)


@pytest.mark.parametrize(
    ("number", "nmt", "state", "messages"),
    [
        (1, 5, State.ENABLED, [Configure(LEG, 1e6, Reaction.DAMP)]),
        (128, 127, State.ENABLED, []),
        (2, 4, State.QUICK_STOP, [EmergencyStop((LEG,))]),
        (129, 127, State.DISABLED, [command(DriveMode.OFF, 8), Answer(LEG, Frame(0x704, b"\0"))]),
        (130, 127, State.DISABLED, [command(DriveMode.OFF, 8), Answer(LEG, Frame(0x704, b"\0"))]),
        (3, 5, State.ENABLED, []),
    ],
)
def test_nmt_command_is_followed_and_not_while_the_drive_boots(number, nmt, state, messages):
    memory, found = on_nmt(drive(), number)
    assert (field(memory, "nmt"), field(memory, "state"), said(found)) == (nmt, state, messages)
    assert on_nmt(drive(nmt=0), number) == (drive(nmt=0), ())
    resting, found = on_nmt(drive(state=State.SWITCHED_ON), 2)
    assert (field(resting, "nmt"), field(resting, "state"), found) == (4, State.SWITCHED_ON, ())
    assert field(on_nmt(drive(started=False), 1)[0], "started")


@pytest.mark.parametrize(
    ("consumer", "reaction", "expected"),
    [
        (127 << 16 | 50, 2, Configure(LEG, 0.05, Reaction.DAMP)),
        (127 << 16 | 50, 1, Configure(LEG, 0.05, Reaction.DAMP)),
        (127 << 16 | 50, 0, Configure(LEG, 0.05, Reaction.BRAKE)),
        (127 << 16, 0, Configure(LEG, 1e6, Reaction.BRAKE)),
    ],
)
def test_reaction_to_silence_is_the_heartbeat_time_and_the_fault_reaction(consumer, reaction, expected):
    held = {o.CONSUMER_HEARTBEAT: consumer, o.FAULT_REACTION: reaction}
    _, found = on_nmt(drive(objects=held), 1)
    assert found == (expected,)
    watches = consumer & 0xFFFF > 0
    assert [hears(drive(objects=held, nmt=n), 127) for n in (0, 4, 5)] == [False, watches, watches]
    assert not hears(drive(objects=held), 126)


@pytest.mark.parametrize(
    ("before", "word", "after", "messages"),
    [
        (
            State.SWITCHED_ON,
            0x0F,
            State.ENABLED,
            [command(DriveMode.READY, 8, -250.0), command(DriveMode.RUN, 9, -250.0)],
        ),
        (State.ENABLED, 0x0F, State.ENABLED, [command(DriveMode.RUN, 9, -250.0)]),
        (State.ENABLED, 0x02, State.QUICK_STOP, [EmergencyStop((LEG,))]),
        (State.QUICK_STOP, 0x02, State.QUICK_STOP, []),
        (State.ENABLED, 0x06, State.READY_TO_SWITCH_ON, [command(DriveMode.OFF, 8)]),
        (State.ENABLED, 0x07, State.SWITCHED_ON, [command(DriveMode.OFF, 8)]),
        (State.FAULT, 0x80, State.DISABLED, [command(DriveMode.RESET, 8)]),
        (State.FAULT, 0x00, State.FAULT, []),
        (State.DISABLED, 0x06, State.READY_TO_SWITCH_ON, [command(DriveMode.RESET, 8)]),
        (State.DISABLED, 0x00, State.DISABLED, []),
        (State.SWITCHED_ON, 0x07, State.SWITCHED_ON, []),
        (State.SWITCHED_ON, 0x06, State.READY_TO_SWITCH_ON, []),
    ],
)
def test_controlword_acts_by_the_state_that_it_leads_to(before, word, after, messages):
    memory, found = control(drive(state=before), word, 100)
    assert said(found) == messages
    assert (field(memory, "state"), field(memory, "commands")) == (after, 9)
    assert (raw(memory, o.CONTROLWORD), raw(memory, o.TARGET_TORQUE)) == (word, 100)


def test_reset_is_the_rising_edge_of_its_bit():
    for before, after in ((0x80, State.FAULT), (0x0F, State.DISABLED)):
        memory = drive(state=State.FAULT, objects={o.CONTROLWORD: before})
        assert field(control(memory, 0x80, 0)[0], "state") == after


@pytest.mark.parametrize(
    ("torque", "given"), [(600, 500), (500, 500), (499, 499), (-600, -500), (-499, -499)]
)
def test_torque_saturates_at_the_most_of_the_drive_in_both_directions(torque, given):
    _, found = control(drive(objects={o.MAX_TORQUE: 500}), 0x0F, torque)
    assert said(found) == [command(DriveMode.RUN, 9, -2.5 * given)]
    _, found = control(drive(objects={o.MODE: 0}), 0x0F, torque)
    assert said(found) == [command(DriveMode.RUN, 9)], "no mode of operation, no torque"


def test_quick_stop_by_option_code_0_disables_at_once():
    memory, found = control(drive(objects={o.QUICK_STOP: 0}), 0x02, 0)
    assert (field(memory, "state"), said(found)) == (State.DISABLED, [command(DriveMode.OFF, 8)])


def test_quick_stop_is_shown_while_it_lasts_and_a_fault_reaction_until_a_sync():
    assert field(control(drive(state=State.QUICK_STOP, stops=True), 0x02, 0)[0], "stops")
    assert not field(control(drive(state=State.ENABLED, stops=True), 0x0F, 0)[0], "stops")
    for before, after in ((State.FAULT_REACTION, State.FAULT), (State.ENABLED, State.ENABLED)):
        assert field(P.parse(drive(state=before), Frame(0x080, b""))[0], "state") == after


# PDOs


def test_pdo_is_taken_in_operational_and_one_that_is_cut_is_refused_with_an_emcy():
    keys = o.CONTROLWORD, o.TARGET_TORQUE
    data = struct.pack("<Hh", 0x0F, 100)
    assert said(on_rpdo(drive(), keys, data + b"\0")[1]) == [command(DriveMode.RUN, 9, -250.0)]
    for nmt in (0, 4, 127):
        still = mapped(drive(nmt=nmt), o.RPDO_MAP, keys)
        assert on_rpdo(still, keys, data) == (still, ())
    cut = (
        Rejected(),
        Answer(LEG, Frame(0x84, bytes.fromhex("1082010000000000"))),
    )
    assert on_rpdo(drive(), keys, data[:3])[1] == cut


def test_objects_of_a_pdo_are_taken_in_order_and_a_value_not_allowed_is_passed_over():
    keys = (o.MODE, o.TARGET_TORQUE, o.CONTROLWORD)
    memory, found = on_rpdo(drive(), keys, struct.pack("<bhH", 4, -100, 0x0F))
    assert said(found) == [command(DriveMode.RUN, 9, 250.0)]
    assert [raw(memory, key) for key in (o.MODE, o.MODE_SHOWN, o.TARGET_TORQUE)] == [4, 4, -100]
    memory, _ = on_rpdo(drive(), keys, struct.pack("<bhH", 3, -100, 0x0F))
    assert raw(memory, o.MODE) == 10
    before = drive(objects={o.TARGET_TORQUE: 50, o.CONTROLWORD: 0x0F})
    _, found = on_rpdo(before, (o.MODE,), b"\4")
    assert said(found) == [command(DriveMode.RUN, 9, -125.0)], "word and torque of before"


def test_tpdo_has_what_is_mapped_little_endian():
    shown = o.STATUSWORD, o.POSITION, o.TORQUE
    memory, actual = drive(objects={o.ERROR_CODE: 0x8130}), (-2, 3, -4)
    assert content(memory, shown, actual) == struct.pack("<Hih", 0x237, -2, -4)
    mixed = o.VELOCITY, o.ERROR_CODE, o.MODE_SHOWN
    assert content(memory, mixed, actual) == struct.pack("<iHb", 3, 0x8130, 0)


# SDO


def on_sdo(memory: Remembered, data: bytes) -> tuple[Remembered, Any]:
    return P.parse(memory, Frame(0x600 + NODE, data))


def asked(memory: Remembered, text: str) -> tuple[Remembered, list[Any]]:
    memory, messages = on_sdo(memory, bytes.fromhex(text))
    return memory, [each.frame.data.hex() if isinstance(each, Answer) else each for each in said(messages)]


REPLIES = """
4060600000000000:4f6060000a000000 4041600000000000:4b41600037020000
4064600000000000:43646000feffffff 406c600000000000:436c600003000000
4077600000000000:4b776000fcff0000 4071600000000000:4b71600032000000
4040600000000000:4b4060000f000000 403f600000000000:4b3f600030810000
4001100000000000:4f01100011000000 4000210000000000:8000210000000206
4060600100000000:8060600111000906 4164600000000000:43646000feffffff
2f6060000a000000:6060600000000000 2260600004000000:6060600000000000
2f60600003000000:8060600030000906 2b60600004000000:8060600012000706
2f17100001000000:8017100013000706 2060600004000000:8060600012000706
2116100164007f00:8016100112000706 2272600064000000:6072600000000000
2f61600001000000:8061600002000106 6060600004000000:8060600001000405
a060600004000000:8060600001000405
"""


@pytest.mark.parametrize(("request_", "reply"), [each.split(":") for each in REPLIES.split()])
def test_request_is_answered_by_its_value_its_confirmation_or_its_abort_code(request_, reply):
    read = {o.POSITION: -2, o.VELOCITY: 3, o.TORQUE: -4, o.ERROR_CODE: 0x8130, o.ERROR_REGISTER: 0x11}
    memory = drive(objects=read | {o.CONTROLWORD: 0x0F, o.TARGET_TORQUE: 50})
    assert asked(memory, request_)[1] == [reply]
    assert on_sdo(memory, bytes.fromhex(request_))[1][0].frame.id == 0x584
    for nmt in (0, 4):
        assert on_sdo(memory._replace(nmt=nmt), bytes.fromhex(request_))[1] == ()


def test_abort_of_the_client_and_a_cut_request_are_not_answered():
    assert asked(drive(), "8060600000000206")[1] == []
    assert on_sdo(drive(), bytes.fromhex("40606000000000"))[1] == (Rejected(),)


def test_write_acts_as_its_object_does():
    memory, found = asked(drive(objects={o.TARGET_TORQUE: 100}), "2b4060000f000000")
    assert found == [command(DriveMode.RUN, 9, -250.0), "6040600000000000"]
    assert raw(memory, o.CONTROLWORD) == 0x0F
    memory, found = asked(drive(), "2b7160009cff0000")
    assert (raw(memory, o.TARGET_TORQUE), found) == (-100, ["6071600000000000"])
    memory, found = asked(drive(), "2316100164007f00")
    assert found == [Configure(LEG, 0.1, Reaction.DAMP), "6016100100000000"]
    assert asked(drive(), "2316100101007f00")[1][0] == Configure(LEG, 0.001, Reaction.DAMP)
    assert asked(drive(), "2b5e600000000000")[1] == [Configure(LEG, 1e6, Reaction.BRAKE), "605e600000000000"]
    assert asked(drive(started=False), "2316100164007f00")[1] == ["6016100100000000"]


# reports


def report(
    memory: Remembered, state: DriveState, fault: DriveFault = DriveFault.NONE
) -> tuple[Remembered, list[str]]:
    memory, frames = P.report(memory, Status(LEG, int(state), int(fault)))
    assert {frame.id for frame in frames} <= {0x84, 0x704}
    return memory, [f"{frame.id:x} {frame.data.hex()}" for frame in frames]


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
def test_fault_is_an_emcy_of_its_code_and_register(fault, emcy):
    memory, sent = report(drive(), DriveState.FAULT, fault)
    assert sent == ([f"84 {emcy}"] if emcy else [])
    assert field(memory, "state") == (State.FAULT_REACTION if emcy else State.ENABLED)
    after, sent = report(memory, DriveState.OFF)
    assert sent == (["84 0000000000000000"] if emcy else [])
    assert (raw(after, o.ERROR_CODE), raw(after, o.ERROR_REGISTER)) == (0, 0)


def test_lost_heartbeat_leads_out_of_operational_where_the_drive_is_set_to_that():
    for reaction, nmt, after in ((0, 5, 127), (1, 5, 5), (0, 4, 4)):
        memory = drive(objects={o.COMMUNICATION_ERROR: reaction}, nmt=nmt)
        for fault, then in ((DriveFault.WATCHDOG, after), (DriveFault.SENSOR, nmt)):
            assert field(report(memory, DriveState.FAULT, fault)[0], "nmt") == then


def test_boot_is_reported_once_and_then_the_nmt_state_where_a_heartbeat_is_set():
    memory, sent = report(NEW, DriveState.BOOT)
    assert (field(memory, "nmt"), sent) == (127, ["704 00"])
    assert report(memory, DriveState.BOOT)[1] == []
    beats = drive(objects={o.PRODUCER_HEARTBEAT: 24})
    assert report(beats, DriveState.RUN)[1] == ["704 05"]
    assert report(changed(beats, LEG, nmt=4), DriveState.OFF)[1] == ["704 04"]
    again, sent = report(beats, DriveState.BOOT)
    assert (field(again, "nmt"), field(again, "started"), sent) == (127, 0, ["704 00"])
    assert again.values == NEW.values


@pytest.mark.parametrize("leg", range(6))
def test_fault_is_reported_once_and_once_that_it_is_over_each_time_it_comes(leg):
    memory = holding(P.protocol, [DriveState.RUN] * 6)
    for _ in range(2):
        for state, data in ((DriveState.FAULT, "3081110000000000"), (DriveState.OFF, "0000000000000000")):
            sent = []
            for _ in range(3):
                fault = DriveFault.WATCHDOG if state == DriveState.FAULT else DriveFault.NONE
                memory, frames = P.report(memory, Status(leg, state, fault))
                sent += [frame.data.hex() for frame in frames if frame.id == 0x081 + leg]
            assert sent == [data]


def test_every_quick_stop_is_shown_before_the_drive_is_disabled():
    memory = drive()
    for _ in range(2):
        memory, _ = control(memory, 0x02, 0)
        for state in (State.QUICK_STOP, State.DISABLED):
            memory, _ = report(memory, DriveState.FAULT, DriveFault.ESTOP)
            assert field(memory, "state") == state
        for word in (0x06, 0x07, 0x0F):
            memory, _ = control(memory, word, 0)
        assert field(memory, "state") == State.ENABLED
