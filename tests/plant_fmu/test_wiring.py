"""Wiring mistakes: each changes its own field at its own legs, and nothing else."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired


def changed(wiring: Wiring) -> dict[str, Any]:
    """Fields that differ from a correct wiring."""
    right = Wiring()
    pairs = ((f.name, getattr(wiring, f.name), getattr(right, f.name)) for f in fields(Wiring))
    return {name: there for name, there, should in pairs if there != should}


@pytest.mark.parametrize(
    ("name", "legs"),
    [
        ("offset", (6,)),
        ("ids_swapped", (0,)),
        ("ids_swapped", (2, 2)),
        ("ids_rotated", (0, 1, 1)),
        ("none", (0,)),
    ],
)
def test_unknown_wiring_mistakes_and_missing_or_repeated_legs_are_refused(name, legs):
    with pytest.raises(ValueError, match=r"different legs|unknown"):
        wired(Mistake(name, *legs))


def test_several_wiring_mistakes_combine_by_multiplication_or_in_sequence():
    both = wired(Mistake("encoder_scale", 1, value=3.0), Mistake("drive_reversed", 1))
    assert changed(both) == {
        "scale": (1.0, -3.0, 1.0, 1.0, 1.0, 1.0),
        "force_gain": (1.0, -1.0, 1.0, 1.0, 1.0, 1.0),
    }
    twice = wired(Mistake("motor_crossed", 0, 1), Mistake("motor_crossed", 1, 2))
    assert changed(twice) == {"motor": (1, 2, 0, 3, 4, 5)}
    assert changed(wired(Mistake("offset", 5, value=-1e-3))) == {"offset_m": (0.0,) * 5 + (-1e-3,)}
    two = wired(Mistake("brake_of_another", 1, 4), Mistake("brake_of_another", 1, 0))
    assert two.brake[1] == {0, 1, 4}


def test_mistakes_made_when_mounting_the_legs_add_to_those_found_before_mounting():
    wiring = wired(Mistake("payload", 0, value=1.3, mounting=True), Mistake("offset", 2, value=1e-3))
    assert changed(wiring).keys() == {"offset_m", "mounting"}
    assert changed(wiring.as_mounted) == {"offset_m": wiring.offset_m, "payload": 1.3}
    right = wired(Mistake("offset", 2, value=1e-3))
    assert right.as_mounted is right
