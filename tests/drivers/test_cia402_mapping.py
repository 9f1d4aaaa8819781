"""The order in which a drive lets its PDOs be mapped, as CiA 301 has it: off, emptied, filled, counted, on."""

import pytest

from drivers.cia402 import objects as o
from plant_fmu.drives.cia402_dictionary import MAPPED, PDOS, PLACE, defaults, refused

NODE = 5


def with_value(values, key, value):
    """Return a dictionary with another value."""
    values = values.copy()
    values[PLACE[key]] = value
    return values


CASES = [
    (o.RPDO, 0x60400010, 0x60640020),
    (o.TPDO, 0x60410010, 0x12340010),
]
"""Parameters of a PDO, an entry that may be mapped, and one that may not."""


def drive(parameters, *, valid):
    """Return a dictionary in which each PDO of a kind is on, or off."""
    values = defaults(NODE, 1000, 4096)
    for n in range(PDOS):
        identifier = 0x200 + 0x100 * n + NODE
        values = with_value(values, (parameters + n, 1), identifier | (0 if valid else o.NOT_VALID))
    return values


@pytest.mark.parametrize("n", range(PDOS))
@pytest.mark.parametrize(("parameters", "entry", "other"), CASES)
def test_a_mapping_is_changed_only_while_its_own_pdo_is_off_and_it_is_empty(parameters, entry, other, n):
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


def test_a_mapping_counts_entries_that_fit_and_no_more_than_eight_bytes():
    mapping, four_bytes = o.TPDO + 0x200, 0x60640020
    values = with_value(drive(o.TPDO, valid=False), (mapping, 0), 0)
    for sub in range(1, MAPPED + 1):
        values = with_value(values, (mapping, sub), four_bytes)
    assert refused(values, (mapping, 0), 2, 1) == 0
    assert refused(values, (mapping, 0), 3, 1) == o.MAPPING_TOO_LONG
    assert refused(values, (mapping, 0), MAPPED + 1, 1) == o.MAPPING_TOO_LONG
    assert refused(with_value(values, (mapping, 2), 0), (mapping, 0), 2, 1) == o.CANNOT_MAP
    for sub in range(1, MAPPED + 1):
        values = with_value(values, (mapping, sub), 0x60410010)
    assert refused(values, (mapping, 0), MAPPED, 1) == 0
    assert refused(values, (mapping, 1), 0x60410110, 4) == o.CANNOT_MAP, "a sub-index that is not there"


@pytest.mark.parametrize("parameters", [o.RPDO, o.TPDO])
def test_the_identifier_of_a_pdo_is_another_one_only_while_it_is_off(parameters):
    on, off = (drive(parameters, valid=valid) for valid in (True, False))
    here, there = 0x200 + NODE, 0x300 + NODE
    key = (parameters, 1)
    assert refused(on, key, there, 4) == o.BAD_STATE
    assert refused(on, key, here, 4) == 0
    assert refused(on, key, o.NOT_VALID | there, 4) == 0
    assert refused(off, key, there, 4) == 0
    assert refused(off, key, 0, 4) == o.BAD_VALUE


@pytest.mark.parametrize("node", [1, 5, 127])
def test_a_drive_begins_with_the_identifiers_of_the_predefined_set_and_the_first_pdo_of_a_direction_on(node):
    values = defaults(node, 1000, 4096)
    for parameters, base in ((0x1400, 0x200), (0x1800, 0x180)):
        found = [values[PLACE[parameters + n, 1]] for n in range(4)]
        off = [0, 1 << 31, 1 << 31, 1 << 31]
        assert found == [off[n] | base + 0x100 * n + node for n in range(4)]
