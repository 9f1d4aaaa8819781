"""Whose a frame is can be asked of any frame of a log, a stranger's or a damaged one: the answer is legs, or none."""

from __future__ import annotations

import pytest

from drivers import build_protocol
from drivers.family import Family
from drivers.protocol import EXTENDED, Frame
from drivers.signals import LEGS
from tests.drivers.cia402_drives import drives
from tests.hil.lab.bringup.families import FAMILIES, family

EXTENDED_IDS = [
    kind << 24 | middle | target
    for kind in range(32)
    for middle in (0, 0xFFFF00)
    for target in (0, 3, 7, 255)
]


def codec(name: str) -> Family:
    c = family(name)
    return build_protocol(c.bus, c.drives)


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_every_identifier_with_data_of_any_length_is_for_some_legs_or_none(name):
    protocol = codec(name)
    kinds = [(identifier, 0) for identifier in range(0x800)] + [(each, EXTENDED) for each in EXTENDED_IDS]
    for identifier, flags in kinds:
        for data in (b"", b"\x03", b"\xff\xff", bytes(8), b"\xff" * 8):
            frame = Frame(identifier, data, flags)
            assert set(protocol.addressed(frame)) <= set(range(LEGS)), frame
            assert -1 <= protocol.sender(frame) < LEGS, frame


@pytest.mark.parametrize("own", range(6))
def test_of_canopen_a_request_of_another_node_and_a_short_nmt_command_are_for_no_leg(own):
    nodes = (1, 20, 3, 40, 5, 126)
    protocol = drives(nodes)
    for identifier in (0x200, 0x300, 0x600):
        assert protocol.addressed(Frame(identifier + nodes[own], bytes(8))) == (own,)
        assert protocol.addressed(Frame(identifier + 99, bytes(8))) == ()
    assert protocol.addressed(Frame(0, bytes((1, nodes[own])))) == (own,)
    assert protocol.addressed(Frame(0, bytes((1, 0)))) == tuple(range(LEGS))
    assert [protocol.addressed(Frame(0, data)) for data in (b"", b"\x01", bytes((1, 99)))] == [()] * 3


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_a_feedback_that_is_cut_is_still_that_of_the_drive_whose_identifier_it_has(name):
    protocol = codec(name)
    sent = [(frame, protocol.sender(frame)) for frame in protocol.traits.cyclic_frames]
    feedback = [(frame, leg) for frame, leg in sent if leg >= 0]
    assert {leg for _, leg in feedback} == set(range(LEGS))
    shared = len({frame.id for frame, _ in feedback}) < LEGS
    for frame, leg in feedback:
        found = protocol.sender(frame._replace(data=frame.data[:3]))
        assert found == leg or (shared and found >= 0), frame
