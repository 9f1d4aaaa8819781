"""RobStride's own framing: commands and answers of a drive, and both ends of its identifiers."""

from __future__ import annotations

import struct
from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers.frame_array import received_array
from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, DriveSetup, Frame, Received, Said
from drivers.signals import INVALID, LEGS, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.drives_end import command
from hil.contracts.loopback import at_tick
from hil.contracts.messages import Answer, Configure, Rejected, Sync
from tests.drivers.motor_families import ROBSTRIDE_NODES as NODES
from tests.drivers.motor_families import UNLIKE, Heard, robstride, sent_to

P = robstride(UNLIKE)
SETUP = DriveSetup(0.05, Reaction.BRAKE, 250.0)
DELIVERED = Configure(3, 1e6, Reaction.BRAKE)
SYNC, REFUSED = (Sync(0, (3,)),), (Rejected(),)
TURNS = np.array([0.5, -0.5, 1.5, 2.5, -3.0, 4.0])


def to(kind: int, data: bytes = bytes(8), middle: int = 253, leg: int = 3, flags: int = EXTENDED) -> Frame:
    return Frame(kind << 24 | middle << 8 | NODES[leg], data, flags)


def parameter(number: int, mode: int = 0) -> bytes:
    return struct.pack("<HxxI", number, mode)


parsed = partial(sent_to, P)


def test_robstride_drive_refuses_a_short_frame_and_ignores_an_unknown_frame():
    assert parsed(to(3), to(4, b"\2" + bytes(7)))[1][1] == (command(3, DriveMode.OFF, 3), *SYNC), (
        "no clearing"
    )
    assert parsed(*(to(kind, bytes(7)) for kind in (1, 3, 4, 17, 18)))[1] == [REFUSED] * 5
    assert parsed(*(to(kind) for kind in (2, 5, 6, 7, 16, 19, 21)))[1] == [()] * 7
    for flags in (0, *(EXTENDED | each for each in (FD, REMOTE, ERROR, BUS))):
        assert parsed(to(3, flags=flags))[1] == [()]
        assert P.hear(to(3, flags=flags)) is None
    assert parsed(Frame(3 << 24 | 253 << 8 | 6, bytes(8), EXTENDED))[1] == [()]


def test_emulated_robstride_accepts_and_returns_its_run_mode_and_refuses_other_registers():
    read, write = to(17, parameter(0x7005)), to(18, parameter(0x7005, 2))
    memory, found = parsed(read, write, read, to(17, parameter(0x7006)), to(18, parameter(0x7006)))

    def answer(mode: int) -> tuple[Answer]:
        return (Answer(3, Frame(17 << 24 | 4 << 8 | 253, parameter(0x7005, mode), EXTENDED)),)

    assert found == [answer(0), (DELIVERED, *SYNC), answer(2), REFUSED, REFUSED]
    assert [each[0] for each in memory.registers] == [0, 0, 0, 2, 0, 0]
    for leg, (exchange,) in enumerate(P.exchanges(SETUP)):
        assert exchange.frames == (to(18, parameter(0x7005), leg=leg), to(17, parameter(0x7005), leg=leg))
        assert (exchange.register, exchange.value) == (0x7005, 0)


@pytest.mark.parametrize("leg", range(LEGS))
def test_answer_with_the_written_run_mode_completes_the_set_up_of_a_robstride_drive(leg):
    last, dialogue = at_tick(0), P.start(SETUP)._replace(done=(1,) * LEGS, power=(1,) * LEGS)
    last["age"] = 0
    # the mode is one byte
    for number, mode in ((0, 0), (1, 1), (2, 2), (255, 255), (0xABCDEF00, 0), (0xABCDEF01, 1)):
        answer = Frame(17 << 24 | NODES[leg] << 8 | 253, parameter(0x7005, number), EXTENDED)
        heard = received_array([Received(0, answer)])
        lacks = P.set_up_lacks(P.decode(dialogue, heard, last, at_tick(1)))
        assert all(lacks[each] for each in range(LEGS) if each != leg)
        assert lacks[leg] == (f"run_mode (0x7005) is {mode} in the drive, expected 0" if mode else "")


@pytest.mark.parametrize("status", [1, 2, 255])
def test_refused_register_read_does_not_complete_the_set_up_and_is_reported(status):
    last, dialogue = at_tick(0), P.start(SETUP)._replace(done=(1,) * LEGS, power=(1,) * LEGS)
    last["age"] = 0
    refused = Frame(17 << 24 | status << 16 | NODES[3] << 8 | 253, parameter(0x7005), EXTENDED)
    assert (P.hear(refused).broken, P.hear(refused).answer) == (True, None)
    tick = at_tick(1)
    dialogue = P.decode(dialogue, received_array([Received(0, refused)]), last, tick)
    assert P.set_up_lacks(dialogue)[3] == "run_mode (0x7005): read refused"
    assert tick["rejected"] == 1
    served = refused._replace(id=17 << 24 | NODES[3] << 8 | 253)
    assert (
        P.set_up_lacks(P.decode(dialogue, received_array([Received(0, served)]), tick, at_tick(2)))[3] == ""
    )


