"""CiA 402: how many bytes of an expedited SDO answer count, and which objects are signed numbers."""

from __future__ import annotations

import pytest

from drivers.cia402 import objects as o
from drivers.cia402.objects import ABORTS, mapped, read_value
from plant_fmu.drives.cia402_dictionary import ENTRIES, signed

BYTES = "78563412"


@pytest.mark.parametrize(
    ("head", "value"),
    [
        pytest.param(0x43, 0x12345678, id="4 bytes"),
        pytest.param(0x47, 0x345678, id="3 bytes"),
        pytest.param(0x4B, 0x5678, id="2 bytes"),
        pytest.param(0x4F, 0x78, id="1 byte"),
        pytest.param(0x42, 0x12345678, id="no size"),
        # without the bit that says so, the two bits of the size say nothing
        pytest.param(0x46, 0x12345678, id="no size, bit 2"),
        pytest.param(0x4A, 0x12345678, id="no size, bit 3"),
        pytest.param(0x4E, 0x12345678, id="no size, both bits"),
    ],
)
def test_the_bytes_that_are_read_are_those_of_the_size_where_one_is_said_else_all_four(head, value):
    assert read_value(bytes.fromhex(f"{head:02x}646000{BYTES}")) == ((0x6064, 0), value)


@pytest.mark.parametrize("head", [0x40, 0x41, 0x44, 0x49, 0x4D])
def test_an_answer_that_is_to_come_in_segments_is_none(head):
    assert read_value(bytes.fromhex(f"{head:02x}646000{BYTES}")) is None


def test_an_abort_and_a_confirmation_carry_no_value():
    for text in ("8064600030000906", "8064600000000000", f"60646002{BYTES}", f"43646000{BYTES[:6]}"):
        assert read_value(bytes.fromhex(text)) is None


ABORT_CODES = (
    *(0x0503_0000, 0x0504_0000, 0x0504_0001, 0x0504_0005, 0x0601_0000, 0x0601_0001, 0x0601_0002, 0x0602_0000),
    *(0x0604_0041, 0x0604_0042, 0x0604_0043, 0x0604_0047, 0x0606_0000, 0x0607_0010, 0x0607_0012, 0x0607_0013),
    *(0x0609_0011, 0x0609_0030, 0x0609_0031, 0x0609_0032, 0x0800_0000, 0x0800_0020, 0x0800_0021, 0x0800_0022),
)
"""Of CiA 301, table 22."""


def test_abort_codes_have_the_numbers_of_the_document_and_each_words_of_its_own():
    assert tuple(sorted(ABORTS)) == ABORT_CODES
    assert len(set(ABORTS.values())) == len(ABORTS)
    for code, words in (
        (0x0601_0001, "read a write only"),
        (0x0601_0002, "write a read only"),
        (0x0602_0000, "object does not exist"),
        (0x0604_0041, "cannot be mapped"),
        (0x0604_0042, "exceed the PDO length"),
        (0x0607_0012, "too high"),
        (0x0607_0013, "too low"),
        (0x0609_0011, "sub-index does not exist"),
        (0x0609_0030, "invalid value"),
        (0x0504_0001, "command specifier"),
        (0x0800_0022, "present device state"),
    ):
        assert words in ABORTS[code]


def test_an_entry_of_a_mapping_has_index_sub_index_and_bits():
    assert mapped((0x6064, 0x12), 32) == 0x60641220


SIGNED = {
    o.ABORT_CONNECTION,
    o.QUICK_STOP,
    o.FAULT_REACTION,
    o.MODE,
    o.MODE_SHOWN,
    o.POSITION,
    o.VELOCITY,
    o.TARGET_TORQUE,
    o.TORQUE,
    o.PERIOD_EXPONENT,
}
"""INTEGER8, 16 and 32 of CiA 402-2; the others are UNSIGNED."""


def test_an_object_of_all_ones_is_minus_one_where_it_is_signed_else_the_largest_number():
    assert set(ENTRIES) > SIGNED
    for key, entry in ENTRIES.items():
        ones = (1 << 8 * entry.size) - 1
        assert signed(key, ones) == (-1 if key in SIGNED else ones), o.place(key)
        assert signed(key, ones >> 1) == ones >> 1, o.place(key)
