"""Legs and sender of any frame in a log, and serial numbers that identify a drive."""

from __future__ import annotations

import pytest

from drivers import build_protocol
from drivers.protocol import EXTENDED, REVISION, SERIAL, Frame, Said
from drivers.signals import LEGS
from tests.hil.lab.bringup.families import FAMILIES, family

EXTENDED_IDS = [
    kind << 24 | middle | target
    for kind in range(32)
    for middle in (0, 0xFFFF00)
    for target in (0, 3, 7, 255)
]


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_every_frame_is_attributed_to_valid_legs_and_a_known_sender(name):
    c = family(name)
    protocol = build_protocol(c.bus, c.drives)
    kinds = [(identifier, 0) for identifier in range(0x800)] + [(each, EXTENDED) for each in EXTENDED_IDS]
    for identifier, flags in kinds:
        for data in (b"", b"\x03", b"\xff\xff", bytes(8), b"\xff" * 8):
            frame = Frame(identifier, data, flags)
            assert set(protocol.addressed(frame)) <= set(range(LEGS)), frame
            assert -1 <= protocol.sender(frame) < LEGS, frame
    feedback = [f for f in protocol.traits.cyclic_frames if protocol.sender(f) >= 0]
    assert {protocol.sender(frame) for frame in feedback} == set(range(LEGS))
    for frame in feedback:
        found = protocol.sender(frame._replace(data=frame.data[:3]))
        shared = len({each.id for each in feedback}) < LEGS
        assert found == protocol.sender(frame) or (shared and found >= 0), (
            "a truncated frame is from the same drive"
        )


@pytest.mark.parametrize("bits", [32, 48, 64, 96])
def test_serial_number_of_all_zeros_or_all_ones_counts_as_unknown(bits):
    ones = (1 << bits) - 1
    found = [Said(2, SERIAL, value).tells for value in (0, ones, 1, ones - 1, 1 << bits)]
    assert found == [False, False, True, True, True]
    assert all(Said(2, REVISION, value).tells for value in (0, 1, 0x10000))
