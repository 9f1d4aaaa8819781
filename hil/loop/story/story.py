"""Evidence of a fault, and the report of a run's faults (`Story`): as text, and as plain values."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import isfinite
from typing import Any, NamedTuple

from drivers.signals import NEVER, DriveState, Mode
from drivers.tick_columns import Record
from hil.loop.cycle import Cycle
from hil.loop.report import because

GLOSSARY = "docs/guides/glossary-of-faults.md"
"""Page with a section for each Fault, Warn and Stop."""


class Moment(NamedTuple):
    """The tick in which a fault struck, with the cycle and the tick before."""

    cycle: Cycle
    before: Record
    """Record of the tick before the fault."""
    mode: Mode
    """Mode in the tick before the fault."""
    elapsed_s: float
    """Time since that mode was entered, s."""

    @property
    def tick(self) -> Record:
        """Record of the tick in which the fault struck."""
        return self.cycle.tick

    def limit(self, name: str) -> Any:
        """A limit of the safety checks, by its name in their record."""
        return self.cycle.parts.safety.limits[name].item()

    def memory(self, name: str) -> int:
        """A field of the safety checks' memory, as an integer of bits."""
        return int(self.cycle.parts.safety.memory[name])

    def legs(self, column: str) -> list[Any]:
        """A column of the tick as a list, one element per leg."""
        values: list[Any] = self.tick[column].tolist()
        return values


class Evidence(NamedTuple):
    """Evidence of a fault in a tick: value and limit at one leg, or for the whole platform."""

    value: float | str | None = None
    limit: float | str | None = None
    leg: int | None = None
    """Leg (0..5) that the evidence is about; None: the whole platform, or unknown."""
    sentence: str = ""
    """Text format that replaces that of the fault's row; empty: none."""
    unit: str = ""
    """Unit of value and limit, SI."""
    key: str = ""
    """Configuration key of the limit; empty for a constant."""

    def text(self, sentence: str) -> str:
        """The evidence as one line; `sentence`: format of the fault's row, unless it has its own."""
        numbers = {"mm": self.value, "mm_limit": self.limit}
        thousandths = {name: 1e3 * each for name, each in numbers.items() if isinstance(each, float)}
        return (self.sentence or sentence).format(**self._asdict(), **thousandths)


class Finding(NamedTuple):
    """One line of a fault report: fault, time, value, limit and advice, for a leg or the platform."""

    fault: str
    """Name of the fault's bit."""
    tick: int
    time_s: float
    """Time since the start of the run, s."""
    mode: str
    """Name of the mode before the fault."""
    leg: int | None
    value: float | str | None
    limit: float | str | None
    unit: str
    limit_key: str
    """Configuration key of the limit; empty for a constant."""
    text: str
    """One line, with the numbers of the tick."""
    next: str
    """Advice to the user."""

    @property
    def place(self) -> str:
        """Fault name, time in the run and mode, as text."""
        return f"fault {self.fault} at {self.time_s:.3f} s (tick {self.tick}) in {self.mode}"

    @property
    def line(self) -> str:
        """Fault name, time, mode and evidence in one line."""
        return f"{self.place}: {self.text}" if self.text else self.place

    @property
    def page(self) -> str:
        """Page and anchor of the glossary entry for this fault."""
        return f"{GLOSSARY}#fault-{self.fault.lower()}"

    def fields(self) -> dict[str, Any]:
        """All fields of the finding as JSON values: null, text, or a finite number."""
        odd = {k: str(x) for k, x in self._asdict().items() if isinstance(x, float) and not isfinite(x)}
        return self._asdict() | odd | {"page": self.page}


DONE = {
    Mode.WAITING: "the faults were cleared on request",
    Mode.IDLE: "the brakes stayed closed",
    Mode.LOADING: "the brakes stayed closed while the force was built up",
    Mode.RELEASING: "the brakes were commanded to open",
    Mode.APPROACH: "the move to the start of the reference went on",
    Mode.TRACKING: "the motion along the reference went on",
    Mode.STOPPING: "a controlled stop along the reference began",
    Mode.PARKING: "the brakes were commanded to close, while the law held the platform",
    Mode.UNLOADING: "the closed brakes took over the platform, while the legs had to stand still",
    Mode.PARKED: "the drives were commanded to switch off",
    Mode.FAULT: "the drives were commanded to switch off",
    Mode.HELD: "the brakes were commanded to close and the force held the platform: not all are proven shut",
}
"""Reaction to a fault, by the mode that was entered."""
WITHOUT_FORCE = {
    Mode.LOADING: "the brakes stayed closed: these drives give no force on them",
    Mode.PARKING: "the drives were commanded to close their brakes, on which they give no force",
    Mode.UNLOADING: "the closed brakes carried the platform, while the legs had to stand still",
    Mode.HELD: "the drives were commanded to close their brakes, on which they give no force: nothing else "
    "holds the platform, and not all brakes are proven shut",
}
"""Reactions of drives that give no force on closed brakes."""
PLANT_PAGE = "docs/guides/own-fmu.md"
"""Page on the requirements for a plant."""
HELD_NEXT = "support the platform, then release it with `hil run CONFIG --release`"
HELD_PAGE = "docs/guides/real-drives.md#held-until-the-brakes-are-proven"
"""Page on brakes that are not proven shut."""
NUMBER = re.compile(r"^[-+]?\d+(\.\d+)?(e[-+]?\d+)?$")
_POWERED = (DriveState.READY.name, DriveState.RUN.name)


