"""What the live page is told of a row, and what it is told when another run begins or cannot be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.signals import NEVER, DriveFault
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.app.run_description import run_description
from hil.app.watch.state import state
from hil.record.mirror import FIGURES, Piece

ABOUT = run_description(load("virtual"), Path("runs/x.mcap"), 1000.0, 20.0)
SHORTEST, LONGEST, SILENT = 0.75, 2.2, 5
"""m, the ends of the stroke, and the ticks from which a leg is silent, in configs/virtual.yaml."""


def legs_of(**columns):
    """Return what is shown of the legs of a row."""
    row = np.zeros((), ROW)
    for name, value in columns.items():
        row[name] = value
    there: Any = row[()]
    figures: Any = np.zeros((), FIGURES)[()]
    return state(Piece(1, there, figures, []), ABOUT, 0)["legs"]


def test_the_margin_of_a_leg_is_the_way_to_the_nearer_of_its_two_ends():
    low, high = SHORTEST + 0.01, LONGEST - 0.02
    found = legs_of(q=[low, high, 0.5 * (SHORTEST + LONGEST), SHORTEST - 0.003, LONGEST + 0.004, high])
    assert found["margin"] == pytest.approx([10.0, 20.0, 725.0, -3.0, -4.0, 20.0], abs=0.01)


def test_a_leg_is_marked_silent_from_the_tick_of_the_fault_on():
    found = legs_of(age=[0, SILENT - 1, SILENT, SILENT + 1, NEVER - 1, NEVER])
    assert found["marked"] == ["", "", "silent", "silent", "silent", ""]


@pytest.mark.parametrize("leg", range(6))
def test_the_mark_of_each_leg_says_all_that_is_wrong_with_it(leg):
    age, fault = np.zeros(6, int), np.zeros(6, int)
    age[leg], fault[leg] = 200, DriveFault.OVERFORCE
    found = legs_of(
        age=age, drive_fault=fault, legs_doubted=1 << leg, legs_moved=1 << leg, legs_refused=1 << leg
    )["marked"]
    said = set(found.pop(leg).split(", "))
    assert said == {"encoder doubted", "moved on its brake", "drive refuses", "silent", "overforce"}
    assert found == [""] * 5
