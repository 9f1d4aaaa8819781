"""First tick and largest difference of each column between two logs, for what-ifs and `--against`.

Pure functions over blocks of rows. `hil.loop.replay` compares a replay with its log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Flags, Rows
from drivers.tick_columns import Column
from hil.record.selection import name_of


class Place(NamedTuple):
    """One element of a column at one tick, with its value in both of the compared logs."""

    tick: int
    time_s: float
    """Time of the tick as given by the caller, s."""
    label: str
    """Label of the element, for example `tau.leg_3`."""
    unit: str
    one: int | float
    other: int | float

    def values(self, column: Column) -> tuple[str, str]:
        """Both values as text: as the name of an enumeration or flag value, else as a number."""
        return name_of(column, self.one), name_of(column, self.other)


@dataclass
class ColumnDivergence:
    """Differences of one column between two logs. Mutable state: all fields below the tolerances."""

    column: Column
    absolute: float = 0.0
    """Allowed difference in the unit of the column; inf: the column never diverges."""
    relative: float = 0.0
    """Allowed difference for each unit of max(1, |other|), in addition."""
    ticks: int = 0
    """Ticks with an element beyond the tolerance."""
    first: Place | None = None
    """First tick with an element beyond the tolerance, at its worst element."""
    largest: float = 0.0
    """Largest |one - other|, in the unit of the column; inf where one value is not a number."""
    at: Place | None = None
    """Place of the largest difference."""

    @property
    def diverges(self) -> bool:
        """True if the column differs by more than its tolerance in at least one tick."""
        return self.ticks > 0

    def take(self, one: Rows, other: Rows, time_s: Array) -> Flags:
        """Compare n rows with n rows: flags (n,) of the rows beyond the tolerance; time_s is (n,).

        Both arrays have this column; `one` also has `tick`.
        """
        column = self.column
        size = max(column.size, 1)
        a, b = (np.ascontiguousarray(rows[column.name]).reshape(len(rows), size) for rows in (one, other))
        if a.tobytes() == b.tobytes():
            return np.zeros(len(a), bool)
        difference = _difference(a, b)
        size_of_b = np.where(np.isfinite(b), np.maximum(1.0, np.abs(b.astype(np.float64))), 0.0)
        beyond = difference > self.absolute + self.relative * size_of_b

        def place(row: int, element: int) -> Place:
            values = a[row, element].item(), b[row, element].item()
            label, unit = column.labels[element], column.units[element]
            return Place(int(one["tick"][row]), float(time_s[row]), label, unit, *values)

        worst = int(difference.argmax())
        if difference.flat[worst] > self.largest:
            self.largest = float(difference.flat[worst])
            self.at = place(*divmod(worst, size))
        rows: Flags = np.any(beyond, axis=1)
        if rows.any():
            self.ticks += int(rows.sum())
            if self.first is None:
                row = int(rows.argmax())
                self.first = place(row, int(np.where(beyond[row], difference[row], -1.0).argmax()))
        return rows


class Divergence:
    """Differences of all columns between two logs. Mutable state: the result of each column.

    tolerances : by column name; other columns are exact. relative : tolerance of every other column of
    floats; inf: no other column can diverge.
    """

    def __init__(
        self, columns: Sequence[Column], tolerances: Mapping[str, float] | None = None, relative: float = 0.0
    ) -> None:
        given, others = tolerances or {}, np.inf if relative == np.inf else 0.0
        self.columns = []
        for c in columns:
            scaled = c.type is float and c.name not in given and not others
            absolute = given.get(c.name, others)
            self.columns.append(ColumnDivergence(c, absolute, relative if scaled else 0.0))

    def take(self, one: Rows, other: Rows, time_s: Array) -> Flags:
        """Compare rows (n,) of two logs tick by tick; flags (n,) of rows beyond a tolerance; time_s (n,)."""
        found: Flags = np.zeros(len(one), bool)
        for each in self.columns:
            found |= each.take(one, other, time_s)
        return found

    @property
    def diverging(self) -> list[ColumnDivergence]:
        """Columns that differ by more than their tolerance, earliest first, then in the order of the row."""
        found = [each for each in self.columns if each.diverges]
        return sorted(found, key=lambda each: each.first.tick if each.first else 0)

    @property
    def different(self) -> list[ColumnDivergence]:
        """Columns with any difference, even within their tolerance, in the order of the row."""
        return [each for each in self.columns if each.largest > 0.0]

    @property
    def first(self) -> list[ColumnDivergence]:
        """Columns beyond their tolerance at the earliest tick at which any column is."""
        ticks = [each.first.tick for each in self.diverging if each.first]
        return [each for each in self.diverging if each.first and each.first.tick == ticks[0]]


def _difference(a: Array, b: Array) -> Array:
    """Differences |a - b| of (n, m) values: 0 if equal or both nan, inf if only one is nan."""
    with np.errstate(invalid="ignore", over="ignore"):
        difference = np.abs(a.astype(np.float64) - b.astype(np.float64))
    if a.dtype.kind == "f":
        same = (a == b) | (np.isnan(a) & np.isnan(b))
    else:
        same = a == b
        difference = np.maximum(difference, 1.0)  # large integers may share one float64
    found: Array = np.where(same, 0.0, np.nan_to_num(difference, nan=np.inf, posinf=np.inf))
    return found
