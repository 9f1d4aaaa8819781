"""Frames of every family of motor drives: each drive's own numbers, lost encoders, other controllers."""

from __future__ import annotations

import struct
from math import inf, nan

import numpy as np
import pytest

from drivers.mit.fields import TURN
from drivers.moteus import STOP
from drivers.protocol import BRS, EXTENDED, FD, Frame
from drivers.signals import INVALID, LEGS, DriveState
from hil.contracts.drives_end import answers
from hil.contracts.messages import Sync
from tests.drivers.motor_families import (
    MIT_NODES,
    MOTEUS_NODES,
    MOTORS,
    ODRIVE_NODES,
    ROBSTRIDE_NODES,
    UNLIKE,
    motors,
)

ZEROS = np.zeros(LEGS)


def sent(name: str, length: float, lost: int = -1, state: DriveState = DriveState.OFF) -> list[Frame]:
    """Answers of six drives with all legs at one length, one drive without its encoder."""
    states = np.full(LEGS, int(state))
    states[lost] |= INVALID if lost >= 0 else 0
    found = answers(MOTORS[name], Sync(0), np.full(LEGS, length), ZEROS, ZEROS, states)
    assert [leg for leg, _ in found] == list(range(LEGS))
    return [frame for _, frame in found]


# readings


STEPS = {  # largest error of a reading: turns, turns/s, N m
    "mini_cheetah": (191 / 65535 / TURN, 800 / 4095 / TURN, 288 / 4095),
    "robstride": (191 / 65535 / TURN, 800 / 65535 / TURN, 288 / 65535),
    "odrive": (1e-6, 1e-6, None),
    "moteus": (1e-6, 1e-6, 1e-5),
}
UNLIKES = motors(UNLIKE)


@pytest.mark.parametrize("name", MOTORS)
def test_each_drive_answers_with_its_own_position_rate_and_torque_in_the_order_of_the_polls(name):
    protocol, turns = UNLIKES[name], np.array([0.5, -0.5, 1.5, 2.5, -3.0, 4.0])
    rate = UNLIKE.rate(turns / 4)
    reading = UNLIKE.length(turns), rate, UNLIKE.force(turns * 2, rate), np.ones(6, np.int64)
    found = answers(protocol, Sync(0, (5, 0, 2)), *reading)
    assert [leg for leg, _ in found] == [5, 0, 2]
    for leg, frame in found:
        heard, (place, speed, torque) = protocol.hear(frame), STEPS.get(name, STEPS["mini_cheetah"])
        assert (heard.leg, heard.feedback, heard.fault) == (leg, True, 0)
        assert heard.motion[0] == pytest.approx(turns[leg], abs=place)
        assert heard.motion[1] == pytest.approx(turns[leg] / 4, abs=speed)
        assert heard.torque == (torque and pytest.approx(turns[leg] * 2, abs=torque))


@pytest.mark.parametrize("state", DriveState)
@pytest.mark.parametrize("name", MOTORS)
def test_answer_of_a_drive_with_a_lost_encoder_gives_no_length_in_any_state(name, state):
    for lost in range(LEGS):
        frames = sent(name, 1.6, lost, state)
        if name == "mini_cheetah":
            assert [leg for leg, frame in enumerate(frames) if frame.data[1:3] == b"\0\0"] == [lost], (
                "its end"
            )
            continue
        heard = [MOTORS[name].hear(frame) for frame in frames]
        assert [each.leg for each in heard] == list(range(LEGS))
        assert [each.leg for each in heard if each.motion is None] == [lost]
        assert all(each.feedback and not each.broken for each in heard)


@pytest.mark.parametrize("place", [0.5, nan, inf, -inf])
@pytest.mark.parametrize("speed", [0.25, nan, inf, -inf])
def test_encoder_estimate_of_an_odrive_axis_is_used_only_if_both_values_are_finite(place, speed):
    for leg, node in enumerate(ODRIVE_NODES):
        heard = MOTORS["odrive"].hear(Frame(node << 5 | 0x09, struct.pack("<ff", place, speed)))
        assert (heard.leg, heard.feedback) == (leg, True)
        assert heard.motion == ((0.5, 0.25) if (place, speed) == (0.5, 0.25) else None)


# other controllers


NODES = {"robstride": ROBSTRIDE_NODES, "odrive": ODRIVE_NODES, "moteus": MOTEUS_NODES}
SET_POINTS = bytes.fromhex("02 04 06 07 0b 0c 0d 0e 0f 11 12 13 16 18 19 1a 1b 1f")
"""Commands and settings that a controller can send to an axis by CAN Simple."""


def commands(name: str, node: int) -> list[Frame]:
    hosts: tuple[int, ...]
    if name == "robstride":
        data, hosts = struct.pack("<HxxI", 0x7005, 0), (253, 0xAA)
        return [
            Frame(k << 24 | host << 8 | node, data, EXTENDED) for k in (1, 3, 4, 17, 18) for host in hosts
        ]
    if name == "odrive":  # node number 0xFF: sets an address, is no answer with one
        return [Frame(node << 5 | kind, b"\xff" + bytes(7)) for kind in SET_POINTS]
    if name == "moteus":
        hosts = (0, 0x80, 0x85, 5)
        return [Frame(host << 8 | node, STOP, FD | BRS | EXTENDED * (host > 7)) for host in hosts]
    return [Frame(node, bytes(8))]


@pytest.mark.parametrize("name", MOTORS)
def test_every_command_frame_of_another_controller_counts_as_foreign(name):
    for leg, node in enumerate(NODES.get(name, MIT_NODES)):
        for frame in commands(name, node):
            heard = MOTORS[name].hear(frame)
            assert heard is not None, frame
            assert (heard.leg, heard.foreign) == (leg, True), frame


def test_register_request_counts_as_foreign_for_damiao_drives_and_is_ignored_for_others():
    for node in MIT_NODES:
        for request in (0x33, 0x55, 0xCC, 0xAA):
            frame = Frame(0x7FF, bytes((node, 0, request, 9, 1, 0, 0, 0)))
            assert MOTORS["damiao"].hear(frame).foreign
            assert MOTORS["cubemars"].hear(frame) is MOTORS["mini_cheetah"].hear(frame) is None
