"""What the numbers in a log are called: by the names of its own table, whatever version wrote it."""

from __future__ import annotations

from enum import IntEnum, IntFlag

import pytest

from drivers.tick_columns import Column
from hil.record.selection import name_of

KIND = IntEnum("KIND", {"NONE": 0, "SLOW": 1, "FAST": 4})
BITS = IntFlag("BITS", {"NONE": 0, "LATE": 1, "LOST": 2, "BOTH": 3, "HOT": 8})
KINDS, FLAGS = (Column("output", "x", kind, "", "") for kind in (KIND, BITS))


@pytest.mark.parametrize(
    ("number", "name"), [(0, "NONE"), (1, "SLOW"), (4, "FAST"), (2, "2"), (5, "5"), (-1, "-1")]
)
def test_a_number_of_an_enumeration_has_its_name_or_stands_as_itself(number, name):
    assert name_of(KINDS, number) == name


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (0, "NONE"),
        (1, "LATE"),
        (2, "LOST"),
        (8, "HOT"),
        (9, "LATE|HOT"),
        (3, "LATE|LOST"),
        (4, "4"),
        (5, "LATE|4"),
        (0x30, "48"),
        (0x39, "LATE|HOT|48"),
    ],
)
def test_flags_are_those_whose_bits_are_all_set_and_what_has_no_name_is_their_rest(number, name):
    assert name_of(FLAGS, number) == name
