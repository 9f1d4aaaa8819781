"""RobStride's own framing: what a drive obeys and answers, and both ends of its identifiers."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.frame_array import received_array
from drivers.protocol import BUS, EXTENDED, FD, REMOTE, DriveSetup, Frame, Received, Said
from drivers.signals import LEGS, DriveState, Reaction
from hil.contracts.by_value import Remembered
from hil.contracts.drives_end import plain
from hil.contracts.ends import at_tick
from hil.contracts.messages import Answer
from tests.drivers.motor_families import ROBSTRIDE_NODES as NODES
from tests.drivers.motor_families import UNLIKE, Heard, robstride

P = robstride(UNLIKE)
SETUP = DriveSetup(0.05, Reaction.BRAKE, 250.0)


def to(kind: int, data: bytes = bytes(8), middle: int = 253, leg: int = 3, flags: int = EXTENDED) -> Frame:
    return Frame(kind << 24 | middle << 8 | NODES[leg], data, flags)


def parameter(number: int, mode: int = 0) -> bytes:
    return struct.pack("<HxxI", number, mode)


def told(*frames: Frame) -> tuple[Remembered, list[Any]]:
    memory, found = P.power_up(), []
    for frame in frames:
        memory, messages = P.parse(memory, frame)
        found.append(plain(messages))
    return memory, found


@pytest.mark.parametrize("leg", range(LEGS))
def test_drive_is_set_up_by_the_answer_with_the_run_mode_that_was_written(leg):
    last, dialogue = at_tick(0), P.start(SETUP)._replace(done=(1,) * LEGS, power=(1,) * LEGS)
    last["age"] = 0
    # the mode is one byte
    for number, mode in ((0, 0), (1, 1), (2, 2), (255, 255), (0xABCDEF00, 0), (0xABCDEF01, 1)):
        answer = Frame(17 << 24 | NODES[leg] << 8 | 253, parameter(0x7005, number), EXTENDED)
        heard = received_array([Received(0, answer)])
        lacks = P.set_up_lacks(P.decode(dialogue, heard, last, at_tick(1)))
        assert all(lacks[each] for each in range(LEGS) if each != leg)
        assert lacks[leg] == (f"run_mode (0x7005) is {mode} in the drive, 0 here" if mode else "")


@pytest.mark.parametrize("leg", range(6))
def test_drive_says_who_it_is_to_whoever_asks(leg):
    assert P.traits.identity_requests == (tuple(to(0, leg=each) for each in range(6)),)
    _, ((answer,),) = told(P.traits.identity_requests[0][leg])
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


def feedback(mode: int, faults: int, data: bytes = b"\x80\0\x80\0\x80\0\0\xfa") -> Any:
    return P.hear(Frame(2 << 24 | mode << 22 | faults << 16 | 4 << 8 | 253, data, EXTENDED))


def test_feedback_gives_state_and_faults_and_no_position_at_either_end():
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


def test_frame_to_another_controller_is_nobodys_and_a_cut_one_broken():
    assert feedback(2, 0, bytes(7)) == Heard(3, broken=True)
    assert P.hear(Frame(17 << 24 | 4 << 8 | 253, bytes(7), EXTENDED)) == Heard(3, broken=True)
    assert P.hear(Frame(2 << 24 | 4 << 8 | 252, bytes(8), EXTENDED)) is None
    assert P.hear(Frame(2 << 24 | 6 << 8 | 253, bytes(8), EXTENDED)) is None
    for kind in (0, 1, 3, 4, 18, 21):
        assert P.hear(Frame(kind << 24 | 4 << 8 | 253, bytes(8), EXTENDED)) is None
    read = Frame(17 << 24 | 4 << 8 | 253, parameter(0x7005, 0x102), EXTENDED)
    assert P.hear(read) == Heard(3, answer=(0x7005, 2.0))
