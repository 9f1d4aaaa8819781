"""Rules on encoders that may be lost and on a pose that has become uncertain."""

from __future__ import annotations

from math import nan

import pytest

from hil.safety.encoders import contradicted, excused, uncertain

NONE = (False,) * 6


def legs(*which):
    return tuple(leg in which for leg in range(6))


@pytest.mark.parametrize(
    ("lost", "may", "at_once", "fine"),
    [
        ((), range(6), 1, ()),
        ((2,), range(6), 1, (2,)),
        ((2,), (0, 1), 1, ()),
        ((2, 4), range(6), 1, ()),
        ((2, 4), range(6), 2, (2, 4)),
        ((2, 4), (4,), 2, (4,)),
        ((2,), (), 6, ()),
        ((2, 4), (4,), 1, ()),
        ((0, 1, 5), (5,), 2, ()),
        ((0, 1, 5), (5,), 3, (5,)),
    ],
)
def test_only_few_and_only_the_named_legs_are_excused(lost, may, at_once, fine):
    assert excused(legs(*lost), tuple(may), at_once) == legs(*fine)


def test_a_slip_counts_unless_its_leg_is_excused():
    assert not contradicted(NONE, NONE)
    assert contradicted(legs(3), NONE)
    assert not contradicted(legs(3), legs(3))
    assert contradicted(legs(3, 4), legs(3))


def test_doubt_at_its_limit_is_fine_and_what_is_no_number_is_not():
    assert not uncertain(5e-3, 5e-3)
    assert uncertain(5.0001e-3, 5e-3)
    assert uncertain(nan, 5e-3)
