"""The controller's end of MIT framing: what replies are heard as, and what drives are told."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError, ProtocolError
from drivers.mit.protocol import CLEAR, DISABLE, ENABLE
from drivers.protocol import FD, DriveSetup, Frame
from drivers.signals import DriveFault, DriveMode, Reaction
from tests.drivers.motor_families import Heard, MitProtocol, pack_command
from tests.drivers.spoken_drives import UNLIKE
from tests.drivers.test_mit_drive import DAMIAO, FAULT, NODES, OFF, RANGES, RUN, VARIANTS, STEP_Nm


@pytest.mark.parametrize(
    ("status", "power", "fault"),
    [(0, OFF, 0), (1, RUN, 0), (13, FAULT, DriveFault.WATCHDOG)]
    + [(code, FAULT, 0x100 + code) for code in (8, 9, 10, 11, 12, 14)],
)
def test_the_status_of_a_damiao_is_its_state_or_its_fault(status, power, fault):
    heard = DAMIAO.hear(Frame(19, bytes((status << 4 | 3, 0x80, 0, 0x80, 8, 0, 30, 30))))
    assert heard is not None
    assert (heard.leg, heard.power, heard.fault, heard.feedback) == (2, power, fault, True)


@pytest.mark.parametrize("status", [2, 3, 7, 15])
def test_a_status_that_there_is_not_cannot_be_trusted(status):
    data = bytes((status << 4 | 3, 0x80, 0, 0x80, 8, 0, 30, 30))
    assert DAMIAO.hear(Frame(19, data)) == Heard(2, broken=True)


@pytest.mark.parametrize(("name", "sizes"), [("mini_cheetah", (6, 7)), ("cubemars", (8,)), ("damiao", (8,))])
def test_a_reply_of_another_length_or_of_a_node_of_nobody_cannot_be_trusted(name, sizes):
    protocol = VARIANTS[name]
    for size in range(9):
        data = bytes((3, 0x80, 0, 0x80, 8, 0, 0, 0))[:size]
        heard = protocol.hear(Frame(19 if name == "damiao" else 0, data))
        assert heard is not None
        assert heard.broken == (size not in sizes), size
        told = (heard.power, heard.fault) == (None if name != "damiao" or heard.broken else OFF, 0)
        assert told, "no fault and no more than that"
        assert heard.leg == (0 if name != "damiao" and heard.broken else 2)
    other = protocol.hear(Frame(19 if name == "damiao" else 0, bytes((6, *bytes(sizes[-1] - 1)))))
    assert other == Heard(2 if name == "damiao" else 0, broken=True)
    assert protocol.hear(Frame(16, bytes(8))) is None


def test_a_register_of_a_damiao_is_an_answer_and_who_it_is_is_none():
    def reply(data: bytes, leg: int = 3) -> Heard | None:
        return DAMIAO.hear(Frame(NODES[leg] + 16, data))

    assert reply(b"\4\0\x33\x15" + struct.pack("<f", 95.5)) == Heard(3, answer=(21, 95.5))
    assert reply(b"\4\0\x55\x09" + struct.pack("<I", 1000)) == Heard(3, answer=(9, 1000.0))
    for register in (14, 15, 8):
        assert reply(bytes((4, 0, 0x33, register, 1, 0, 0, 0))) == Heard(3)
    for data in (b"\4\1\x33\x15", b"\4\0\x34\x15"):
        heard = reply(data + bytes(4))
        assert heard is not None
        assert heard.feedback
    assert reply(b"\3\0\x33\x15" + bytes(4)) == Heard(3, broken=True)


@pytest.mark.parametrize("leg", range(6))
def test_who_a_damiao_is_it_says_of_itself_alone(leg):
    node = NODES[leg]
    for register, what in ((15, "serial number"), (14, "revision")):
        data = bytes((node, 0, 0x33, register, 1, 2, 3, 4))
        frame = Frame(node + 16, data)
        said = DAMIAO.identity(frame)
        assert said is not None
        assert tuple(said) == (leg, what, 0x04030201)
        strange = [frame._replace(flags=FD), frame._replace(id=node + 15), frame._replace(data=data[:7])]
        strange += [frame._replace(data=bytes((*data[:k], data[k] + 1, *data[k + 1 :]))) for k in range(3)]
        strange.append(frame._replace(data=bytes((node, 0, 0x33, 9, 1, 2, 3, 4))))
        assert [DAMIAO.identity(each) for each in strange] == [None] * 7
    requests = DAMIAO.traits.identity_requests
    assert requests == tuple(
        tuple(Frame(0x7FF, bytes((n, 0, 0x33, register, 0, 0, 0, 0))) for n in NODES) for register in (15, 14)
    )
    assert VARIANTS["cubemars"].traits.identity_requests == ()
    assert VARIANTS["cubemars"].identity(Frame(0, bytes((node, 0, 0x33, 15, 1, 2, 3, 4)))) is None


# what is sent to drives


@pytest.mark.parametrize("name", VARIANTS)
def test_each_drive_is_told_by_its_own_state_and_history(name):
    protocol = VARIANTS[name]
    six: dict[str, Any] = {"power": (1, 3, 4, 1, 0, 4), "ran": (False, False, False, True, False, True)}
    begun = protocol.start(DriveSetup(0.05, Reaction.BRAKE, 250.0))
    begun = begun._replace(torque=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), **six)
    for mode in DriveMode:
        expected = [DISABLE] * 6
        if mode == DriveMode.RUN:
            torques = [pack_command(0, 0, 0, 0, float(k + 1), RANGES) for k in range(6)]
            expected = [ENABLE, torques[1], ENABLE, torques[3], ENABLE, torques[5]]
        if mode == DriveMode.RESET and name == "damiao":
            expected[2] = expected[5] = CLEAR
        polls = protocol.begin(begun._replace(mode=int(mode)), 0)
        assert polls == tuple(map(Frame, NODES, expected))


def test_a_damiao_is_set_up_with_its_mode_its_limit_and_its_three_ranges():
    (exchanges, *_, last) = DAMIAO.exchanges(DriveSetup(0.05, Reaction.BRAKE, 250.0))
    assert [(each.name, each.register, each.value) for each in exchanges] == [
        ("CTRL_MODE (register 10)", 10, 1.0),
        ("TIMEOUT (register 9)", 9, 1000.0),
        ("PMAX (register 21)", 21, 95.5),
        ("VMAX (register 22)", 22, 400.0),
        ("TMAX (register 23)", 23, 144.0),
    ]
    assert [each.frames for each in last] == [
        (Frame(0x7FF, bytes.fromhex("0f00550a01000000")),),
        (Frame(0x7FF, bytes.fromhex("0f005509e8030000")),),
        *((Frame(0x7FF, bytes((15, 0, 0x33, register, 0, 0, 0, 0))),) for register in (21, 22, 23)),
    ]


@pytest.mark.parametrize(("watchdog_s", "ticks"), [(0.000026, 1), (0.000024, 0), (0.01, 200)])
def test_a_limit_of_silence_is_counted_in_50_us_and_one_of_none_is_refused(watchdog_s, ticks):
    setup = DriveSetup(watchdog_s, Reaction.BRAKE, 250.0)
    if ticks:
        assert DAMIAO.exchanges(setup)[0][1].value == ticks
        return
    with pytest.raises(ProtocolError, match=f"drive watchdog of {watchdog_s} s: Damiao counts it in 50 us"):
        DAMIAO.exchanges(setup)


@pytest.mark.parametrize(("name", "most"), [("damiao", 15), ("cubemars", 127), ("mini_cheetah", 127)])
def test_a_node_is_one_that_a_reply_can_name(name, most):
    for node in (0, 1, most, most + 1):
        nodes = (2, 3, 4, 5, 6, node)
        if 1 <= node <= most:
            MitProtocol(name, RANGES, nodes, 16 if name == "damiao" else 0, UNLIKE)
            continue
        text = rf"drives.node_ids\[5\]: .* variant {name}: 1 to {most}, .* given: {node}$"
        with pytest.raises(ConfigurationError, match=text):
            MitProtocol(name, RANGES, nodes, 0, UNLIKE)


@pytest.mark.parametrize(
    ("name", "host", "reply"),
    [
        ("cubemars", 3, 3),
        ("cubemars", 0x7FF, 0x7FF),
        ("cubemars", -1, -1),
        ("damiao", 1, 2),
        ("damiao", 0x7FE, 0x7FF),
    ],
)
def test_replies_that_come_on_a_drives_own_identifier_or_on_none_are_refused(name, host, reply):
    with pytest.raises(
        ConfigurationError, match=f"host_id {host} makes replies come on {reply:#x}, a drive's"
    ):
        MitProtocol(name, RANGES, NODES, host, UNLIKE)
    last = 0x7FE if name == "cubemars" else 0x7FE - 15
    MitProtocol(name, RANGES, NODES, last, UNLIKE)


@pytest.mark.parametrize("name", VARIANTS)
def test_the_largest_torque_is_that_of_the_top_code(name):
    assert VARIANTS[name].torque_limit == pytest.approx(0xFFB * STEP_Nm - 144.0, rel=1e-12)
    polls, stops = VARIANTS[name].traits.cyclic_frames[:6], VARIANTS[name].traits.emergency_stop
    assert stops == tuple(Frame(node, DISABLE) for node in NODES)
    assert polls == tuple(Frame(node, pack_command(0.0, 0.0, 0.0, 0.0, -144.0, RANGES)) for node in NODES)
    assert len(VARIANTS[name].traits.cyclic_frames) == 12


def test_a_damiao_is_named_in_a_register_request_by_two_bytes():
    def leg(data: bytes, identifier: int = 0x7FF) -> tuple[int, ...]:
        legs: tuple[int, ...] = DAMIAO.addressed(Frame(identifier, data))
        return legs

    assert [leg(bytes((node, 0, 0x33))) for node in NODES] == [(k,) for k in range(6)]
    assert [leg(b"\4\1"), leg(b"\4"), leg(b"")] == [(), (), ()]
    assert [leg(b"", node) for node in (4, 6)] == [(3,), ()]
    assert VARIANTS["cubemars"].addressed(Frame(0x7FF, b"\4\0")) == ()


def test_what_a_torque_field_carries_is_truncated_to_its_twelve_bits():
    torque = np.array([10.0, -20.0, 30.0, 0.0, 143.0, -144.0])
    expected = np.floor((torque + 144.0) / STEP_Nm) * STEP_Nm - 144.0
    for protocol in VARIANTS.values():
        np.testing.assert_allclose(protocol.coded(torque), expected, rtol=0, atol=1e-9)


def test_a_step_of_each_field_is_what_a_reading_is_off_by():
    tau, per_turn = 2 * np.pi, np.abs(UNLIKE.m_per_turn)
    length, rate, force, differences = DAMIAO.traits.resolution.at(250.0)
    np.testing.assert_allclose(length, 191.0 / 65535 / tau * per_turn, rtol=1e-12)
    np.testing.assert_allclose(rate, 800.0 / 4095 / tau * per_turn, rtol=1e-12)
    np.testing.assert_allclose(force, STEP_Nm * np.abs(UNLIKE.N_per_Nm), rtol=1e-12)
    assert differences is False


def test_a_request_for_a_register_of_a_damiao_is_another_controllers_and_other_variants_have_none():
    assert DAMIAO.hear(Frame(0x7FF, bytes(8))) == Heard(0, foreign=True)
    assert VARIANTS["cubemars"].exchanges(DriveSetup(0.05, Reaction.BRAKE, 250.0)) == ((),) * 6


@pytest.mark.parametrize("code", [0, 1, 0x8000, 0xFFFE, 0xFFFF])
@pytest.mark.parametrize("name", ["mini_cheetah", "cubemars", "damiao"])
def test_an_end_of_the_position_is_no_reading_where_replies_saturate_and_is_one_where_they_wrap(name, code):
    protocol = VARIANTS[name]
    tail = {"mini_cheetah": b"", "cubemars": bytes((30, 0)), "damiao": bytes((30, 30))}[name]
    first = 0x13 if name == "damiao" else 3
    data = bytes((first, code >> 8, code & 0xFF, 0x80, 0x08, 0)) + tail
    heard = protocol.hear(Frame(19 if name == "damiao" else 0, data))
    assert heard is not None
    assert (heard.leg, heard.broken, heard.feedback) == (2, False, True)
    assert (heard.motion is None) == (name != "mini_cheetah" and code in (0, 0xFFFF))
