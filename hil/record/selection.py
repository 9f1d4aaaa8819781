"""Selection of columns and their components, joined rows, and names of enumeration values."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from enum import IntFlag
from typing import NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.tick_columns import Column


class Component(NamedTuple):
    """One element of a log column, such as one leg's force, with its label and unit."""

    label: str
    """Name of the component, such as `tau.leg_3`."""
    unit: str
    column: Column
    element: int
    """Index of the element in the column, in row-major order."""

    def of(self, rows: Rows) -> np.ndarray[tuple[int], np.dtype[np.float64 | np.int64]]:
        """Values (n,) of this component in `rows` (n,), as a copy."""
        values = rows[self.column.name].reshape(len(rows), self.column.size)
        return np.ascontiguousarray(values[:, self.element])


def as_bytes(rows: Rows) -> Rows:
    """View rows as plain bytes, which NumPy copies faster than rows with columns."""
    return rows.view(f"V{rows.dtype.itemsize}")


def together(parts: Sequence[Rows]) -> Rows:
    """Concatenate one or more arrays of rows of equal dtype."""
    return np.concatenate(list(map(as_bytes, parts))).view(parts[0].dtype)


def components(columns: Sequence[Column], names: Sequence[str], log: str) -> list[Component]:
    """Components of the columns `names`, each a column or one of its components; all without names.

    log: file name for the message. Raises LogError: unknown column or component.
    """
    every = {
        c.name: [
            Component(label, unit, c, k)
            for k, (label, unit) in enumerate(zip(c.labels, c.units, strict=True))
        ]
        for c in columns
    }
    single = {component.label: [component] for parts in every.values() for component in parts}
    known = single | every
    found: list[Component] = []
    for name in names or every:
        if name not in known:
            raise LogError(f"{log}: {no_column(name, tuple(known))}")
        found += [component for component in known[name] if component not in found]
    return found


def name_of(column: Column, value: float) -> str:
    """Value of a column as text, by its name if the column has names.

    Flags are joined by `|`, NONE without any; a value without a name stays a number.
    """
    if not column.names:
        return repr(value)
    number = int(value)
    if not issubclass(column.type, IntFlag):
        return next((name for name, each in column.names.items() if each == number), str(number))
    found = [name for name, bit in column.names.items() if bit and number & bit == bit]
    rest = number & ~sum(column.names.values())
    return "|".join(found + ([str(rest)] if rest else [])) or "NONE"


def no_column(name: str, known: Sequence[str]) -> str:
    """Text that states that column `name` is unknown, with similar known names."""
    near = get_close_matches(name, known, n=3)
    return f"no column {name!r}; " + (
        f"did you mean {', '.join(near)}?" if near else f"there are {', '.join(known[:8])} ..."
    )
