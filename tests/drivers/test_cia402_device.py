"""An emulated CiA 402 drive, request by request: NMT, SDO, PDO, its faults and what it reports of them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.cia402 import objects as o
from drivers.cia402.device import (
    Device,
    booted,
    control,
    emergency,
    on_nmt,
    on_sdo,
    powered_up,
    restarted,
)
from drivers.cia402.dictionary import ENTRIES, missing, pdos, refused, signed, with_value
from drivers.cia402.states import State
from drivers.protocol import Alive, Answer, Configure, EmergencyStop, Frame, Rejected, Status, Sync
from drivers.signals import INVALID, DriveFault, DriveMode, DriveState, Reaction
from tests.drivers.cia402_drives import drives
from tests.drivers.drives_end import plain

LEG, NODE = 3, 4
NEW = powered_up(LEG, NODE, 9000, (4096, 2), -2.5)
"""Force at the leg of a permille: -2.5 N."""


def drive(**fields: Any) -> Device:
    """Return a drive in Operational with a mode of operation; objects are given by their key as text."""
    values = with_value(NEW.values, o.MODE, 10)
    for key, value in fields.pop("objects", {}).items():
        values = with_value(values, key, value)
    known: dict[str, Any] = {
        "values": values,
        "nmt": 5,
        "state": State.ENABLED,
        "started": True,
        "commands": 7,
    }
    return NEW._replace(**known | fields)


P = drives((1, 2, 3, NODE, 5, 6))


def among(device: Device) -> Any:
    """Return the memory of six drives, of which this is one."""
    devices = P.power_up().devices
    return P.power_up()._replace(devices=(*devices[:LEG], device, *devices[LEG + 1 :]))


def parsed(device: Device, identifier: int, data: bytes) -> tuple[Device, tuple[Any, ...]]:
    """Return the drive after a frame, and what that says."""
    memory, messages = P.parse(among(device), Frame(identifier, data))
    return memory.devices[LEG], messages


def hears(device: Device, node: int) -> bool:
    return parsed(device, 0x700 + node, b"\5")[1] == (Alive((LEG,)),)


def at_sync(device: Device) -> Device:
    return parsed(device, 0x080, b"")[0]


def mapped(device: Device, index: int, keys: tuple[tuple[int, int], ...]) -> Device:
    """Return the drive with its first RPDO (0x1600) or TPDO (0x1A00) made of some objects."""
    values = with_value(device.values, (index, 0), len(keys))
    for k, key in enumerate(keys):
        values = with_value(values, (index, k + 1), o.mapped(key, 8 * ENTRIES[key].size))
    return device._replace(values=values)


def on_rpdo(device: Device, keys: tuple[tuple[int, int], ...], data: bytes) -> tuple[Device, Any]:
    return parsed(mapped(device, o.RPDO_MAP, keys), 0x200 + NODE, data)


def content(device: Device, keys: tuple[tuple[int, int], ...]) -> bytes:
    """Return the first TPDO of a drive, all that it reads being 0 but for what it has read last."""
    device = mapped(device, o.TPDO_MAP, keys)
    device = device._replace(values=with_value(device.values, (o.TPDO, 2), o.AT_EVERY_SYNC))
    t, actual = P.transmission, np.array(device.actual, float)
    length = t.length_of_counts(np.full(6, actual[0]))
    rate = t.m_per_turn / t.counts * actual[1]
    force = t.N_per_Nm * actual[2] * 9e-3
    state = np.full(6, DriveState.RUN, np.int64)
    _, ((_, frame),) = P.answer(among(device), Sync(0, (LEG,)), length, rate, force, state)
    return frame.data


def command(mode: DriveMode, counter: int, force: float = 0.0) -> tuple[Any, ...]:
    return ((LEG,), mode, [force], counter)


def said(messages: Any) -> list[Any]:
    """Return messages, of commands what they say."""
    return [tuple(each) if hasattr(each, "counter") else each for each in plain(messages)]


def test_a_drive_that_was_powered_up_has_its_own_values_and_booting_makes_it_pre_operational():
    assert (NEW.nmt, NEW.state, NEW.word, NEW.torque, NEW.actual) == (0, State.NOT_READY, 0, 0, (0, 0, 0))
    assert (NEW.error, NEW.commands, NEW.started, NEW.stops) == (0, 0, False, False)
    found = {
        key: NEW.raw(key) for key in (o.RATED_TORQUE, o.ENCODER_INCREMENTS, o.MOTOR_REVOLUTIONS, o.SERIAL)
    }
    assert list(found.values()) == [9000, 4096, 2, NODE]
    device, frame = booted(NEW)
    assert (device.nmt, device.state, frame) == (127, State.DISABLED, Frame(0x704, b"\0"))
    fresh = restarted(drive(word=15, torque=3, error=7))
    assert fresh == NEW._replace(commands=8)


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
def test_an_nmt_command_is_followed_and_not_while_the_drive_boots(number, nmt, state, messages):
    device, found = on_nmt(drive(), number)
    assert (device.nmt, device.state, said(found)) == (nmt, state, messages)
    assert on_nmt(drive(nmt=0), number) == (drive(nmt=0), ())
    resting, found = on_nmt(drive(state=State.SWITCHED_ON), 2)
    assert (resting.nmt, resting.state, found) == (4, State.SWITCHED_ON, ())
    assert on_nmt(drive(started=False), 1)[0].started


@pytest.mark.parametrize(
    ("consumer", "reaction", "expected"),
    [
        (127 << 16 | 50, 2, Configure(LEG, 0.05, Reaction.DAMP)),
        (127 << 16 | 50, 1, Configure(LEG, 0.05, Reaction.DAMP)),
        (127 << 16 | 50, 0, Configure(LEG, 0.05, Reaction.BRAKE)),
        (127 << 16, 0, Configure(LEG, 1e6, Reaction.BRAKE)),
    ],
)
def test_what_a_drive_does_in_silence_is_its_heartbeat_time_and_its_fault_reaction(
    consumer, reaction, expected
):
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
def test_a_controlword_acts_by_the_state_that_it_leads_to(before, word, after, messages):
    device, found = control(drive(state=before), word, 100)
    assert said(found) == messages
    assert (device.state, device.word, device.torque, device.commands) == (after, word, 100, 9)


def test_a_reset_is_the_rising_edge_of_its_bit():
    assert control(drive(state=State.FAULT, word=0x80), 0x80, 0)[0].state is State.FAULT
    assert control(drive(state=State.FAULT, word=0x0F), 0x80, 0)[0].state is State.DISABLED


@pytest.mark.parametrize(
    ("torque", "given"), [(600, 500), (500, 500), (499, 499), (-600, -500), (-499, -499)]
)
def test_a_torque_saturates_at_the_most_of_the_drive_in_both_directions(torque, given):
    _, found = control(drive(objects={o.MAX_TORQUE: 500}), 0x0F, torque)
    assert said(found) == [command(DriveMode.RUN, 9, -2.5 * given)]
    _, found = control(drive(objects={o.MODE: 0}), 0x0F, torque)
    assert said(found) == [command(DriveMode.RUN, 9)], "no mode of operation, no torque"


def test_a_quick_stop_by_option_code_0_disables_at_once():
    device, found = control(drive(objects={o.QUICK_STOP: 0}), 0x02, 0)
    assert (device.state, said(found)) == (State.DISABLED, [command(DriveMode.OFF, 8)])


def test_a_quick_stop_is_shown_for_as_long_as_it_lasts_and_a_fault_reaction_until_a_sync():
    assert control(drive(state=State.QUICK_STOP, stops=True), 0x02, 0)[0].stops
    assert not control(drive(state=State.ENABLED, stops=True), 0x0F, 0)[0].stops
    assert at_sync(drive(state=State.FAULT_REACTION)).state is State.FAULT
    assert at_sync(drive()).state is State.ENABLED


# PDOs


def test_a_pdo_is_taken_in_operational_and_one_that_is_cut_is_refused_with_an_emcy():
    keys = o.CONTROLWORD, o.TARGET_TORQUE
    (pdo, *_) = pdos(mapped(drive(), o.RPDO_MAP, keys).values, o.RPDO, o.RPDO_MAP)
    assert (pdo.id, pdo.size, pdo.keys) == (0x204, 4, keys)
    data = struct.pack("<Hh", 0x0F, 100)
    assert said(on_rpdo(drive(), keys, data + b"\0")[1]) == [command(DriveMode.RUN, 9, -250.0)]
    for nmt in (0, 4, 127):
        still = mapped(drive(nmt=nmt), o.RPDO_MAP, keys)
        assert on_rpdo(still, keys, data) == (still, ())
    cut = (
        Rejected("PDO of 3 bytes, mapped are 4"),
        Answer(LEG, Frame(0x84, bytes.fromhex("1082010000000000"))),
    )
    assert on_rpdo(drive(), keys, data[:3])[1] == cut


def test_the_objects_of_a_pdo_are_taken_in_their_order_and_what_is_not_allowed_is_passed_over():
    keys = (o.MODE, o.TARGET_TORQUE, o.CONTROLWORD)
    device, found = on_rpdo(drive(), keys, struct.pack("<bhH", 4, -100, 0x0F))
    assert said(found) == [command(DriveMode.RUN, 9, 250.0)]
    assert (device.get(o.MODE), device.get(o.MODE_SHOWN), device.torque) == (4, 4, -100)
    device, _ = on_rpdo(drive(), keys, struct.pack("<bhH", 3, -100, 0x0F))
    assert device.get(o.MODE) == 10
    device, found = on_rpdo(drive(torque=50, word=0x0F), (o.MODE,), b"\4")
    assert said(found) == [command(DriveMode.RUN, 9, -125.0)], "word and torque of before"


def test_a_tpdo_has_what_is_mapped_little_endian():
    shown = o.STATUSWORD, o.POSITION, o.TORQUE
    device = drive(actual=(-2, 3, -4), error=0x8130)
    assert content(device, shown) == struct.pack("<Hih", 0x237, -2, -4)
    mixed = o.VELOCITY, o.ERROR_CODE, o.MODE_SHOWN
    assert content(device, mixed) == struct.pack("<iHb", 3, 0x8130, 0)


# SDO


def asked(device: Device, text: str) -> tuple[Device, list[Any]]:
    device, messages = on_sdo(device, bytes.fromhex(text))
    return device, [each.frame.data.hex() if isinstance(each, Answer) else each for each in said(messages)]


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        ("4060600000000000", "4f6060000a000000"),
        ("4041600000000000", "4b41600037020000"),
        ("4064600000000000", "43646000feffffff"),
        ("406c600000000000", "436c600003000000"),
        ("4077600000000000", "4b776000fcff0000"),
        ("4071600000000000", "4b71600032000000"),
        ("4040600000000000", "4b4060000f000000"),
        ("403f600000000000", "4b3f600030810000"),
        ("4001100000000000", "4f01100011000000"),
        ("4000210000000000", "8000210000000206"),
        ("4060600100000000", "8060600111000906"),
        ("4164600000000000", "43646000feffffff"),
        ("2f6060000a000000", "6060600000000000"),
        ("2260600004000000", "6060600000000000"),
        ("2f60600003000000", "8060600030000906"),
        ("2b60600004000000", "8060600012000706"),
        ("2f17100001000000", "8017100013000706"),
        ("2060600004000000", "8060600012000706"),
        ("2116100164007f00", "8016100112000706"),
        ("2272600064000000", "6072600000000000"),
        ("2f61600001000000", "8061600002000106"),
        ("6060600004000000", "8060600001000405"),
        ("a060600004000000", "8060600001000405"),
    ],
)
def test_a_request_is_answered_by_its_value_its_confirmation_or_its_abort_code(request_, reply):
    device = drive(actual=(-2, 3, -4), error=0x8130, word=0x0F, torque=50)
    assert asked(device, request_)[1] == [reply]
    assert on_sdo(device, bytes.fromhex(request_))[1][0].frame.id == 0x584  # type: ignore[union-attr]
    for nmt in (0, 4):
        assert on_sdo(device._replace(nmt=nmt), bytes.fromhex(request_))[1] == ()


def test_an_abort_of_the_client_and_a_request_that_is_cut_are_not_answered():
    assert asked(drive(), "8060600000000206")[1] == []
    assert on_sdo(drive(), bytes.fromhex("40606000000000"))[1] == ()


def test_a_write_acts_as_its_object_does():
    device, found = asked(drive(torque=100), "2b4060000f000000")
    assert found == [command(DriveMode.RUN, 9, -250.0), "6040600000000000"]
    assert device.word == 0x0F
    device, found = asked(drive(), "2b7160009cff0000")
    assert (device.torque, found) == (-100, ["6071600000000000"])
    device, found = asked(drive(), "2316100164007f00")
    assert found == [Configure(LEG, 0.1, Reaction.DAMP), "6016100100000000"]
    assert asked(drive(), "2316100101007f00")[1][0] == Configure(LEG, 0.001, Reaction.DAMP)
    assert asked(drive(), "2b5e600000000000")[1] == [Configure(LEG, 1e6, Reaction.BRAKE), "605e600000000000"]
    assert asked(drive(started=False), "2316100164007f00")[1] == ["6016100100000000"]


# reports


def report(
    device: Device, state: DriveState, fault: DriveFault = DriveFault.NONE
) -> tuple[Device, list[str]]:
    memory, frames = P.report(among(device), Status(LEG, int(state), int(fault)))
    device = memory.devices[LEG]
    assert {frame.id for frame in frames} <= {0x84, 0x704}
    return device, [f"{frame.id:x} {frame.data.hex()}" for frame in frames]


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
def test_a_fault_is_an_emcy_of_its_code_and_register_once_and_once_that_it_is_over(fault, emcy):
    device, sent = report(drive(), DriveState.FAULT, fault)
    assert sent == ([f"84 {emcy}"] if emcy else [])
    assert device.state is (State.FAULT_REACTION if emcy else State.ENABLED)
    again, sent = report(device, DriveState.FAULT, fault)
    assert (again, sent) == (device, [])
    after, sent = report(device, DriveState.OFF)
    assert sent == (["84 0000000000000000"] if emcy else [])
    assert after.error == 0
    assert emergency(drive(), 0x8210).data[2] == 1


def test_a_lost_heartbeat_leads_out_of_operational_where_the_drive_is_set_to_that():
    for reaction, nmt, after in ((0, 5, 127), (1, 5, 5), (0, 4, 4)):
        device = drive(objects={o.COMMUNICATION_ERROR: reaction}, nmt=nmt)
        assert report(device, DriveState.FAULT, DriveFault.WATCHDOG)[0].nmt == after
        assert report(device, DriveState.FAULT, DriveFault.SENSOR)[0].nmt == nmt


def test_a_drive_says_that_it_boots_once_and_then_its_nmt_state_where_a_heartbeat_is_set():
    device, sent = report(NEW, DriveState.BOOT)
    assert (device.nmt, sent) == (127, ["704 00"])
    assert report(device, DriveState.BOOT)[1] == []
    beats = drive(objects={o.PRODUCER_HEARTBEAT: 24})
    assert report(beats, DriveState.RUN)[1] == ["704 05"]
    assert report(beats._replace(nmt=4), DriveState.OFF)[1] == ["704 04"]
    again, sent = report(beats, DriveState.BOOT)
    assert (again.nmt, again.started, sent) == (127, False, ["704 00"])
    assert again.values == NEW.values


def test_a_quick_stop_is_over_when_it_has_been_reported_once():
    device, _ = report(drive(state=State.QUICK_STOP), DriveState.FAULT, DriveFault.ESTOP)
    assert (device.state, device.stops) == (State.QUICK_STOP, True)
    assert report(device, DriveState.FAULT, DriveFault.ESTOP)[0].state is State.DISABLED


# the dictionary


def test_an_object_is_signed_as_it_is_declared():
    assert [signed(o.MODE, raw) for raw in (0x7F, 0x80, 0xFF)] == [127, -128, -1]
    assert [signed(o.MAX_TORQUE, raw) for raw in (0x7FFF, 0xFFFF)] == [32767, 65535]
    assert [missing(key) for key in (o.MODE, (0x6060, 1), (0x2000, 0))] == [0, o.NO_SUB_INDEX, o.NO_OBJECT]


@pytest.mark.parametrize(
    ("cob", "code"),
    [
        (0x204, 0),
        (0x80000204, 0),
        (0, o.BAD_VALUE),
        (1, 0),
        (0x7FF, 0),
        (0x800, o.BAD_VALUE),
        (0xC0000000, 0),
    ],
)
def test_the_identifier_of_a_pdo_that_exists_has_eleven_bits_and_is_none_of_nmt(cob, code):
    off = with_value(NEW.values, (0x1400, 1), 0x80000204)
    assert refused(off, (0x1400, 1), cob, 4) == code
    on = with_value(NEW.values, (0x1400, 1), 0x204)
    assert refused(on, (0x1400, 1), 0x205, 4) == o.BAD_STATE
    assert refused(on, (0x1400, 1), 0x204, 4) == refused(on, (0x1400, 1), 0x80000205, 4) == 0


# six of them


def test_what_six_drives_answer_saturates_and_comes_from_those_that_run_and_have_a_position():
    protocol = drives(velocity=False)
    memory = protocol._devices.set_up(protocol._settings, np.full(6, 3))
    states = np.array([0, 1, 2, 3 | INVALID, 4, 3])
    length = protocol.transmission.length_of_counts(np.array([1, 2, 3, 4, 1e12, -1e12]))
    _, sent = protocol.answer(memory, Sync(0, (0, 1, 3, 4, 5)), length, np.zeros(6), np.zeros(6), states)
    assert [leg for leg, _ in sent] == [1, 4, 5]
    assert [struct.unpack("<Hih", frame.data)[1] for _, frame in sent] == [2, 2**31 - 1, -(2**31)]
    for text, frame in (
        ("NMT command of 1 bytes", Frame(0, b"\1")),
        ("heartbeat of 2 bytes", Frame(0x77F, b"\5\5")),
        ("SDO request of 7 bytes", Frame(0x601, bytes(7))),
    ):
        assert protocol.parse(memory, frame) == (memory, (Rejected(text),))
    assert protocol.parse(memory, Frame(0x607, bytes(8))) == (memory, ())
