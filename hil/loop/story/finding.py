"""What a row of the table of faults is made of, and what it makes of a tick."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

from drivers.signals import Fault, Mode
from drivers.tick_columns import Record
from hil.loop.cycle import Cycle

GLOSSARY = "docs/guides/glossary-of-faults.md"
"""A section for each Fault, Warn and Stop."""


class Moment(NamedTuple):
    """The tick in which a fault struck."""

    cycle: Cycle
    before: Record
    """The tick before."""
    mode: Mode
    """That of the tick before."""
    elapsed_s: float
    """Since that mode was entered."""

    @property
    def tick(self) -> Record:
        """The tick itself."""
        return self.cycle.tick

    def limit(self, name: str) -> Any:
        """Return a limit of safety: int or float."""
        return self.cycle.parts.safety.limits[name].item()

    def legs(self, column: str) -> list[Any]:
        """Return a column of the tick, one element a leg."""
        values: list[Any] = self.tick[column].tolist()
        return values


class Seen(NamedTuple):
    """What a tick shows of a fault, at one leg or as a whole."""

    value: float | str | None = None
    limit: float | str | None = None
    leg: int | None = None
    """Which leg, where it can be told."""
    sentence: str = ""
    """In the place of the row's."""
    unit: str = ""
    """Of both, SI."""
    key: str = ""
    """Where the configuration has the limit; empty where it is a constant."""


class FaultRow(NamedTuple):
    """One fault."""

    fault: Fault
    sentence: str
    """Format of one line with leg, value, limit, key, and mm, mm_limit: both in thousandths."""
    look: Callable[[Moment], Iterable[Seen]]
    """Return what the tick of the fault shows of it; nothing where that is not known any more."""
    mend: str
    """What to do next."""


@dataclass(frozen=True)
class Finding:
    """What is told of a fault, at one leg or as a whole."""

    fault: str
    """Name of the bit."""
    tick: int
    time_s: float
    """Of the run."""
    mode: str
    """Name of the mode until then."""
    seen: Seen
    text: str
    """One line, with the numbers of the tick."""
    mend: str

    @property
    def place(self) -> str:
        """Its name, when and in which mode."""
        return f"fault {self.fault} at {self.time_s:.3f} s (tick {self.tick}) in {self.mode}"

    @property
    def line(self) -> str:
        """All of it in one line."""
        return f"{self.place}: {self.text}" if self.text else self.place

    @property
    def page(self) -> str:
        """Where the glossary explains it."""
        return f"{GLOSSARY}#fault-{self.fault.lower()}"

    def fields(self) -> dict[str, Any]:
        """Return it as plain values: null, text, or a finite number."""
        seen = self.seen
        return {
            "fault": self.fault, "tick": self.tick, "time_s": self.time_s, "mode": self.mode,
            "leg": seen.leg, "value": _plain(seen.value), "limit": _plain(seen.limit), "unit": seen.unit,
            "limit_key": seen.key, "text": self.text, "next": self.mend, "page": self.page,
        }  # fmt: skip


def sentence_of(row: FaultRow, seen: Seen) -> str:
    """Return the line of what was seen."""
    thousandths = {
        name: 1e3 * number
        for name, number in (("mm", seen.value), ("mm_limit", seen.limit))
        if isinstance(number, float)
    }
    words = {"leg": seen.leg, "value": seen.value, "limit": seen.limit, "key": seen.key}
    return (seen.sentence or row.sentence).format(**words, **thousandths)


def _plain(value: float | str | None) -> float | str | None:
    return value if not isinstance(value, float) or isfinite(value) else str(value)
