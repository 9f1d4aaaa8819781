"""SAE J1850 CRC-8 against its published check value and an independent bitwise division."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.legs.crc import crc8, identifier_state


def bitwise_crc8(data: bytes) -> int:
    """Divide bit by bit, as a shift register does."""
    register = 0xFF
    for byte in data:
        for position in range(7, -1, -1):
            carry = (register >> 7) ^ (byte >> position & 1)
            register = register << 1 & 0xFF
            if carry:
                register ^= 0x1D
    return register ^ 0xFF


@pytest.mark.parametrize(
    ("data", "expected"),
    # The first is the catalogue's check value; the others are published examples of this CRC.
    [
        (b"123456789", 0x4B),
        (bytes(4), 0x59),
        (bytes.fromhex("F20183"), 0x37),
        (bytes.fromhex("0FAA0055"), 0x79),
        (bytes.fromhex("00FF5511"), 0xB8),
        (bytes.fromhex("332255AABBCCDDEEFF"), 0xCB),
        (bytes.fromhex("926B55"), 0x8C),
        (bytes.fromhex("FFFFFFFF"), 0x74),
    ],
)
def test_published_values(data, expected):
    assert crc8(data) == expected
    assert bitwise_crc8(data) == expected


@given(st.binary(max_size=64))
def test_agrees_with_bitwise_division(data):
    assert crc8(data) == bitwise_crc8(data)


@given(st.integers(0, 0x7FF), st.binary(max_size=64))
def test_identifier_counts_as_two_leading_bytes(identifier, data):
    lead = bytes([identifier % 256, identifier // 256])
    assert crc8(data, identifier_state(identifier)) == bitwise_crc8(lead + data)


@given(st.binary(min_size=1, max_size=63), st.data())
def test_every_burst_of_up_to_eight_bits_changes_the_check(data, draw):
    at = draw.draw(st.integers(0, 8 * len(data) - 1))
    burst = draw.draw(st.integers(0, 127)) * 2 + 1
    damaged = int.from_bytes(data, "big") ^ (burst << at)
    damaged &= (1 << 8 * len(data)) - 1
    assert crc8(damaged.to_bytes(len(data), "big")) != crc8(data)