class DriveReport(NamedTuple):
    """Last state report of a drive, and its age in ticks."""

    leg: int
    state: str
    """Name of a DriveState."""
    fault: int
    age: int
    """Ticks since its last frame."""
    meaning: str = ""
    """Meaning of its maker's fault code; empty if unknown."""

    @property
    def powered(self) -> bool:
        """True if the drive was in READY or RUN at its last report."""
        return self.state in _POWERED

    @property
    def text(self) -> str:
        """Drive state, fault and age of the report, as text."""
        if self.age >= NEVER:
            return "no report received"
        silent = f" in its last report, {self.age} ticks ago" if self.age else ""
        return f"{self.state}{because(self.fault, self.meaning)}{silent}"


class Step(NamedTuple):
    """One step of the reaction to a fault: a mode that was entered, or a stop that was sent."""

    tick: int
    time_s: float
    mode: str
    """Name of the mode that was entered; ESTOP for the stop frame, PLANT for a plant failure."""
    text: str


@dataclass(frozen=True)
class Story:
    """The report of a run's faults: findings, the drives' states, the reaction, and what to do next."""

    findings: tuple[Finding, ...]
    """In the order in which the faults struck; of those in one tick, causes first."""
    drives: tuple[DriveReport, ...]
    """Reports in the tick of the first fault."""
    done: tuple[Step, ...]
    drives_at_end: tuple[DriveReport, ...]
    at_end: str
    """Legs that still move in the end, as text."""
    plant: str = ""
    """Reason why the plant of a simulation failed; empty if it did not."""

    @property
    def short(self) -> str:
        """The faults and their evidence, in one line."""
        return short(self.findings)

    @property
    def done_text(self) -> str:
        """The reactions to the faults, in one line."""
        return "; ".join(step.text for step in self.done)

    def fields(self) -> dict[str, Any]:
        """The fault report as JSON values."""
        return {
            "text": self.short,
            "plant": self.plant or None,
            "findings": [each.fields() for each in self.findings],
            "drives": [each._asdict() for each in self.drives],
            "done": [each._asdict() for each in self.done],
            "drives_at_end": [each._asdict() for each in self.drives_at_end],
            "at_end": self.at_end,
            "lines": self.lines(),
        }

    def lines(self) -> list[str]:
        """The fault report as text, one statement per line."""
        lines = [f"plant: {self.plant}"] if self.plant else []
        lines += [f"{each.place}: {text}" if text else each.place for each, text in _merged(self.findings)]
        lines.append(f"drives: {_grouped(self.drives)}")
        lines += [f"done: {step.text} ({step.time_s:.3f} s)" for step in self.done]
        lines.append(f"in the end: {_grouped(self.drives_at_end)}; {self.at_end}")
        lines += [f"next: {advice} ({page})" for advice, page in self.next.items()]
        return lines

    @property
    def next(self) -> dict[str, str]:
        """Advice to the user -> documentation page about it."""
        modes = [step.mode for step in self.done if step.mode in Mode.__members__]
        advice = {HELD_NEXT: HELD_PAGE} if modes[-1:] == [Mode.HELD.name] else {}
        if self.plant:
            advice["fix the plant: see its own message above"] = PLANT_PAGE
        advice |= {each.next or "see the glossary": each.page for each in self.findings}
        return advice


def short(findings: Sequence[Finding]) -> str:
    """Faults and their evidence in one line; empty without any."""
    if not findings:
        return ""
    names = ", ".join(dict.fromkeys(each.fault for each in findings))
    texts = "; ".join(text for _, text in _merged(findings) if text)
    return f"latched fault {names}" + (f" ({texts})" if texts else "")


def listed(legs: Sequence[int]) -> str:
    """Leg numbers as text, separated by commas."""
    return ", ".join(map(str, legs))


def _merged(findings: Sequence[Finding]) -> Iterator[tuple[Finding, str]]:
    """Findings with their texts; neighbours that differ only in leg and numbers are merged."""

    def alike(each: Finding) -> tuple[Any, ...]:
        words = tuple(NUMBER.sub("#", word) for word in each.text.split(" "))
        return each.fault, each.tick, words

    for _, group in groupby(findings, alike):
        first, *others = group
        columns = zip(*(each.text.split(" ") for each in (first, *others)), strict=True)
        yield first, " ".join(w[0] if len(set(w)) == 1 else ", ".join(w) for w in columns)


def _grouped(drives: Sequence[DriveReport]) -> str:
    """Text of the drives' reports; equal reports are grouped."""
    texts: dict[str, list[int]] = {}
    for each in drives:
        texts.setdefault(each.text, []).append(each.leg)
    if len(texts) == 1:
        return f"all {next(iter(texts))}"
    return "; ".join(f"{listed(legs)} {text}" for text, legs in texts.items())
