"""A serial number that was never written tells no drive from another, whatever its width."""

from __future__ import annotations

import pytest

from drivers.protocol import REVISION, SERIAL, Said


@pytest.mark.parametrize("bits", [32, 48, 64, 96])
def test_all_zeros_and_all_ones_are_no_serial_number_and_their_neighbours_are(bits):
    ones = (1 << bits) - 1
    assert [Said(2, SERIAL, value).tells for value in (0, ones, 1, ones - 1, 1 << bits)] == [
        False,
        False,
        True,
        True,
        True,
    ]


def test_any_revision_tells_what_it_is():
    assert all(Said(2, REVISION, value).tells for value in (0, 1, 0x10000))
