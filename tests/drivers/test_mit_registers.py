"""Registers of Damiao and RobStride: whom a request names, what can be written, and which answer confirms."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.frame_array import received_array
from drivers.mit.fields import Ranges
from drivers.protocol import EXTENDED, Frame, Received
from drivers.signals import LEGS
from hil.contracts.ends import SETUP, at_tick, reaction_of
from hil.contracts.messages import Answer, Rejected
from tests.drivers.motor_families import MitProtocol, RobStrideProtocol
from tests.drivers.test_odrive import GEAR

RANGES = Ranges(95.5, 400.0, 144.0)
NODES = (1, 2, 3, 4, 5, 15)
DAMIAO = MitProtocol("damiao", RANGES, NODES, 16, GEAR)
MOTORS = (1, 2, 3, 4, 5, 127)
ROBSTRIDE = RobStrideProtocol(RANGES, MOTORS, 253, GEAR)
READ, WRITE = 0x33, 0x55
CTRL_MODE, SW_VER, SN = 10, 14, 15
RUN_MODE = 0x7005


def request(node: int, kind: int, register: int, value: int = 0) -> Frame:
    return Frame(0x7FF, struct.pack("<HBBI", node, kind, register, value))


def read(memory: Any, leg: int, register: int) -> bytes:
    """Return what a drive answers when a register of it is read."""
    _, messages = DAMIAO.parse(memory, request(NODES[leg], READ, register))
    (answer,) = [each for each in messages if isinstance(each, Answer)]
    assert answer.leg == leg
    return answer.frame.data[4:]


@pytest.mark.parametrize("kind", [READ, WRITE])
@pytest.mark.parametrize("high", [0x01, 0x02, 0x80, 0xFF])
def test_a_request_that_names_a_node_of_two_bytes_is_for_no_damiao(high, kind):
    memory = DAMIAO.power_up()
    for leg, node in enumerate(NODES):
        own, other = (request(each, kind, CTRL_MODE, 1) for each in (node, high << 8 | node))
        assert (DAMIAO.addressed(own), DAMIAO.addressed(other)) == ((leg,), ())
        assert DAMIAO.parse(memory, own)[1]
        assert DAMIAO.parse(memory, other) == (memory, ())


@pytest.mark.parametrize("register", [SW_VER, SN])
def test_what_a_damiao_says_of_who_it_is_can_be_read_and_not_written(register):
    memory = DAMIAO.power_up()
    for leg, node in enumerate(NODES):
        before = read(memory, leg, register)
        after, messages = DAMIAO.parse(memory, request(node, WRITE, register, 77))
        assert [type(each) for each in messages] == [Rejected]
        assert read(after, leg, register) == before != struct.pack("<I", 77)


def test_a_setting_of_a_damiao_is_written_at_the_drive_that_is_named_alone():
    for leg, node in enumerate(NODES):
        memory, _ = DAMIAO.parse(DAMIAO.power_up(), request(node, WRITE, CTRL_MODE, 1))
        assert [read(memory, each, CTRL_MODE)[0] for each in range(LEGS)] == [leg == k for k in range(LEGS)]


def run_mode(leg: int, number: int) -> Frame:
    """Return a RobStride's answer to the reading of its run mode."""
    return Frame(17 << 24 | MOTORS[leg] << 8 | 253, struct.pack("<HxxI", RUN_MODE, number), EXTENDED)


def told(leg: int, number: int) -> str:
    """Return what a drive lacks that is heard and has answered the reading of its run mode."""
    dialogue = ROBSTRIDE.start(SETUP._replace(reaction=reaction_of(ROBSTRIDE)))
    dialogue = dialogue._replace(done=(1,) * LEGS, power=(1,) * LEGS)
    last = at_tick(0)
    last["age"] = 0
    run = received_array([Received(0, run_mode(leg, number))])
    dialogue = ROBSTRIDE.decode(dialogue, run, last, at_tick(1))
    assert all(ROBSTRIDE.set_up_lacks(dialogue)[each] for each in range(LEGS) if each != leg)
    return ROBSTRIDE.set_up_lacks(dialogue)[leg]


@pytest.mark.parametrize("leg", range(LEGS))
def test_a_robstride_is_set_up_by_the_answer_with_the_run_mode_that_was_written_and_by_no_other(leg):
    assert told(leg, 0) == ""
    for mode in (1, 2, 3, 4, 5, 128, 255):
        assert told(leg, mode) == f"run_mode (0x7005) is {mode} in the drive, 0 here"


def test_the_run_mode_of_a_robstride_is_one_byte():
    assert told(2, 0xABCDEF00) == ""
    assert told(2, 0xABCDEF01) == "run_mode (0x7005) is 1 in the drive, 0 here"
