"""When a run was in which mode, and when which fault or warning was there."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.tick_columns import COLUMNS

FLAGS = ("faults", "warnings", "foreign", "setpoint_refusal")
"""Columns whose bits have a row each, where they are ever set."""


class Lane(NamedTuple):
    """One bit over time."""

    label: str
    """Column and bit."""
    values: Array
    """(n,) 0 or 1."""
    ticks: int
    """In how many it was set."""
    first: int
    """Row in which it was set first."""


def spells(values: Array) -> list[tuple[int, int, int]]:
    """Return the spells of equal values (n,): value, first row, row behind the last."""
    if not len(values):
        return []
    edges = np.flatnonzero(np.diff(values)) + 1
    starts, ends = np.concatenate(([0], edges)), np.concatenate((edges, [len(values)]))
    return [(int(values[a]), a, b) for a, b in zip(starts.tolist(), ends.tolist(), strict=True)]


def lanes(rows: Rows) -> list[Lane]:
    """Return a lane for each bit of FLAGS that is ever set, in the order of the table."""
    found = []
    for name in FLAGS:
        column = rows[name]
        for text, bit in COLUMNS[name].names.items():
            there = (column & bit) != 0
            if bit and there.any():
                values = there.astype(np.float64)
                found.append(Lane(f"{name} {text}", values, int(there.sum()), int(np.argmax(there))))
    return found
