"""Objects of the emulated CiA 402 drives: their sizes and signs, values that they take, and mappings of PDOs."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.cia402 import objects as o
from drivers.cia402.objects import ABORTS, mapped, read_value
from plant_fmu.drives.cia402_dictionary import (
    ENTRIES,
    MAPPED,
    PDOS,
    PLACE,
    defaults,
    fill_pdos,
    missing,
    refused,
    signed,
)
from plant_fmu.drives.cia402_kernels import DEVICE

NODE = 5
NEW = defaults(NODE, 9000, 4096)


@pytest.mark.parametrize(
    ("head", "value"),
    [
        (0x43, 0x12345678), (0x47, 0x345678), (0x4B, 0x5678), (0x4F, 0x78), (0x42, 0x12345678),
        # without bit 0 the two bits of the size mean nothing
        (0x46, 0x12345678), (0x4A, 0x12345678), (0x4E, 0x12345678),
        # to come in segments
        (0x40, None), (0x41, None), (0x44, None), (0x49, None), (0x4D, None),
        # an abort, and a confirmation
        (0x80, None), (0x60, None),
    ],
)  # fmt: skip
def test_an_answer_has_as_many_bytes_as_its_size_gives_else_four(head, value):
    data = bytes.fromhex(f"{head:02x}64601278563412")
    assert read_value(data) == (None if value is None else ((0x6064, 0x12), value))
    assert read_value(data[:7]) is None


def test_abort_codes_have_the_numbers_of_the_document():
    """Of CiA 301, table 22."""
    assert sorted(ABORTS) == [
        *(0x0503_0000, 0x0504_0000, 0x0504_0001, 0x0504_0005, 0x0601_0000, 0x0601_0001, 0x0601_0002),
        *(0x0602_0000, 0x0604_0041, 0x0604_0042, 0x0604_0043, 0x0604_0047, 0x0606_0000, 0x0607_0010),
        *(0x0607_0012, 0x0607_0013, 0x0609_0011, 0x0609_0030, 0x0609_0031, 0x0609_0032, 0x0800_0000),
        *(0x0800_0020, 0x0800_0021, 0x0800_0022),
    ]
    assert len(set(ABORTS.values())) == len(ABORTS)


SIGNED = {
    o.ABORT_CONNECTION, o.QUICK_STOP, o.FAULT_REACTION, o.MODE, o.MODE_SHOWN, o.POSITION, o.VELOCITY,
    o.TARGET_TORQUE, o.TORQUE, o.PERIOD_EXPONENT,
}  # fmt: skip
"""INTEGER8, 16 and 32 of CiA 402-2; the others are UNSIGNED."""


def test_all_ones_are_minus_one_where_an_object_is_signed_else_the_largest_number():
    assert set(ENTRIES) > SIGNED
    assert len(ENTRIES) == len(set(PLACE.values())) == len(NEW)
    for key, entry in ENTRIES.items():
        ones = (1 << 8 * entry.size) - 1
        assert signed(key, ones) == (-1 if key in SIGNED else ones), o.place(key)
        assert signed(key, ones >> 1) == ones >> 1, o.place(key)
    assert [missing(key) for key in (o.MODE, (0x6060, 1), (0x2000, 0))] == [0, o.NO_SUB_INDEX, o.NO_OBJECT]


TAKEN = {
    (0x1029, 1): {0, 1}, (0x6007, 0): {1}, (0x605A, 0): {0, 2}, (0x605E, 0): {0, 1, 2}, (0x6060, 0): {4, 10},
    **{(0x1400 + n, 2): {254, 255} for n in range(4)}, **{(0x1800 + n, 2): {1, 254, 255} for n in range(4)},
}  # fmt: skip
"""Of the objects of one or two bytes that do not take every value."""


def test_an_object_takes_the_values_that_mean_something():
    limited = {}
    for key, entry in ENTRIES.items():
        if entry.writable and entry.size < 4 and not (0x1400 <= key[0] < 0x1C00 and key[0] & 0x200):
            most = (1 << 8 * entry.size) - 1
            every = {*range(min(300, most)), most}
            if (taken := {v for v in every if not refused(NEW, key, v, entry.size)}) != every:
                limited[key] = taken
    assert limited == TAKEN


@pytest.mark.parametrize(
    ("cob", "code"),
    [
        (0x204, 0),
        (0x80000204, 0),
        (0, o.BAD_VALUE),
        (1, 0),
        (0x7FF, 0),
        (0x800, o.BAD_VALUE),
        (0xC0000000, 0),
    ],
)
def test_identifier_of_a_pdo_has_eleven_bits_is_not_nmts_and_changes_while_it_is_off(cob, code):
    for key, here in (((0x1400, 1), 0x200 + NODE), ((0x1800, 1), 0x180 + NODE)):
        on, off = (with_value(NEW, key, here | valid) for valid in (0, o.NOT_VALID))
        assert refused(off, key, cob, 4) == code
        assert refused(on, key, here + 1, 4) == o.BAD_STATE
        assert refused(on, key, here, 4) == refused(on, key, o.NOT_VALID | here + 1, 4) == 0


# mappings, in the order of CiA 301: off, emptied, filled, counted, on


def with_value(values, key, value):
    values = values.copy()
    values[PLACE[key]] = value
    return values


def drive(parameters, *, valid):
    """Return a dictionary in which each PDO of a kind is on, or off."""
    values = NEW
    for n in range(PDOS):
        identifier = 0x200 + 0x100 * n + NODE
        values = with_value(values, (parameters + n, 1), identifier | (0 if valid else o.NOT_VALID))
    return values


@pytest.mark.parametrize("n", range(PDOS))
@pytest.mark.parametrize(
    ("parameters", "entry", "other"), [(o.RPDO, 0x60400010, 0x60640020), (o.TPDO, 0x60410010, 0x12340010)]
)
def test_a_mapping_is_changed_while_its_own_pdo_is_off_and_it_is_empty(parameters, entry, other, n):
    mapping = parameters + 0x200 + n
    off, on = (with_value(drive(parameters, valid=valid), (mapping, 0), 0) for valid in (False, True))
    assert refused(off, (mapping, 1), entry, 4) == 0
    assert refused(off, (mapping, 1), other, 4) == o.CANNOT_MAP
    for sub, value in ((1, entry), (0, 1)):
        assert refused(on, (mapping, sub), value, 4 if sub else 1) == o.BAD_STATE
    filled = with_value(with_value(off, (mapping, 1), entry), (mapping, 0), 1)
    assert refused(filled, (mapping, 1), entry, 4) == o.BAD_STATE
    assert refused(filled, (mapping, 0), 0, 1) == 0
    alone = with_value(on, (parameters + n, 1), o.NOT_VALID | 0x200 + NODE)
    assert refused(alone, (mapping, 1), entry, 4) == 0, "the others may be on"


def test_a_mapping_counts_entries_that_fit_into_eight_bytes():
    mapping = o.TPDO + 0x200
    values = with_value(drive(o.TPDO, valid=False), (mapping, 0), 0)
    for sub in range(1, MAPPED + 1):
        values = with_value(values, (mapping, sub), mapped((0x6064, 0), 32))
    assert refused(values, (mapping, 0), 2, 1) == 0
    assert refused(values, (mapping, 0), 3, 1) == o.MAPPING_TOO_LONG
    assert refused(values, (mapping, 0), MAPPED + 1, 1) == o.MAPPING_TOO_LONG
    assert refused(with_value(values, (mapping, 2), 0), (mapping, 0), 2, 1) == o.CANNOT_MAP
    for sub in range(1, MAPPED + 1):
        values = with_value(values, (mapping, sub), 0x60410010)
    assert refused(values, (mapping, 0), MAPPED, 1) == 0
    assert refused(values, (mapping, 1), 0x60410110, 4) == o.CANNOT_MAP, "an unknown sub-index"
    assert mapped((0x6064, 0x12), 32) == 0x60641220


@pytest.mark.parametrize("node", [1, 5, 127])
def test_a_new_drive_has_the_predefined_identifiers_and_one_pdo_of_a_direction_on(node):
    values = defaults(node, 1000, 4096)
    for parameters, base in ((0x1400, 0x200), (0x1800, 0x180)):
        found = [values[PLACE[parameters + n, 1]] for n in range(4)]
        assert found == [(n > 0) << 31 | base + 0x100 * n + node for n in range(4)]


@pytest.mark.parametrize("n", range(PDOS))
def test_a_pdo_exists_while_its_identifier_is_valid_and_something_is_mapped(n):
    row = np.zeros(1, DEVICE)[0]
    for valid, count in ((True, 2), (True, 1), (True, 0), (False, 2)):
        row["values"] = NEW
        own = {(o.TPDO_MAP + n, 1): 0x60640020, (o.TPDO_MAP + n, 2): 0x60410010, (o.TPDO_MAP + n, 0): count}
        identifier = 0x300 + NODE | (0 if valid else o.NOT_VALID)
        for key, value in {**own, (o.TPDO + n, 1): identifier, (o.TPDO + n, 2): o.AT_EVERY_SYNC}.items():
            row["values"][PLACE[key]] = value
        fill_pdos(row)
        found = [
            (row["places"][1, k, : row["counts"][1, k]].tolist(), row["sizes"][1, k])
            for k in range(4)
            if row["pdos"][1, k] == 0x300 + NODE
        ]
        places = [PLACE[0x6064, 0], PLACE[0x6041, 0]][:count]
        assert found == ([(places, 4 + 2 * (count > 1))] if valid and count else [])
