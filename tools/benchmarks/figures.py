"""Results of the benchmark: figures, each with its limit (mark) and whether it meets the limit."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

FAILED, EARLY = "failed", "ended early"
"""Names of the figures that state why a part was not measured, or not to its end."""


class Mark(NamedTuple):
    """Limit for all values of a figure; it applies to two idle cores with SCHED_FIFO."""

    limit: float
    at_most: bool = True
    """True: an upper limit; False: a lower limit."""

    def __str__(self) -> str:
        return f"{'<=' if self.at_most else '>='} {self.limit:g}"


@dataclass(frozen=True)
class Figure:
    """One line of results: values of one quantity; without values the note states why."""

    name: str
    values: Mapping[str, float] = field(default_factory=dict)
    """Name of a value (median, p99, max; empty for a single value) -> value."""
    unit: str = ""
    mark: Mark | None = None
    note: str = ""

    @property
    def met(self) -> bool | None:
        """True if every value keeps the limit `mark`, which NaN never does; None without mark or values."""
        if self.mark is None or not self.values:
            return None
        limit, at_most = self.mark
        return all(value <= limit if at_most else value >= limit for value in self.values.values())

    def text(self) -> str:
        """Text of the values with their unit, to three digits."""
        parts = (f"{name} {_number(value)}".strip() for name, value in self.values.items())
        return f"{', '.join(parts)} {self.unit}".strip() if self.values else ""

    def remark(self) -> str:
        """Text of the limit `mark`, of whether it is met, and of the note."""
        outcome = {True: "met", False: "not met", None: "not measured"}[self.met]
        mark = "" if self.mark is None else f"mark {self.mark} {self.unit}".rstrip() + f": {outcome}"
        return "; ".join(filter(None, (mark, self.note)))

    def plain(self) -> dict[str, Any]:
        """Figure as plain values for a JSON file."""
        result: dict[str, Any] = {"name": self.name, "values": dict(self.values), "unit": self.unit}
        if self.mark is not None:
            result |= {"mark": str(self.mark), "met": self.met}
        return result | ({"note": self.note} if self.note else {})


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def spread(values: ArrayLike, *, largest: bool = False, scale: float = 1e-3) -> dict[str, float]:
    """Median, 99th percentile and, with `largest`, maximum of values times `scale` (default: ns to us)."""
    x = np.asarray(values, np.float64) * scale
    if not x.size:
        return {}
    median, p99 = np.percentile(x, [50, 99]).tolist()
    return {"median": median, "p99": p99} | ({"max": float(x.max())} if largest else {})


def lines(name: str, figures: list[Figure]) -> list[str]:
    """Lines of text about a benchmark part: its name, then one line for each figure, in columns."""
    first = max((len(f.name) for f in figures), default=0)
    second = max((len(f.text()) for f in figures), default=0)
    return [name, *(f"  {f.name:<{first}}  {f.text():<{second}}  {f.remark()}".rstrip() for f in figures)]
