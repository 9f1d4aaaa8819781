"""The object dictionary of the emulated CiA 402 drives: what is in it, and which values its objects take."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.cia402 import objects as o
from plant_fmu.drives.cia402_dictionary import ENTRIES, PLACE, defaults, fill_pdos, refused
from plant_fmu.drives.cia402_kernels import DEVICE

NODE = 5
NEW = defaults(NODE, 9000, 4096)
TAKEN = {
    (0x1029, 1): {0, 1},
    (0x6007, 0): {1},
    (0x605A, 0): {0, 2},
    (0x605E, 0): {0, 1, 2},
    (0x6060, 0): {4, 10},
    **{(0x1400 + n, 2): {254, 255} for n in range(4)},
    **{(0x1800 + n, 2): {1, 254, 255} for n in range(4)},
}
"""Of the objects of one or two bytes that do not take every value."""


def test_the_emulated_drives_have_each_object_at_a_place_of_its_own():
    assert len(ENTRIES) == len(set(PLACE.values())) == len(NEW)


def test_an_object_takes_the_values_that_mean_something_and_no_others():
    limited = {}
    for key, entry in ENTRIES.items():
        if entry.writable and entry.size < 4 and not 0x1600 <= key[0] < 0x1800 and key[0] < 0x1A00:
            values = {v for v in range(300) if v < 1 << 8 * entry.size and not refused(NEW, key, v, 0)}
            if values != set(range(1 << 8 * entry.size)) & set(range(300)):
                limited[key] = values
    for key in ((0x605A, 0), (0x605E, 0), (0x6060, 0), (0x6007, 0)):
        size = ENTRIES[key].size
        limited[key] = {v for v in range(300) if v < 1 << 8 * size and not refused(NEW, key, v, size)}
        assert refused(NEW, key, (1 << 8 * size) - 1, size) == o.BAD_VALUE, "-1"
    assert limited == TAKEN


@pytest.mark.parametrize("n", range(4))
def test_a_pdo_exists_while_its_identifier_is_valid_and_something_is_mapped(n):
    parameters, mapping = o.TPDO + n, o.TPDO_MAP + n
    row = np.zeros(1, DEVICE)[0]
    for valid, count in ((True, 2), (True, 1), (True, 0), (False, 2)):
        identifier = 0x300 + NODE | (0 if valid else 1 << 31)
        row["values"] = NEW
        own = {(mapping, 1): 0x60640020, (mapping, 2): 0x60410010, (mapping, 0): count}
        for key, value in {**own, (parameters, 1): identifier, (parameters, 2): o.AT_EVERY_SYNC}.items():
            row["values"][PLACE[key]] = value
        fill_pdos(row)
        found = [
            (row["places"][1, k, : row["counts"][1, k]].tolist(), row["sizes"][1, k])
            for k in range(4)
            if row["pdos"][1, k] == 0x300 + NODE
        ]
        places = [PLACE[0x6064, 0], PLACE[0x6041, 0]][:count]
        assert found == ([(places, 4 + 2 * (count > 1))] if valid and count else [])
