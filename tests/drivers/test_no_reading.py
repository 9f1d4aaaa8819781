"""A drive whose encoder is lost, or that is past its range, sends no length, and none is read of it."""

from __future__ import annotations

import struct
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from drivers.mit.fields import Ranges
from drivers.protocol import Frame
from drivers.signals import INVALID, LEGS, DriveState, Reaction
from hil.contracts.by_value import ByValue
from hil.contracts.drives_end import answers
from hil.contracts.messages import Sync
from tests.drivers.cia402_drives import drives, holding
from tests.drivers.motor_families import MitProtocol, MoteusProtocol, ODriveProtocol, RobStrideProtocol
from tests.drivers.test_odrive import GEAR, NODES

RANGES = Ranges(95.5, 400.0, 144.0)
FAMILIES: dict[str, Any] = {
    "mini_cheetah": MitProtocol("mini_cheetah", RANGES, (1, 2, 3, 4, 5, 15), 0, GEAR),
    "cubemars": MitProtocol("cubemars", RANGES, (1, 2, 3, 4, 5, 15), 0, GEAR),
    "damiao": MitProtocol("damiao", RANGES, (1, 2, 3, 4, 5, 15), 16, GEAR),
    "robstride": RobStrideProtocol(RANGES, (1, 2, 3, 4, 5, 127), 253, GEAR),
    "odrive": ODriveProtocol(NODES, 0.05, GEAR),
    "moteus": MoteusProtocol((1, 2, 3, 4, 5, 126), 0, Reaction.DAMP, 1000.0, GEAR),
}
TELL = [name for name in FAMILIES if name != "mini_cheetah"]
"""Their replies say that there is no position; those of mini-cheetah wrap."""
STATES = [DriveState.BOOT, DriveState.OFF, DriveState.READY, DriveState.RUN, DriveState.FAULT]
ZEROS = np.zeros(LEGS)


def said(name: str, length: float, lost: int = -1, state: DriveState = DriveState.OFF) -> list[Frame]:
    """Return what six drives answer whose legs stand at a length, one of them without its encoder."""
    states = np.full(LEGS, int(state))
    states[lost] |= INVALID if lost >= 0 else 0
    found = answers(FAMILIES[name], Sync(0), np.full(LEGS, length), ZEROS, ZEROS, states)
    assert [leg for leg, _ in found] == list(range(LEGS))
    return [frame for _, frame in found]


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("name", TELL)
def test_of_a_lost_encoder_no_length_is_read_in_any_state_and_of_the_others_theirs(name, state):
    for lost in range(LEGS):
        heard = [FAMILIES[name].hear(frame) for frame in said(name, 1.6, lost, state)]
        assert [each.leg for each in heard] == list(range(LEGS))
        assert [each.leg for each in heard if each.motion is None] == [lost]
        assert all(each.feedback and not each.broken for each in heard)


@pytest.mark.parametrize("state", STATES)
def test_a_lost_encoder_of_mini_cheetah_reads_the_lower_end_in_any_state(state):
    for lost in range(LEGS):
        places = [frame.data[1:3] for frame in said("mini_cheetah", 1.6, lost, state)]
        assert [leg for leg, place in enumerate(places) if place == b"\0\0"] == [lost]


@pytest.mark.parametrize("state", STATES)
def test_a_lost_encoder_of_a_cia_402_drive_sends_no_pdo_in_any_state(state):
    protocol = ByValue(drives())
    memory = holding(protocol.protocol, [state] * LEGS)
    for lost in range(LEGS):
        states = np.full(LEGS, int(state))
        states[lost] |= INVALID
        _, sent = protocol.answer(memory, Sync(0), ZEROS + 0.7, ZEROS, ZEROS, states)
        there = [leg for leg in range(LEGS) if leg != lost and state != DriveState.BOOT]
        assert [leg for leg, _ in sent] == [leg for leg in there for _ in range(2)]


@pytest.mark.parametrize("end", [-1.0, 1.0])
@pytest.mark.parametrize("name", ["cubemars", "damiao", "robstride"])
def test_a_position_past_either_end_of_its_range_is_no_length(name, end):
    past = 1.75 + end * 0.1 * 96.0 / (2 * np.pi)
    inside = 1.75 + end * 0.1 * 95.0 / (2 * np.pi)
    assert [FAMILIES[name].hear(frame).motion for frame in said(name, past)] == [None] * LEGS
    assert all(FAMILIES[name].hear(frame).motion is not None for frame in said(name, inside))


@pytest.mark.parametrize("place", [0.5, nan, inf, -inf])
@pytest.mark.parametrize("speed", [0.25, nan, inf, -inf])
def test_an_estimate_of_an_axis_is_motion_only_if_both_of_its_numbers_are(place, speed):
    for leg, node in enumerate(NODES):
        heard = FAMILIES["odrive"].hear(Frame(node << 5 | 0x09, struct.pack("<ff", place, speed)))
        assert (heard.leg, heard.feedback) == (leg, True)
        assert heard.motion == ((0.5, 0.25) if (place, speed) == (0.5, 0.25) else None)
