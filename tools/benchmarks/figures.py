"""What the benchmark gives: figures, the mark beside each, and whether it is met."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

FAILED, EARLY = "failed", "ended early"
"""Names of the lines that say why a part was not measured, or not to its end."""


class Mark(NamedTuple):
    """What a figure is to be, on two cores with SCHED_FIFO."""

    limit: float
    at_most: bool = True
    """Else at least."""
    of: tuple[str, ...] = ()
    """Names of the values that count; empty is all."""

    def holds(self, value: float) -> bool:
        """Say whether a value meets the mark; NaN does not."""
        return value <= self.limit if self.at_most else value >= self.limit

    def __str__(self) -> str:
        return f"{'<=' if self.at_most else '>='} {self.limit:g}"


@dataclass(frozen=True)
class Figure:
    """One line: a value, or several of one quantity; without values the note says why."""

    name: str
    values: Mapping[str, float] = field(default_factory=dict)
    """Name of a value (median, p99, max; empty where there is one) -> value."""
    unit: str = ""
    mark: Mark | None = None
    note: str = ""

    @property
    def outcomes(self) -> dict[str, bool]:
        """Whether the mark is met, by each value that counts; empty without a mark or without values."""
        mark = self.mark
        if mark is None:
            return {}
        return {k: mark.holds(v) for k, v in self.values.items() if not mark.of or k in mark.of}

    @property
    def met(self) -> bool | None:
        """Whether every value that counts meets the mark; None without a mark or without values."""
        outcomes = self.outcomes
        return all(outcomes.values()) if outcomes else None

    def outcome(self) -> str:
        """Return `met`, `not met`, or which values meet the mark; `not measured` where there are none."""
        outcomes = self.outcomes
        if self.mark is None:
            return ""
        if not outcomes:
            return "not measured"
        if len(set(outcomes.values())) == 1:
            return "met" if self.met else "not met"
        return ", ".join(f"{name} {'met' if good else 'not met'}" for name, good in outcomes.items())

    def text(self) -> str:
        """Return the values with their unit."""
        parts = (f"{name} {number(value)}".strip() for name, value in self.values.items())
        return f"{', '.join(parts)} {self.unit}".strip() if self.values else ""

    def plain(self) -> dict[str, Any]:
        """Return this for a JSON file."""
        result: dict[str, Any] = {"name": self.name, "values": dict(self.values), "unit": self.unit}
        if self.mark is not None:
            result |= {"mark": str(self.mark), "met": self.met}
        return result | ({"note": self.note} if self.note else {})


def number(value: float) -> str:
    """Return three significant digits, without an exponent where one is not needed."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def spread(values: ArrayLike, *, largest: bool = False, scale: float = 1e-3) -> dict[str, float]:
    """Return median and p99, and the maximum if asked for; the scale turns ns into us."""
    x = np.asarray(values, np.float64) * scale
    if not x.size:
        return {}
    median, p99 = np.percentile(x, [50, 99]).tolist()
    return {"median": median, "p99": p99} | ({"max": float(x.max())} if largest else {})


def lines(name: str, figures: list[Figure]) -> list[str]:
    """Return a part as text: its name, then one line for each figure, with columns under each other."""
    first = max((len(f.name) for f in figures), default=0)
    second = max((len(f.text()) for f in figures), default=0)
    result = [name]
    for f in figures:
        mark = "" if f.mark is None else f"mark {f.mark} {f.unit}".rstrip() + f": {f.outcome()}"
        tail = "; ".join(filter(None, (mark, f.note)))
        result.append(f"  {f.name:<{first}}  {f.text():<{second}}  {tail}".rstrip())
    return result
