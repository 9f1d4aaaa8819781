"""Pass rates of a campaign with Wilson's interval: over all rows, and by each value of an axis."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.study.campaign.parquet import Row, cell, kind
from hil.study.campaign.settings import Limit, ListedAxis

BINS = 4
"""Bins of a numeric axis with more values than MOST; each has equally many rows."""
MOST = 12
HEAD = ("value", "rows", "failed", "pass %", "95 % interval")
"""Titles of `Rate.cells`."""


class Rate(NamedTuple):
    """Pass rate of some rows: number of rows and of passed rows, and the 95 % interval."""

    label: str
    rows: int
    passed: int
    low: float
    high: float

    @property
    def cells(self) -> tuple[str, ...]:
        """Cells of a table line of this pass rate; `HEAD` has the column titles."""
        percent = f"{100.0 * self.passed / self.rows:.1f}"
        interval = f"{100.0 * self.low:.1f} to {100.0 * self.high:.1f}"
        return self.label, str(self.rows), str(self.rows - self.passed), percent, interval


def rate(label: str, rows: Sequence[Row]) -> Rate:
    """Pass rate of at least one row, and its score interval (Wilson 1927, J. Am. Stat. Assoc. 22, 209).

    It assumes independent draws; points of a low-discrepancy sequence usually scatter less.
    """
    from scipy.stats import binomtest  # noqa: PLC0415 - most of a second

    passed = sum(row["passed"] for row in rows)
    low, high = binomtest(passed, len(rows)).proportion_ci(0.95, "wilson")
    return Rate(label, len(rows), passed, float(low), float(high))


def by_value(name: str, axis: ListedAxis, rows: Sequence[Row]) -> list[Rate]:
    """Pass rate of each value of an axis; for more than MOST numbers, of each quarter of the sorted rows."""
    there = {row[name] for row in rows}
    if len(there) <= MOST or not all(isinstance(value, int | float) for value in there):
        listed = [cell(kind(axis), value) for value in axis.entries]
        # once each: with axes that vary together a value may occur in several rows
        ordered = [value for value in dict.fromkeys(listed) if value in there] or sorted(there)
        return [rate(shown(value), [row for row in rows if row[name] == value]) for value in ordered]
    ordered_rows = sorted(rows, key=lambda row: (row[name], row["row"]))
    parts = [[ordered_rows[k] for k in part] for part in np.array_split(np.arange(len(rows)), BINS)]
    return [rate(f"{shown(part[0][name])} to {shown(part[-1][name])}", part) for part in parts]


def worst(rows: Sequence[Row], limits: dict[str, Limit], most: int) -> list[Row]:
    """At most `most` failed rows: the worst row of each cause first, then the second of each cause.

    Within a cause, rows that ended first are the worst, then rows that exceed a limit by most.
    """

    def badness(row: Row) -> tuple[bool, float, float, int]:
        early = row["ended"] != "complete"
        excess = max((limit.passed_by(row[name]) for name, limit in limits.items()), default=0.0)
        return not early, (row["ended_s"] or 0.0) if early else 0.0, -excess, row["row"]

    seen: Counter[str] = Counter()
    ranked = []
    for row in sorted((row for row in rows if not row["passed"]), key=badness):
        ranked.append((seen[cause(row)], row))
        seen[cause(row)] += 1
    return [row for _, row in sorted(ranked, key=lambda each: each[0])][:most]


def cause(row: Row) -> str:
    """Cause of a failed row: `limit`, or how its run ended and the names of its faults."""
    return "limit" if row["ended"] == "complete" else f"{row['ended']} {row['faults']}".strip()


def causes(rows: Sequence[Row]) -> list[tuple[str, int]]:
    """Number of failed rows by cause, the most frequent cause first."""
    return Counter(cause(row) for row in rows if not row["passed"]).most_common()


def why(row: Row, limits: dict[str, Limit]) -> str:
    """Reasons why a row failed, as text with values and limits."""
    ended = ": ".join(filter(None, (row["ended"], row["trouble"].partition("\n")[0])))
    words = [] if ended == "complete" else [ended]
    for name, limit in limits.items():
        measured = row[name] is not None and not (name == "faulted" and row["ended"] == "fault")
        if measured and limit.passed_by(row[name]):
            words.append(f"{name} {row[name]:.6g}, allowed: {limit.words}")
    return "; ".join(words) or "not measured: " + ", ".join(n for n in limits if row[n] is None)


def shown(value: Any) -> str:
    """Value of an axis as text; floats with four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
