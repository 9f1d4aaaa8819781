"""Objects of the emulated CiA 402 drives: sizes and signs, values that they take, and mappings of PDOs."""

from __future__ import annotations

import pytest

from drivers.cia402 import objects as o
from drivers.cia402.objects import read_value
from plant_fmu.drives.cia402_dictionary import (
    ENTRIES,
    PDOS,
    PLACE,
    defaults,
    missing,
    refused,
    signed,
)

NODE = 5
NEW = defaults(NODE, 9000, 4096)


@pytest.mark.parametrize(
    ("head", "value"),
    [
        (0x43, 0x12345678), (0x47, 0x345678), (0x4B, 0x5678), (0x4F, 0x78), (0x42, 0x12345678),
        # without bit 0 the two bits of the size mean nothing
        (0x46, 0x12345678), (0x4A, 0x12345678), (0x4E, 0x12345678),
        # to come in segments; an abort; a confirmation
        (0x40, None), (0x41, None), (0x44, None), (0x49, None), (0x4D, None), (0x80, None), (0x60, None),
    ],
)  # fmt: skip
def test_answer_has_as_many_bytes_as_its_size_gives_else_four(head, value):
    data = bytes.fromhex(f"{head:02x}64601278563412")
    assert read_value(data) == (None if value is None else ((0x6064, 0x12), value))
    assert read_value(data[:7]) is None


SIGNED = {
    o.ABORT_CONNECTION, o.QUICK_STOP, o.FAULT_REACTION, o.MODE, o.MODE_SHOWN, o.POSITION, o.VELOCITY,
    o.TARGET_TORQUE, o.TORQUE, o.PERIOD_EXPONENT,
}  # fmt: skip
"""INTEGER8, 16 and 32 of CiA 402-2; the others are UNSIGNED."""
TAKEN = {
    (0x1029, 1): {0, 1}, (0x6007, 0): {1}, (0x605A, 0): {0, 2}, (0x605E, 0): {0, 1, 2}, (0x6060, 0): {4, 10},
    **{(0x1400 + n, 2): {254, 255} for n in range(4)}, **{(0x1800 + n, 2): {1, 254, 255} for n in range(4)},
}  # fmt: skip
"""Of the objects of one or two bytes that do not take every value."""


def test_object_is_signed_as_declared_and_takes_the_values_that_mean_something():
    assert len(ENTRIES) == len(set(PLACE.values())) == len(NEW)
    assert [missing(key) for key in (o.MODE, (0x6060, 1), (0x2000, 0))] == [0, o.NO_SUB_INDEX, o.NO_OBJECT]
    limited = {}
    for key, entry in ENTRIES.items():
        most = (1 << 8 * entry.size) - 1
        assert signed(key, most) == (-1 if key in SIGNED else most), o.place(key)
        assert signed(key, most >> 1) == most >> 1, o.place(key)
        if entry.writable and entry.size < 4 and not (0x1400 <= key[0] < 0x1C00 and key[0] & 0x200):
            every = {*range(min(300, most)), most}
            if (taken := {v for v in every if not refused(NEW, key, v, entry.size)}) != every:
                limited[key] = taken
    assert limited == TAKEN


def with_value(values, key, value):
    values = values.copy()
    values[PLACE[key]] = value
    return values


@pytest.mark.parametrize("n", range(PDOS))
@pytest.mark.parametrize(
    ("parameters", "entry", "other"), [(o.RPDO, 0x60400010, 0x60640020), (o.TPDO, 0x60410010, 0x12340010)]
)
def test_mapping_is_changed_while_its_own_pdo_is_off_and_it_is_empty(parameters, entry, other, n):
    mapping, on = parameters + 0x200 + n, NEW
    for k in range(PDOS):
        on = with_value(on, (parameters + k, 1), 0x200 + 0x100 * k + NODE)
    on = with_value(on, (mapping, 0), 0)
    off = with_value(on, (parameters + n, 1), o.NOT_VALID | 0x200 + NODE)
    assert [refused(off, (mapping, 1), each, 4) for each in (entry, other)] == [0, o.CANNOT_MAP]
    assert refused(on, (mapping, 1), entry, 4) == refused(on, (mapping, 0), 1, 1) == o.BAD_STATE
    filled = with_value(with_value(off, (mapping, 1), entry), (mapping, 0), 1)
    assert [refused(filled, (mapping, sub), v, size) for sub, v, size in ((1, entry, 4), (0, 0, 1))] == [
        o.BAD_STATE,
        0,
    ]
