"""CRC-8 and CRC-16 against published check values, a bitwise division, and a count of detected errors."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.legs.crc import check
from tests.drivers.legs_frames import bitwise_crc


def crc8(data: bytes) -> int:
    """CRC-8 of bytes, the first two of which are an identifier."""
    return check(int.from_bytes(data[:2], "little"), data[2:], 1)


def crc16(data: bytes) -> int:
    """CRC-16 of bytes, the first two of which are an identifier."""
    return check(int.from_bytes(data[:2], "little"), data[2:], 2)


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
def test_crc8_has_its_published_values(data, expected):
    assert crc8(data) == expected
    assert bitwise_crc(data, 8) == expected


@given(st.binary(min_size=2, max_size=66))
def test_crc8_and_crc16_agree_with_bitwise_polynomial_division(data):
    assert crc8(data) == bitwise_crc(data, 8)
    assert crc16(data) == bitwise_crc(data, 16)


@given(st.binary(min_size=2, max_size=65), st.data())
def test_every_error_burst_of_up_to_eight_bits_changes_the_crc(data, draw):
    at = draw.draw(st.integers(0, 8 * len(data) - 1))
    burst = draw.draw(st.integers(0, 127)) * 2 + 1
    damaged = int.from_bytes(data, "big") ^ (burst << at)
    damaged &= (1 << 8 * len(data)) - 1
    assert crc8(damaged.to_bytes(len(data), "big")) != crc8(data)


def test_crc16_has_the_check_value_of_the_catalogue():
    """CRC-16/M17 in the catalogue of parametrised CRC algorithms."""
    assert crc16(b"123456789") == bitwise_crc(b"123456789", 16) == 0x772B


def hamming_distance(polynomial: int, width: int, bits: int) -> int:
    """Smallest number of wrong bits that passes undetected in a code word of `bits` bits, at most five.

    An error pattern passes if the remainders of its bits add up to 0.
    """
    remainders, x = [], 1
    for _ in range(bits):
        remainders.append(x)
        x <<= 1
        if x >> width:
            x ^= 1 << width | polynomial
    one = set(remainders)
    if len(one) < bits:
        return 2
    two = [a ^ b for k, a in enumerate(remainders) for b in remainders[:k]]
    if one.intersection(two):
        return 3
    return 4 if len(set(two)) < len(two) else 5


def test_crc_of_the_can_fd_command_frame_detects_any_four_wrong_bits():
    code = 16 + 8 * 26 + 16  # identifier, forces with counter and mode, check
    assert hamming_distance(0x5935, 16, code) == 5
    assert hamming_distance(0x5935, 16, 241 + 16) == 5, "the length of Koopman's table"
    assert hamming_distance(0x5935, 16, 242 + 16) < 5
    assert hamming_distance(0x1021, 16, code) == 4, "CCITT's"
    assert hamming_distance(0x1D, 8, 16 + 8 * 31 + 8) == 2, "the CRC-8 that the CRC-16 replaces"


@pytest.mark.parametrize("size", [2, 5, 8, 12])
def test_crc8_of_short_frames_detects_any_two_wrong_bits(size):
    assert hamming_distance(0x1D, 8, 16 + 8 * size) == 3
