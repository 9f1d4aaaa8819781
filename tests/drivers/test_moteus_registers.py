"""The subframes of moteus by hand: widths, scales, counts, and where a frame ends."""

from __future__ import annotations

import struct
from math import isnan
from typing import Any

import pytest

from drivers.moteus import READ, REPLY, WRITE, pad
from drivers.signals import INVALID, DriveState
from tests.drivers.moteus_ends import asked, registers, replied

SAID: dict[str, dict[int, float] | None] = {
    "50 21 00 0a 50 50": {0: 10.0},
    "21 0e 1e": {0xE: 30.0}, "25 0e 1e 00": {0xE: 3.0}, "29 0e 1e 00 00 00": {0xE: 0.03},
    "29 02 00 00 01 00": {2: 0.65536}, "25 0d 30 00": {0xD: 4.8}, "29 0d 30 00 00 00": {0xD: 0.048},
    "23 00 0a 32 f6": {0: 10.0, 1: 0.5, 2: -1.0},
    # a count of its own, a register of two bytes: 0x120 is 0xa0 0x02
    "20 04 00 0a 32 f6 01": {0: 10.0, 1: 0.5, 2: -1.0, 3: 0.5},
    "29 a0 02 01 00 00 80": {0x120: -2147483647.0}, "29 80 02 01 00 00 00": {0x100: 1.0},
    "20 00 21 00 0a": {0: 10.0},  # none of a kind, and then one
    "21 00 0a 21 00 0b": {0: 11.0},
    # what is asked for in between is no answer; an error ends the frame
    "11 00 21 00 0a": {0: 10.0}, "21 00 0a 31 05 01 2f": {0: 10.0}, "21 00 0a 30 05": {0: 10.0},
    # not whole, or of another kind
    **dict.fromkeys((
        "21", "21 00", "22 00 0a", "25 00 0a", "29 00 0a 00 00", "2d 00 0a 00 00", "20", "20 04", "20 81",
        "29 a0", "23 00 0a 0a", "01 00 0a", "41 00", "21 00 0a 01 00 0a", "21 00 0a 21 00", "20 02 00 0a",
    )),
}  # fmt: skip


def test_frame_gives_its_registers_each_at_its_scale_or_is_broken():
    for text, found in SAID.items():
        said = registers(bytes.fromhex(text), REPLY)
        assert said == (None if found is None else pytest.approx(found, rel=1e-12)), text
    assert registers(b"\x01\0\x0a", WRITE) == registers(b"\x1f\1\1\0\x0a", WRITE) == {0: 10.0}
    assert registers(b"\x21\0\x0a", WRITE) is None


@pytest.mark.parametrize(
    ("register", "scales"),
    [
        (0x20, {0: 0.01, 1: 0.0001, 2: 0.00001}),
        (0x21, {0: 0.1, 1: 0.00025}),
        (0x22, {0: 0.5, 2: 0.001}),
        (0x24, {1: 1.0}),
        (0x25, {0: 0.5, 1: 0.01}),
        (0x27, {0: 0.01, 1: 0.001, 2: 0.000001, 3: 1.0}),
        (0x28, {0: 1.0}),
    ],
)
def test_command_has_the_scale_of_what_is_read_and_a_time_its_own(register, scales):
    for width, scale in scales.items():
        number = struct.pack("<" + "bhif"[width], 3)
        found: Any = registers(bytes((WRITE | width << 2 | 1, register)) + number, WRITE)
        assert found == {register: pytest.approx(3 * scale, rel=1e-12)}


@pytest.mark.parametrize("width", [0, 1, 2])
def test_smallest_integer_is_not_a_number_where_there_is_a_scale(width):
    size = (1, 2, 4)[width]
    for least in (0, 1):
        raw = (least - (1 << (8 * size - 1))).to_bytes(size, "little", signed=True)
        scaled, plain = (registers(bytes((REPLY | width << 2 | 1, n)) + raw, REPLY) for n in (1, 0))
        assert scaled is not None
        assert plain == {0: int.from_bytes(raw, "little", signed=True)}
        assert isnan(scaled[1]) == (least == 0)


@pytest.mark.parametrize(
    ("text", "reply"),
    [
        ("14 04 00", "24 04 00 0a 00 88 13 60 f0 96 00"),
        ("12 01 11 03", "23 01 32 f6 03"),  # what follows one another goes together
        ("11 01 15 02", "21 01 32 25 02 60 f0"),
        ("1d 01", "2d 01 00 00 00 3f"),
        ("19 03", "29 03 dc 05 00 00"),
        ("18 04 a0 02", "2b a0 02 01 00 00 00 00 00 00 00 00 00 00 00 31 a3 02 01"),
        ("11 10 11 00", "31 10 01 21 00 0a"),
        ("15 05", "25 05 00 80"),
        ("1d 05", "2d 05 00 00 c0 7f"),
        ("01 00 0a 11 03", "21 03 03"),
        ("11 03 30 11 04", "21 03 03"),  # an error ends the frame
    ],
)
def test_reply_has_what_was_asked_for_in_groups_and_an_error_for_the_unknown(text, reply):
    assert replied(bytes.fromhex(text)) == pad(bytes.fromhex(reply))


def test_reply_ends_where_a_frame_is_full():
    for count in (63, 64, 65, 127):
        assert asked(bytes((READ, count, 1))) == tuple((1 + k, 0) for k in range(min(count, 64)))
    reply = replied(bytes((READ | 3 << 2, 20, 1)))
    assert len(reply) == 64
    assert reply[:3] == bytes((REPLY | 3 << 2, 15, 1))
    assert reply[63] == 0x31, "the first of those that it does not have"
    for size in range(65):
        full = min(each for each in (*range(9), 12, 16, 20, 24, 32, 48, 64) if each >= size)
        assert pad(bytes(size)) == bytes(size) + b"\x50" * (full - size), "lengths of CAN FD"


def test_integer_saturates_one_short_of_the_one_that_is_not_a_number():
    for value, raw in ((1.27, 127), (1.29, 127), (9.0, 127), (-1.27, -127), (-1.28, -127), (-9.0, -127)):
        assert replied(b"\x11\1", value) == bytes((0x21, 1)) + struct.pack("b", raw)
        assert replied(b"\x11\1", value, state=DriveState.RUN | INVALID) == b"\x21\1\x80"
