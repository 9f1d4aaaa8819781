"""Columns of a log by name: values, unit and names of values, from the table that the log carries."""

from collections.abc import Iterable, Sequence
from enum import IntFlag
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.errors import LogError
from drivers.tick_columns import Column

DIFFERENCE = " - "
"""Between two names: the one less the other."""


class Signal(NamedTuple):
    """One number over time."""

    label: str
    """Column, with the element where it has several."""
    unit: str
    """Empty for what has none."""
    values: Array
    """(n,), one a row."""
    names: dict[str, int]
    """Of the values; empty where they have none."""
    flags: bool
    """The names are of bits, of which a value may have several."""


def signals(columns: Sequence[Column], rows: Rows, name: str) -> list[Signal]:
    """Return what a name stands for: `column`, `column.element`, or `one - other` of two alike.

    rows has the dtype of the log. A column of several elements gives one signal each.

    Raises
    ------
    LogError
        No such column or element, or a difference of what is not alike.

    """
    if DIFFERENCE not in name:
        return _of(columns, rows, name.strip())
    left, _, right = name.partition(DIFFERENCE)
    pair = _of(columns, rows, left.strip()), _of(columns, rows, right.strip())
    kinds = [[(s.unit, bool(s.names)) for s in side] for side in pair]
    if kinds[0] != kinds[1] or kinds[0][0][1]:
        raise LogError(
            f"{name}: no difference can be made: allowed are two columns of one shape and one unit"
        )
    with np.errstate(invalid="ignore", over="ignore"):
        return [
            a._replace(label=f"{a.label}{DIFFERENCE}{b.label}", values=a.values - b.values)
            for a, b in zip(*pair, strict=True)
        ]


def _of(columns: Sequence[Column], rows: Rows, name: str) -> list[Signal]:
    head, _, element = name.partition(".")
    column = next((c for c in columns if c.name == head), None)
    if column is None:
        near = [c.name for c in columns if head and (head in c.name or c.name in head)]
        allowed = ", ".join(near or [c.name for c in columns])
        raise LogError(f"column {head!r}: there is none of that name, allowed: {allowed}")
    parts = column.elements or tuple(map(str, range(column.size))) * bool(column.shape)
    values = np.asarray(rows[column.name], np.float64).reshape(len(rows), max(len(parts), 1))
    names, flags = column.names, issubclass(column.type, IntFlag)
    if not parts:
        if element:
            raise LogError(f"column {name!r}: {head} is one number, allowed: {head!r}")
        return [Signal(head, column.unit, values[:, 0], names, flags)]
    if element and element not in parts:
        raise LogError(f"column {name!r}: {head} has no element {element!r}, allowed: {', '.join(parts)}")
    return [
        Signal(f"{head}.{part}", column.units[k], values[:, k], names, flags)
        for k, part in enumerate(parts)
        if element in ("", part)
    ]


def named_columns(names: Iterable[str]) -> set[str]:
    """Return the columns that names as `signals` takes them stand for."""
    sides = (side for name in names for side in name.split(DIFFERENCE))
    return {side.strip().partition(".")[0] for side in sides}


def seconds(rows: Rows) -> Array:
    """Return the time of each row (n,) in s since the first."""
    return np.asarray((rows["t_ns"] - rows["t_ns"][:1]) * 1e-9, np.float64)
