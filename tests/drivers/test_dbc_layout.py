"""Which messages of a DBC the codecs take: fields in order, on their bytes, as wide as can be read."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.errors import ProtocolError
from drivers.legs.codec import Place, compile_message, layout_of, parsed
from drivers.protocol import BRS, FD

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
    layout = layout_of(message(8, "16|8@1-(2,0)", "0|16@1+(0.5,0)", "24|5@1+"), "B", "A", "C")
    assert (layout.id, layout.length, layout.flags, layout.exact) == (291, 8, 0, False)
    assert layout.places == (Place(0, 16, False), Place(16, 8, False), Place(24, 5, False))
    assert layout.scale == (0.5, 2.0, 1.0)
    assert layout.place("C") == (24, 5, False)


@pytest.mark.parametrize(
    ("format_", "switch", "flags"), [(0, None, 0), (1, None, FD), (1, 1, FD | BRS), (1, 0, FD), (0, 1, BRS)]
)
def test_a_message_is_of_can_fd_and_has_its_bit_rate_switched_where_the_dbc_says_so(format_, switch, flags):
    attributes = f'BA_ "VFrameFormat" BO_ 291 {format_};\n'
    if switch is not None:
        attributes += f'BA_ "CANFD_BRS" BO_ 291 {switch};\n'
    made = message(8, "0|64@1-", attributes=attributes, floats="SIG_VALTYPE_ 291 A : 2;\n")
    assert (layout_of(made, "A").flags, layout_of(made, "A").exact) == (flags, True)
    assert compile_message(made, "A").flags == flags


def test_other_signals_than_are_expected_are_refused():
    for expected in (("A",), ("B", "A"), ("A", "B", "C")):
        with pytest.raises(ProtocolError, match=r"M has the signals \('A', 'B'\), expected \("):
            layout_of(message(8, "0|8@1+", "8|8@1+"), *expected)


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
        assert len(layout_of(made, "A", "B").places) == 2
        return
    with pytest.raises(ProtocolError, match=rf"M\.{wrong} is no little-endian field that can be read"):
        layout_of(made, "A", "B")


def test_whole_fields_and_halves_of_a_byte_are_packed_and_the_check_is_left_out():
    fields = ("0|32@1-", "32|16@1+", "56|4@1+", "60|4@1+", "64|8@1+", "72|8@1+crc")
    codec = compile_message(message(10, *fields), "A", "B", "C", "D", "E", "CRC")
    packed = codec.pack(-5, 0x1234, 0xA7, 9)
    assert packed == struct.pack("<iHxBB", -5, 0x1234, 0xA7, 9), "a byte between is empty"
    assert codec.unpack(packed + b"\xff") == (-5, 0x1234, 0xA7, 9)
    plain = compile_message(message(9, *fields[:5]), "A", "B", "C", "D", "E")
    assert plain.unpack(plain.pack(-5, 0x1234, 0xA7, 9)) == (-5, 0x1234, 0xA7, 9)


def test_a_double_is_packed_as_one():
    made = message(9, "0|64@1-", "64|8@1+", floats="SIG_VALTYPE_ 291 A : 2;\n")
    assert compile_message(made, "A", "B").pack(0.1, 7) == struct.pack("<dB", 0.1, 7)


@pytest.mark.parametrize(
    ("length", "fields", "message_"),
    [
        (3, ("0|8@1+", "8|12@1+"), r"M\.B is not a little-endian field on a byte"),
        (2, ("0|4@1+", "5|4@1+"), r"M\.B is not a little-endian field on a byte"),
        (2, ("0|4@1+", "5|8@1+"), r"M\.B is not a little-endian field on a byte"),
        (2, ("0|2@1+", "2|2@1+"), r"M\.A is not a little-endian field on a byte"),
        (2, ("0|8@1+", "8|3@1+"), r"M\.B is not a little-endian field on a byte"),
        (2, ("0|4@1+", "12|4@1+"), r"M\.B is not a little-endian field on a byte"),
        (3, ("0|8@1+", "8|8@1+"), "the last field of M is not its last byte"),
        (3, ("0|8@1+", "8|16@1+crc"), "the last field of M is not its last byte"),
        (2, ("0|8@1+", "8|8@1+crc"), ""),
        (3, ("0|8@1+", "8|16@1+"), ""),
    ],
)
def test_what_struct_cannot_pack_is_refused(length, fields, message_):
    made = message(length, *fields)
    names = "A", "CRC" if fields[1].endswith("crc") else "B"
    if not message_:
        assert compile_message(made, *names).length == length
        return
    with pytest.raises(ProtocolError, match=message_):
        compile_message(made, *names)
