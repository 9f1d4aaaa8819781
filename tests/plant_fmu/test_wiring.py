"""Mistakes of who wires a machine: each changes what it says, at the legs that it names, and nothing else."""

from __future__ import annotations

from dataclasses import fields
from math import inf
from typing import Any

import pytest

from plant_fmu.rehearsal.wiring import (
    MISTAKES,
    OF_WATCHDOG,
    Mistake,
    Wiring,
    legs_of,
    wired,
)

SWAPPED, ROTATED = (0, 1, 4, 3, 2, 5), (0, 1, 4, 3, 5, 2)
"""Legs 2 and 4 exchanged; 2, 4 and 5 handed round: each has what the next one had."""


def only(*legs: int) -> frozenset[int]:
    return frozenset(legs)


def at_2(value: Any, rest: Any) -> tuple[Any, ...]:
    return (rest, rest, value, rest, rest, rest)


def brakes(order: tuple[int, ...]) -> tuple[frozenset[int], ...]:
    return tuple(only(leg) for leg in order)


EXPECTED: dict[str, tuple[int, dict[str, Any]]] = {
    "ids_swapped": (2, {"motor": SWAPPED, "encoder": SWAPPED, "brake": brakes(SWAPPED)}),
    "ids_rotated": (3, {"motor": ROTATED, "encoder": ROTATED, "brake": brakes(ROTATED)}),
    "motor_crossed": (2, {"motor": SWAPPED}),
    "encoder_crossed": (2, {"encoder": SWAPPED}),
    "brake_crossed": (2, {"brake": brakes(SWAPPED)}),
    "brake_of_another": (2, {"brake": (only(0), only(1), only(2, 4), only(3), only(4), only(5))}),
    "mounted_elsewhere": (2, {"base_joint": SWAPPED}),
    "platform_end_elsewhere": (2, {"platform_joint": SWAPPED}),
    "encoder_counts_another": (2, {"encoder": (0, 1, 4, 3, 4, 5)}),
    "same_id": (2, {"answers_as": (0, 1, 4, 3, 4, 5)}),
    "encoder_sign": (1, {"scale": at_2(-1.0, 1.0)}),
    "encoder_scale": (1, {"scale": at_2(2.0, 1.0)}),
    "rate_sign": (1, {"rate_scale": at_2(-1.0, 1.0)}),
    "rate_scale": (1, {"rate_scale": at_2(2.0, 1.0)}),
    "force_one_way": (1, {"force_one_way": at_2(True, False)}),
    "force_saturates": (1, {"force_most": at_2(0.008, inf)}),
    "force_sign": (1, {"force_gain": at_2(-1.0, 1.0)}),
    "force_scale": (1, {"force_gain": at_2(0.5, 1.0)}),
    "wrong_lead": (1, {"scale": at_2(1.25, 1.0), "force_gain": at_2(1.25, 1.0)}),
    "drive_reversed": (1, {"scale": at_2(-1.0, 1.0), "force_gain": at_2(-1.0, 1.0)}),
    "encoder_frozen": (1, {"frozen": at_2(True, False)}),
    "encoder_jumps": (1, {"jump_m": at_2(6e-3, 0.0)}),
    "encoder_stops": (1, {"stops": at_2(True, False)}),
    "backlash": (1, {"play_m": at_2(5e-3, 0.0)}),
    "offset": (1, {"offset_m": at_2(4e-3, 0.0)}),
    "brake_stuck_shut": (1, {"stuck": at_2(1.0, None)}),
    "brake_stuck_open": (1, {"stuck": at_2(0.0, None)}),
    "brake_inverted": (1, {"brake_inverted": at_2(True, False)}),
    "brake_weak": (1, {"brake_share": at_2(0.01, 1.0)}),
    "friction": (1, {"friction": at_2(0.012, 0.0)}),
    "end_stop": (1, {"shorter": at_2(0.15, 0.0)}),
    "watchdog_missing": (1, {"watchdog": at_2(inf, 1.0)}),
    "watchdog_long": (1, {"watchdog": at_2(8.0, 1.0)}),
    "watchdog_short": (1, {"watchdog": at_2(0.3, 1.0)}),
    "absent": (1, {"present": at_2(False, True)}),
    "wrong_protocol": (1, {"other_protocol": at_2(True, False)}),
    "joint_elsewhere": (1, {"joint_off_m": at_2(0.03, 0.0)}),
    "wrong_home": (0, {"home_off_m": 0.015}),
    "payload": (0, {"payload": 2.0}),
    "upside_down": (0, {"gravity": -1.0}),
}
"""Name -> how many legs it names, and what it changes at leg 2, with 4 and 5 where more take part."""


def changed(wiring: Wiring) -> dict[str, Any]:
    """Return the fields that are not as they should be."""
    right = Wiring()
    pairs = ((f.name, getattr(wiring, f.name), getattr(right, f.name)) for f in fields(Wiring))
    return {name: there for name, there, should in pairs if there != should}


def test_each_mistake_changes_its_own_figures_at_its_legs_alone():
    assert set(EXPECTED) == set(MISTAKES)
    for name, (count, changes) in EXPECTED.items():
        assert legs_of(name) == count, name
        legs = (*(2, 4, 5)[:count], -1, -1, -1)[:3]
        assert changed(wired(Mistake(name, max(legs[0], 0), *legs[1:]))) == changes, name
    assert {"watchdog_missing", "watchdog_long", "watchdog_short"} == OF_WATCHDOG


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
def test_legs_that_do_not_exist_or_occur_twice_are_refused(name, legs):
    with pytest.raises(ValueError, match=r"different legs|unknown"):
        wired(Mistake(name, *legs))


def test_several_mistakes_multiply_or_follow_one_another():
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
