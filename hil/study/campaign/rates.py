"""How often runs pass: Wilson's interval, over all rows and by each value of an axis."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.study.campaign.figures import METRICS
from hil.study.campaign.parquet import Column, Row, cell, kind
from hil.study.campaign.settings import Limit, ListedAxis, entries

BINS = 4
"""Of an axis with more values than MOST: equally many rows in each."""
MOST = 12


class Rate(NamedTuple):
    """Of some rows: how many there are and pass, and the 95 % interval of the share that passes."""

    label: str
    rows: int
    passed: int
    low: float
    high: float


def wilson(passed: int, n: int) -> tuple[float, float]:
    """95 % score interval of a share (Wilson 1927, J. Am. Stat. Assoc. 22, 209); (0, 1) of none.

    Rows are taken as independent draws: points of a low-discrepancy sequence usually scatter less.
    """
    from scipy.stats import binomtest  # noqa: PLC0415 - most of a second

    if not n:
        return 0.0, 1.0
    low, high = binomtest(passed, n).proportion_ci(0.95, "wilson")
    return float(low), float(high)


def rate(label: str, rows: Sequence[Row]) -> Rate:
    """Return how many of some rows pass."""
    passed = sum(row["passed"] for row in rows)
    return Rate(label, len(rows), passed, *wilson(passed, len(rows)))


def by_value(name: str, axis: ListedAxis, rows: Sequence[Row]) -> list[Rate]:
    """Return the rate of each value of an axis, of many numbers that of each quarter of the rows by value."""
    there = {row[name] for row in rows}
    numbers = all(isinstance(value, int | float) for value in there)
    if not numbers or len(there) <= MOST:
        listed = [cell(Column(name, kind(axis), "", ""), value) for value in entries(axis)]
        # once each: in a list of axes that go together a value may stand in several rows
        ordered = [value for value in dict.fromkeys(listed) if value in there] or sorted(there)
        return [rate(shown(value), [row for row in rows if row[name] == value]) for value in ordered]
    ordered_rows = sorted(rows, key=lambda row: (row[name], row["row"]))
    found = []
    for part in np.array_split(np.arange(len(rows)), BINS):
        some = [ordered_rows[k] for k in part]
        found.append(rate(f"{shown(some[0][name])} to {shown(some[-1][name])}", some))
    return found


def worst(rows: Sequence[Row], limits: dict[str, Limit], most: int) -> list[Row]:
    """Return failed rows, the worst of each cause first, then the second of each.

    Of a cause those that ended first are the worst, then those that pass a limit by most.
    """

    def badness(row: Row) -> tuple[bool, float, float, int]:
        early = row["ended"] != "complete"
        return (not early, row["ended_s"] or 0.0 if early else 0.0, -_excess(row, limits), row["row"])

    failed = sorted((row for row in rows if not row["passed"]), key=badness)
    seen: Counter[str] = Counter()
    ranked = []
    for row in failed:
        ranked.append((seen[cause(row)], row))
        seen[cause(row)] += 1
    return [row for _, row in sorted(ranked, key=lambda each: each[0])][:most]


def cause(row: Row) -> str:
    """Return how a failed row ended, with the names of its faults."""
    return "limit" if row["ended"] == "complete" else f"{row['ended']} {row['faults']}".strip()


def causes(rows: Sequence[Row]) -> list[tuple[str, int]]:
    """Return how many rows have failed of each cause, the most frequent first."""
    return Counter(cause(row) for row in rows if not row["passed"]).most_common()


def why(row: Row, limits: dict[str, Limit]) -> str:
    """Say in words why a row has failed."""
    words = [] if row["ended"] == "complete" else [row["ended"]]
    if row["trouble"]:
        words = [f"{row['ended']}: {row['trouble'].partition(chr(10))[0]}"]
    for name, limit in limits.items():
        value = row[name]
        if value is None or (name == "faulted" and row["ended"] == "fault"):
            continue
        if limit.max is not None and not value <= limit.max:
            words.append(f"{name} {value:.6g}, allowed: at most {limit.max:g}")
        if limit.min is not None and not value >= limit.min:
            words.append(f"{name} {value:.6g}, allowed: at least {limit.min:g}")
    return "; ".join(words) or "not measured: " + ", ".join(n for n in limits if row[n] is None)


def shown(value: Any) -> str:
    """Return a value of an axis in four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def judged(limits: dict[str, Limit]) -> list[str]:
    """Return the metrics with a limit, in the order of the table."""
    return [name for name in METRICS if name in limits]


def _excess(row: Row, limits: dict[str, Limit]) -> float:
    """Return by what share of it the most broken limit is passed."""
    found = [0.0]
    for name, limit in limits.items():
        value = row[name]
        if value is not None and limit.max is not None and value > limit.max:
            found.append((value - limit.max) / abs(limit.max or 1.0))
        if value is not None and limit.min is not None and value < limit.min:
            found.append((limit.min - value) / abs(limit.min or 1.0))
    return max(found)
