"""RobStride's own framing: what a drive obeys and answers, and both ends of its identifiers."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError, ProtocolError
from drivers.mit.fields import Ranges
from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, DriveSetup, Frame, Said
from drivers.signals import INVALID, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import Remembered
from hil.contracts.drives_end import command, plain
from hil.contracts.messages import Answer, Configure, Rejected, Sync
from tests.drivers.motor_families import Heard, RobStrideProtocol
from tests.drivers.spoken_drives import UNLIKE

NODES = (1, 2, 3, 4, 5, 127)
P = RobStrideProtocol(Ranges(95.5, 400.0, 144.0), NODES, 253, UNLIKE)
STEP_Nm = 288.0 / 65535
DELIVERED = Configure(3, 1e6, Reaction.BRAKE)
SYNC = Sync(0, (3,))


def to(kind: int, data: bytes = bytes(8), middle: int = 253, leg: int = 3, flags: int = EXTENDED) -> Frame:
    return Frame(kind << 24 | middle << 8 | NODES[leg], data, flags)


def told(*frames: Frame, memory: Remembered | None = None) -> tuple[Remembered, list[Any]]:
    memory, found = memory or P.power_up(), []
    for frame in frames:
        memory, messages = P.parse(memory, frame)
        found.append(plain(messages))
    return memory, found


def test_a_drive_obeys_torques_from_its_enabling_to_its_stop_and_answers_each_by_feedback():
    def force(code: int) -> float:
        return float((code * STEP_Nm - 144.0) * UNLIKE.N_per_Nm[3])

    off, run, ready = DriveMode.OFF, DriveMode.RUN, DriveMode.READY
    memory, found = told(
        to(1, middle=50000),
        to(3),
        to(1, middle=50000),
        to(3),
        to(1, middle=10000),
        to(4),
        to(1, middle=10000),
        to(3),
        to(4, b"\1" + bytes(7)),
        to(4, b"\2" + bytes(7)),
    )
    assert found == [
        (SYNC,),
        (DELIVERED, command(3, ready, 1), command(3, run, 2), SYNC),
        (command(3, run, 3, force(50000)), SYNC),
        (SYNC,),
        (command(3, run, 4, force(10000)), SYNC),
        (command(3, off, 5), SYNC),
        (SYNC,),
        (DELIVERED, command(3, ready, 6), command(3, run, 7), SYNC),
        (command(3, DriveMode.RESET, 8), SYNC),
        (command(3, off, 9), SYNC),
    ]
    assert memory.heard == (0, 0, 0, 9, 0, 0)
    assert memory.enabled == (False,) * 6
    assert told(to(3))[0].enabled == (False, False, False, True, False, False)


def test_a_frame_that_is_cut_is_refused_and_what_a_drive_does_not_have_or_is_not_for_it_is_ignored():
    for kind in (1, 3, 4, 17, 18):
        assert told(to(kind, bytes(7)))[1] == [(Rejected(),)]
    for kind in (2, 5, 6, 7, 16, 19, 21):
        assert told(to(kind))[1] == [()]
    for frame in (to(3, flags=0), *(to(3, flags=EXTENDED | each) for each in (FD, REMOTE, ERROR, BUS))):
        assert told(frame)[1] == [()]
        assert P.hear(frame) is None
    assert told(Frame(3 << 24 | 253 << 8 | 6, bytes(8), EXTENDED))[1] == [()]


def test_the_run_mode_is_written_and_read_back_and_another_register_is_refused():
    memory, found = told(
        to(17, struct.pack("<HxxI", 0x7005, 0)),
        to(18, struct.pack("<HxxI", 0x7005, 2)),
        to(17, struct.pack("<HxxI", 0x7005, 0)),
        to(17, struct.pack("<HxxI", 0x7006, 0)),
        to(18, struct.pack("<HxxI", 0x7006, 0)),
    )

    def answer(mode: int) -> tuple[Answer]:
        return (Answer(3, Frame(17 << 24 | 4 << 8 | 253, struct.pack("<HxxI", 0x7005, mode), EXTENDED)),)

    refused = (Rejected(),)
    assert found == [answer(0), (DELIVERED, SYNC), answer(2), refused, refused]
    assert [each[0] for each in memory.registers] == [0, 0, 0, 2, 0, 0]


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_says_who_it_is_to_whoever_asks(leg):
    assert P.traits.identity_requests == (tuple(to(0, leg=each) for each in range(6)),)
    _, ((answer,),) = told(P.traits.identity_requests[0][leg])
    assert answer == Answer(leg, Frame(NODES[leg] << 8 | 0xFE, bytes((NODES[leg], *bytes(7))), EXTENDED))
    assert P.identity(answer.frame) == Said(leg, "serial number", NODES[leg])
    data = bytes(range(1, 9))
    frame = Frame(NODES[leg] << 8 | 253, data, EXTENDED)
    assert P.identity(frame) == Said(leg, "serial number", 0x0807060504030201)
    for wrong in (
        frame._replace(id=1 << 24 | frame.id),
        frame._replace(id=frame.id - 1),
        frame._replace(id=77 << 8 | 253),
        frame._replace(id=1 << 16 | frame.id),
        frame._replace(data=data[:7]),
        *(frame._replace(flags=flags) for flags in (0, EXTENDED | FD, EXTENDED | REMOTE, EXTENDED | BUS)),
    ):
        assert P.identity(wrong) is None


def sent(**changes: Any) -> list[tuple[int, Frame]]:
    """Return what all drives answer, each with numbers of its own, from inside their ranges."""
    turns = np.array([0.5, -0.5, 1.5, 2.5, -3.0, 4.0])
    given: dict[str, Any] = {"state": np.full(6, 1), "fault": None, "legs": tuple(range(6))} | changes
    rate = UNLIKE.rate(turns / 4)
    force, length, sync = UNLIKE.force(turns * 2, rate), UNLIKE.length(turns), Sync(0, given["legs"])
    return P.answer(P.power_up(), sync, length, rate, force, given["state"], given["fault"])[1]


def test_each_drive_answers_with_its_own_numbers_and_its_temperature():
    found = sent(legs=(5, 0, 2))
    assert [leg for leg, _ in found] == [5, 0, 2]
    for leg, frame in found:
        place = (0.5, -0.5, 1.5, 2.5, -3.0, 4.0)[leg]
        assert frame.id == 2 << 24 | NODES[leg] << 8 | 253
        assert (frame.data[6:], frame.flags) == ((250).to_bytes(2, "big"), EXTENDED)
        heard = P.hear(frame)
        assert heard is not None
        assert (heard.leg, heard.feedback, heard.power, heard.fault) == (leg, True, DriveState.OFF, 0)
        assert heard.motion == pytest.approx((place, place / 4), abs=800.0 / 65535 / (2 * np.pi))
        assert heard.torque == pytest.approx(2 * place, abs=STEP_Nm)


@pytest.mark.parametrize(
    ("fault", "bits"),
    [
        (DriveFault.NONE, 4),
        (DriveFault.WATCHDOG, 4),
        (DriveFault.OVERFORCE, 2),
        (DriveFault.SENSOR, 8),
        (DriveFault.STROKE, 16),
    ],
)
def test_state_and_faults_stand_in_the_identifier_of_a_feedback(fault, bits):
    faults = np.zeros(6, np.int64)
    faults[2] = fault
    for state in DriveState:
        states = np.full(6, 1)
        states[2] = state | INVALID
        for leg, frame in sent(state=states, fault=faults):
            mode = 2 if (leg, state) == (2, DriveState.RUN) else 0
            said = bits if (leg, state) == (2, DriveState.FAULT) else 0
            assert frame.id == 2 << 24 | mode << 22 | said << 16 | NODES[leg] << 8 | 253
            assert (frame.data[:2] == b"\0\0") == (leg == 2), "the encoder is lost"
            assert frame.data[2:] == sent()[leg][1].data[2:]


def test_what_lies_past_a_range_saturates_at_its_end():
    far = np.full(6, 1e4)
    for sign, codes in ((1, b"\xff\xff" * 3), (-1, bytes(6))):
        length, rate = UNLIKE.length(sign * far), UNLIKE.rate(sign * far)
        force = UNLIKE.force(sign * far)
        _, frames = P.answer(P.power_up(), Sync(0), length, rate, force, np.full(6, 3))
        assert {frame.data[:6] for _, frame in frames} == {codes}


@pytest.mark.parametrize("which", [0, 1, 2])
def test_what_is_no_number_is_no_feedback(which):
    given: Any = [np.ones(6), np.ones(6), np.ones(6)]
    given[which][3] = np.nan
    with pytest.raises(ProtocolError, match="not a number"):
        P.answer(P.power_up(), Sync(0), given[0], given[1], given[2], np.ones(6, np.int64))


def feedback(mode: int, faults: int, data: bytes = b"\x80\0\x80\0\x80\0\0\xfa") -> Heard | None:
    return P.hear(Frame(2 << 24 | mode << 22 | faults << 16 | 4 << 8 | 253, data, EXTENDED))


@pytest.mark.parametrize(
    ("mode", "faults", "power", "fault"),
    [
        (0, 0, DriveState.OFF, 0),
        (1, 0, DriveState.OFF, 0),
        (2, 0, DriveState.RUN, 0),
        (3, 0, DriveState.OFF, 0),
        (2, 1, DriveState.FAULT, 0x101),
        (0, 32, DriveState.FAULT, 0x120),
        (0, 63, DriveState.FAULT, 0x13F),
    ],
)
def test_a_feedback_says_by_its_identifier_whether_its_drive_is_enabled_or_what_ails_it(
    mode, faults, power, fault
):
    heard = feedback(mode, faults)
    assert heard is not None
    assert (heard.leg, heard.power, heard.fault) == (3, power, fault)


def test_a_position_at_either_end_of_its_range_is_no_reading_and_the_next_one_is():
    for place, there in ((b"\0\0", False), (b"\0\1", True), (b"\xff\xfe", True), (b"\xff\xff", False)):
        heard = feedback(2, 0, place + bytes(6))
        assert heard is not None
        assert (heard.motion is not None) == there


def test_frames_to_another_controller_are_nobodys_and_a_cut_one_to_ours_cannot_be_trusted():
    assert feedback(2, 0, bytes(7)) == Heard(3, broken=True)
    assert P.hear(Frame(17 << 24 | 4 << 8 | 253, bytes(7), EXTENDED)) == Heard(3, broken=True)
    assert P.hear(Frame(2 << 24 | 4 << 8 | 252, bytes(8), EXTENDED)) is None
    assert P.hear(Frame(2 << 24 | 6 << 8 | 253, bytes(8), EXTENDED)) is None
    for kind in (0, 1, 3, 4, 18, 21):
        assert P.hear(Frame(kind << 24 | 4 << 8 | 253, bytes(8), EXTENDED)) is None
    read = Frame(17 << 24 | 4 << 8 | 253, struct.pack("<HxxI", 0x7005, 0x102), EXTENDED)
    assert P.hear(read) == Heard(3, answer=(0x7005, 2.0))


def test_each_drive_is_told_by_its_own_state_and_history():
    six: dict[str, Any] = {"power": (1, 3, 4, 1, 0, 4), "ran": (False, False, False, True, False, True)}
    begun = P.start(DriveSetup(0.05, Reaction.BRAKE, 250.0))
    begun = begun._replace(torque=(10.0, -20.0, 30.0, 40.0, 50.0, -144.0), **six)
    for mode in DriveMode:
        for leg, frame in enumerate(P.begin(begun._replace(mode=int(mode)), 0)):
            clears = mode == DriveMode.RESET and leg in (2, 5)
            expected = to(4, bytes((clears, *bytes(7))), leg=leg)
            if mode == DriveMode.RUN:
                code = int((begun.torque[leg] + 144.0) * 65535 / 288.0)
                half = struct.pack(">HHHH", 0x7FFF, 0x7FFF, 0, 0)
                expected = to(1, half, code, leg) if leg in (1, 3, 5) else to(3, leg=leg)
            assert frame == expected
    assert P.traits.emergency_stop == tuple(to(4, leg=leg) for leg in range(6))
    half = struct.pack(">HHHH", 0x7FFF, 0x7FFF, 0, 0)
    assert P.traits.cyclic_frames[:6] == tuple(to(1, half, 0, leg) for leg in range(6))
    assert [P.awaited(each) for each in P.traits.cyclic_frames[6:]] == list(range(6))
    assert [P.addressed(each) for each in P.traits.emergency_stop] == [(leg,) for leg in range(6)]
    assert P.torque_limit == 144.0


def test_the_run_mode_of_each_drive_is_written_and_read_back():
    for leg, (exchange,) in enumerate(P.exchanges(DriveSetup(0.05, Reaction.BRAKE, 250.0))):
        data = struct.pack("<HxxI", 0x7005, 0)
        assert exchange.frames == (to(18, data, leg=leg), to(17, data, leg=leg))
        assert (exchange.name, exchange.register, exchange.value) == ("run_mode (0x7005)", 0x7005, 0)


@pytest.mark.parametrize("node", [0, 1, 127, 128])
def test_a_motor_number_is_1_to_127(node):
    nodes = (2, 3, 4, 5, 6, node)
    if node in (1, 127):
        RobStrideProtocol(P.ranges, nodes, 253, UNLIKE)
        return
    text = rf"drives.node_ids\[5\]: out of range, allowed with variant robstride: 1 to 127, given: {node}"
    with pytest.raises(ConfigurationError, match=text):
        RobStrideProtocol(P.ranges, nodes, 253, UNLIKE)


@pytest.mark.parametrize("host", [127, 128, 255, 256])
def test_a_controller_has_a_number_of_128_to_255(host):
    if host in (128, 255):
        assert (
            RobStrideProtocol(P.ranges, NODES, host, UNLIKE).traits.emergency_stop[0].id
            == 4 << 24 | host << 8 | 1
        )
        return
    with pytest.raises(
        ConfigurationError, match=f"host_id .*allowed: a whole number of 128 to 255, given: {host}"
    ):
        RobStrideProtocol(P.ranges, NODES, host, UNLIKE)


def test_what_a_torque_field_carries_is_truncated_to_its_steps():
    torque = np.array([10.0, -20.0, 30.0, 0.0, 144.0, -144.0])
    steps = np.floor((torque + 144.0) * 65535 / 288.0)
    np.testing.assert_allclose(P.coded(torque), steps * 288.0 / 65535 - 144.0, rtol=0, atol=1e-12)
