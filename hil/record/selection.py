"""Components of columns, rows behind each other, and what the numbers in them are called."""

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
    """One element of a log column, which a table shows as a column."""

    label: str
    """`tau.leg_3`."""
    unit: str
    column: Column
    element: int
    """Its place in the column, row by row."""

    def of(self, rows: Rows) -> np.ndarray[tuple[int], np.dtype[np.float64 | np.int64]]:
        """Return its values (n,) in rows; those of the other elements are not kept with them."""
        values = rows[self.column.name].reshape(len(rows), self.column.size)
        return np.ascontiguousarray(values[:, self.element])


def as_bytes(rows: Rows) -> Rows:
    """Return the same rows without their columns: NumPy copies with columns one by one."""
    return rows.view(f"V{rows.dtype.itemsize}")


def together(parts: Sequence[Rows]) -> Rows:
    """Return parts of one type, at least one, behind each other."""
    return np.concatenate(list(map(as_bytes, parts))).view(parts[0].dtype)


def components(columns: Sequence[Column], names: Sequence[str], log: str) -> list[Component]:
    """Return the components of columns that are named, whole columns among them; all without a name.

    Raises LogError: no such column or component; `log` is named in the message.
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
    """Text of a value of a column, by its name where the column has names.

    Flags are joined by `|`, with `NONE` where none is set; what has no name stands as a number.
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
    """Say that there is no such column, and which ones were perhaps meant."""
    near = get_close_matches(name, known, n=3)
    return f"no column {name!r}; " + (
        f"did you mean {', '.join(near)}?" if near else f"there are {', '.join(known[:8])} ..."
    )