@pytest.mark.parametrize("leg", range(6))
def test_robstride_drive_reports_its_identity_to_any_controller(leg):
    assert P.traits.identity_requests == (tuple(to(0, leg=each) for each in range(6)),)
    _, ((answer,),) = parsed(P.traits.identity_requests[0][leg])
    assert answer == Answer(leg, Frame(NODES[leg] << 8 | 0xFE, bytes((NODES[leg], *bytes(7))), EXTENDED))
    assert P.identity(answer.frame) == Said(leg, "serial number", NODES[leg])
    data = bytes(range(1, 9))
    frame = Frame(NODES[leg] << 8 | 253, data, EXTENDED)
    assert P.identity(frame) == Said(leg, "serial number", 0x0807060504030201)
    for wrong in (
        *(
            frame._replace(id=each)
            for each in (1 << 24 | frame.id, frame.id - 1, 77 << 8 | 253, 1 << 16 | frame.id)
        ),
        frame._replace(data=data[:7]),
        *(frame._replace(flags=flags) for flags in (0, EXTENDED | FD, EXTENDED | REMOTE, EXTENDED | BUS)),
    ):
        assert P.identity(wrong) is None


# feedback


def sent(**changes: Any) -> list[tuple[int, Frame]]:
    """Answers of all drives, each with different numbers inside their ranges."""
    given: dict[str, Any] = {"state": np.full(6, 1), "fault": None} | changes
    rate = UNLIKE.rate(TURNS / 4)
    reading = UNLIKE.length(TURNS), rate, UNLIKE.force(TURNS * 2, rate), given["state"], given["fault"]
    return P.answer(P.power_up(), Sync(0), *reading)[1]


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
def test_state_and_faults_are_in_the_identifier_of_a_robstride_feedback_frame(fault, bits):
    faults = np.array([0, 0, fault, 0, 0, 0])
    for state in DriveState:
        states = np.array([1, 1, state | INVALID, 1, 1, 1])
        for leg, frame in sent(state=states, fault=faults):
            mode = 2 if (leg, state) == (2, DriveState.RUN) else 0
            said = bits if (leg, state) == (2, DriveState.FAULT) else 0
            assert frame.id == 2 << 24 | mode << 22 | said << 16 | NODES[leg] << 8 | 253
            assert (frame.data[:2] == b"\0\0") == (leg == 2), "the encoder is lost"
            assert (frame.data[6:], frame.flags) == ((250).to_bytes(2, "big"), EXTENDED), "its temperature"
            assert frame.data[2:] == sent()[leg][1].data[2:]


def feedback(mode: int, faults: int, data: bytes = b"\x80\0\x80\0\x80\0\0\xfa") -> Any:
    return P.hear(Frame(2 << 24 | mode << 22 | faults << 16 | 4 << 8 | 253, data, EXTENDED))


def test_robstride_feedback_at_either_end_of_its_position_field_gives_state_but_no_position():
    for mode, faults, power, fault in (
        (0, 0, DriveState.OFF, 0),
        (1, 0, DriveState.OFF, 0),
        (2, 0, DriveState.RUN, 0),
        (3, 0, DriveState.OFF, 0),
        (2, 1, DriveState.FAULT, 0x101),
        (0, 32, DriveState.FAULT, 0x120),
        (0, 63, DriveState.FAULT, 0x13F),
    ):
        heard = feedback(mode, faults)
        assert (heard.leg, heard.power, heard.fault) == (3, power, fault)
    for place, there in ((b"\0\0", False), (b"\0\1", True), (b"\xff\xfe", True), (b"\xff\xff", False)):
        heard = feedback(2, 0, place + bytes(6))
        assert (heard.motion is not None) == there


def test_robstride_frame_to_another_controller_is_ignored_and_a_short_frame_is_invalid():
    assert feedback(2, 0, bytes(7)) == Heard(3, broken=True)
    assert P.hear(Frame(17 << 24 | 4 << 8 | 253, bytes(7), EXTENDED)) == Heard(3, broken=True)
    assert P.hear(Frame(2 << 24 | 4 << 8 | 252, bytes(8), EXTENDED)) is None
    assert P.hear(Frame(2 << 24 | 6 << 8 | 253, bytes(8), EXTENDED)) is None
    for kind in (0, 1, 3, 4, 18, 21):
        assert P.hear(Frame(kind << 24 | 4 << 8 | 253, bytes(8), EXTENDED)) is None
    read = Frame(17 << 24 | 4 << 8 | 253, parameter(0x7005, 0x102), EXTENDED)
    assert P.hear(read) == Heard(3, answer=(0x7005, 2.0))
