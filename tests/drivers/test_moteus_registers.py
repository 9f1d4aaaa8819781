"""The subframes of moteus by hand: lengths, widths, scales, counts, and where a frame ends."""

from __future__ import annotations

import struct
from math import isnan
from typing import Any

import pytest

from drivers.moteus import READ, REPLY, WRITE, pad
from drivers.signals import INVALID, DriveState
from tests.drivers.moteus_ends import asked, registers, replied


def said(text: str, kind: int = REPLY) -> dict[int, float] | None:
    return registers(bytes.fromhex(text), kind)


def test_data_are_filled_up_with_nops_to_the_next_length_of_can_fd():
    for size in range(65):
        lengths = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
        full = min(each for each in lengths if each >= size)
        assert pad(bytes(range(size))) == bytes(range(size)) + b"\x50" * (full - size)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", {}), ("50", {}), ("50 21 00 0a 50 50", {0x00: 10.0}),
        ("21 01 05", {0x01: 0.05}), ("25 01 05 00", {0x01: 0.0005}), ("29 01 05 00 00 00", {0x01: 0.00005}),
        ("2d 01 00 00 a0 40", {0x01: 5.0}),
        ("21 02 fb", {0x02: -0.5}), ("25 02 04 00", {0x02: 0.001}), ("29 02 00 00 01 00", {0x02: 0.65536}),
        ("21 03 03", {0x03: 1.5}), ("25 03 03 00", {0x03: 0.03}), ("29 03 03 00 00 00", {0x03: 0.003}),
        ("21 0d 30", {0x0D: 24.0}), ("25 0d 30 00", {0x0D: 4.8}), ("29 0d 30 00 00 00", {0x0D: 0.048}),
        ("21 0e 1e", {0x0E: 30.0}), ("25 0e 1e 00", {0x0E: 3.0}), ("29 0e 1e 00 00 00", {0x0E: 0.03}),
        ("22 00 0a 32", {0x00: 10.0, 0x01: 0.5}), ("23 00 0a 32 f6", {0x00: 10.0, 0x01: 0.5, 0x02: -1.0}),
        # a count of its own, a register of two bytes: 0x120 is 0xa0 0x02
        ("20 04 00 0a 32 f6 01", {0x00: 10.0, 0x01: 0.5, 0x02: -1.0, 0x03: 0.5}),
        ("29 a0 02 01 00 00 80", {0x120: -2147483647.0}), ("29 80 02 01 00 00 00", {0x100: 1.0}),
        ("20 00 21 00 0a", {0x00: 10.0}),  # none of a kind, and then one
        ("21 00 0a 21 0f 20", {0x00: 10.0, 0x0F: 32.0}), ("21 00 0a 21 00 0b", {0x00: 11.0}),
        # what is asked for in between is no answer; an error ends the frame
        ("11 00 21 00 0a", {0x00: 10.0}), ("21 00 0a 31 05 01 2f", {0x00: 10.0}), ("21 00 0a 30 05", {0x00: 10.0}),
        # not whole, or of another kind
        *((text, None) for text in (
            "21", "21 00", "22 00 0a", "25 00 0a", "29 00 0a 00 00", "2d 00 0a 00 00", "20", "20 04", "20 81", "29 a0",
            "23 00 0a 0a", "01 00 0a", "41 00", "21 00 0a 01 00 0a", "21 00 0a 21 00", "20 02 00 0a",
        )),
    ],
)  # fmt: skip
def test_frame_gives_its_registers_each_at_its_scale(text, found):
    assert said(text) == (None if found is None else pytest.approx(found, rel=1e-12))


@pytest.mark.parametrize(
    ("register", "scales"),
    [
        (0x20, {0: 0.01, 1: 0.0001, 2: 0.00001}),
        (0x21, {0: 0.1, 1: 0.00025}),
        (0x22, {0: 0.5, 2: 0.001}),
        (0x23, {0: 1.0}),
        (0x24, {1: 1.0}),
        (0x25, {0: 0.5, 1: 0.01}),
        (0x26, {0: 1.0}),
        (0x27, {0: 0.01, 1: 0.001, 2: 0.000001, 3: 1.0}),
        (0x28, {0: 1.0}),
    ],
)
def test_command_has_the_scale_of_what_is_read_and_a_time_its_own(register, scales):
    for width, scale in scales.items():
        number = struct.pack("<" + "bhif"[width], 3)
        found: Any = registers(bytes((WRITE | width << 2 | 1, register)) + number, WRITE)
        assert found == {register: pytest.approx(3 * scale, rel=1e-12)}
    assert said("01 00 0a", WRITE) == said("1f 01 01 00 0a", WRITE) == {0: 10.0}
    assert said("21 00 0a", WRITE) is None


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
    ("text", "found"),
    [
        ("", ()),
        ("11 00", ((0x00, 0),)),
        ("11 00 1f 01 13 0d", ((0, 0), (1, 3), (2, 3), (3, 3), (0xD, 0), (0xE, 0), (0xF, 0))),
        ("1b a0 02", ((0x120, 2), (0x121, 2), (0x122, 2))),
        ("16 05", ((5, 1), (6, 1))),
        ("18 04 01", ((1, 2), (2, 2), (3, 2), (4, 2))),
        ("01 00 0a 11 03", ((3, 0),)),
        ("50 11 03 50", ((3, 0),)),
        ("11 03 30 11 04", ((3, 0),)),  # an error ends the frame
    ],
)
def test_registers_that_a_frame_asks_for_are_in_its_order(text, found):
    assert asked(bytes.fromhex(text)) == found


@pytest.mark.parametrize(
    ("text", "reply"),
    [
        ("11 00", "21 00 0a"),
        ("13 00", "23 00 0a 32 f6"),
        ("14 04 00", "24 04 00 0a 00 88 13 60 f0 96 00"),
        ("12 01 11 03", "23 01 32 f6 03"),  # what follows one another goes together
        ("11 02 11 01", "21 02 f6 21 01 32"),
        ("11 01 15 02", "21 01 32 25 02 60 f0"),
        ("1d 01", "2d 01 00 00 00 3f"),
        ("19 03", "29 03 dc 05 00 00"),
        ("13 0d", "23 0d 30 1e 00"),
        ("18 04 a0 02", "2b a0 02 01 00 00 00 00 00 00 00 00 00 00 00 31 a3 02 01"),
        ("12 0f", "21 0f 00 31 10 01"),
        ("11 10 11 00", "31 10 01 21 00 0a"),
        ("19 81 02", "29 81 02 00 00 01 00"),
        ("15 05", "25 05 00 80"),
        ("1d 05", "2d 05 00 00 c0 7f"),
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


def test_integer_saturates_one_short_of_the_one_that_is_not_a_number():
    for value, raw in ((1.27, 127), (1.29, 127), (9.0, 127), (-1.27, -127), (-1.28, -127), (-9.0, -127)):
        assert replied(b"\x11\1", value) == bytes((0x21, 1)) + struct.pack("b", raw)
        assert replied(b"\x11\1", value, state=DriveState.RUN | INVALID) == b"\x21\1\x80"
