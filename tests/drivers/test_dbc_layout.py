"""Which messages of a DBC the codecs take: fields in order, on their bytes, as wide as can be read."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.errors import ProtocolError
from drivers.legs.messages import layout_of, parsed
from drivers.protocol import BRS, FD, Frame
from tests.drivers.test_crc import crc8

ATTRIBUTES = """
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","StandardCAN_FD";
BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_DEF_DEF_ "CANFD_BRS" "0";
"""


def message(length: int, *fields: str, attributes: str = "", floats: str = "") -> Any:
    """Return a message with these fields, called A, B, C and so on but for the last one where it is a CRC."""
    names = "ABCDEFG"
    lines = [
        f" SG_ {'CRC' if field.endswith('crc') else names[k]} : {field.removesuffix('crc')} "
        f'{"" if "(" in field else "(1,0) "}[0|1] "" X'
        for k, field in enumerate(fields)
    ]
    text = "\n".join(['VERSION "1"', "BU_: X", f"BO_ 291 M: {length} X", *lines])
    return parsed(f"{text}\n{floats}{ATTRIBUTES}{attributes}").get_message_by_name("M")


def test_a_layout_says_where_each_field_lies_in_the_order_of_the_fields():
    layout = layout_of(message(8, "16|8@1-(2,0)", "0|16@1+(0.5,0)", "24|5@1+"))
    assert (layout.id, layout.length, layout.flags) == (291, 8, 0)
    assert layout.signals == ("B", "A", "C")
    assert layout.places == ((0, 16), (16, 8), (24, 5))
    assert layout.scale == (0.5, 2.0, 1.0)
    assert layout.place("C") == (24, 5)


@pytest.mark.parametrize(
    ("format_", "switch", "flags"), [(0, None, 0), (1, None, FD), (1, 1, FD | BRS), (1, 0, FD), (0, 1, BRS)]
)
def test_a_message_is_of_can_fd_and_has_its_bit_rate_switched_where_the_dbc_says_so(format_, switch, flags):
    attributes = f'BA_ "VFrameFormat" BO_ 291 {format_};\n'
    if switch is not None:
        attributes += f'BA_ "CANFD_BRS" BO_ 291 {switch};\n'
    made = message(8, "0|64@1-", attributes=attributes, floats="SIG_VALTYPE_ 291 A : 2;\n")
    assert layout_of(made).flags == flags


@pytest.mark.parametrize(
    ("fields", "wrong"),
    [
        (("0|8@1+", "8|16@1+"), ""),
        (("0|4@1+", "4|32@1+"), ""),
        (("0|4@1+", "4|33@1+"), "B"),
        (("0|8@1+", "8|33@1+"), ""),
        (("0|8@1+", "15|8@0+"), "B"),
        (("0|8@1+(1,1)", "8|8@1+"), "A"),
    ],
)
def test_a_field_that_cannot_be_read_is_named(fields, wrong):
    made = message(8, *fields)
    if not wrong:
        assert len(layout_of(made).places) == 2
        return
    with pytest.raises(ProtocolError, match=rf"M\.{wrong} is no little-endian field that can be read"):
        layout_of(made)


def test_whole_numbers_are_packed_by_their_low_bits_and_read_back_without_a_sign():
    fields = ("0|32@1-", "32|16@1+", "56|4@1+", "60|4@1+", "64|8@1+", "72|8@1+crc")
    layout = layout_of(message(10, *fields))
    packed = layout.pack(-5, 0x1234, 0xA7, 0xA, 9)
    assert packed == struct.pack("<iHxBBx", -5, 0x1234, 0xA7, 9), "a byte between is empty"
    assert layout.unpack(packed[:-1] + b"\xff") == [(1 << 32) - 5, 0x1234, 7, 0xA, 9, 0xFF]


def test_the_last_byte_of_a_frame_is_its_check_though_bytes_before_it_are_empty():
    layout = layout_of(message(6, "0|8@1+", "8|16@1+", "40|8@1+crc"))
    data = struct.pack("<BHxx", 3, 0x1234)
    assert layout.frame(0x125, 3, 0x1234) == Frame(0x125, data + bytes([crc8(b"\x25\x01" + data)]), 0)
