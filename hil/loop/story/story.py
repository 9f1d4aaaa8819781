"""Evidence of a fault in its tick, and the story of a run's faults: in words, and as plain values."""

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
    """The tick in which a fault struck."""

    cycle: Cycle
    before: Record
    """The tick before."""
    mode: Mode
    """Mode of the tick before."""
    elapsed_s: float
    """Time since that mode was entered."""

    @property
    def tick(self) -> Record:
        """The tick itself."""
        return self.cycle.tick

    def limit(self, name: str) -> Any:
        """A limit of safety, int or float."""
        return self.cycle.parts.safety.limits[name].item()

    def memory(self, name: str) -> int:
        """A field of safety's memory, as bits."""
        return int(self.cycle.parts.safety.memory[name])

    def legs(self, column: str) -> list[Any]:
        """A column of the tick, one element per leg."""
        values: list[Any] = self.tick[column].tolist()
        return values


class Evidence(NamedTuple):
    """Evidence of a fault in a tick, at one leg or as a whole."""

    value: float | str | None = None
    limit: float | str | None = None
    leg: int | None = None
    """The leg, if known."""
    sentence: str = ""
    """Replaces the row's sentence."""
    unit: str = ""
    """Unit of value and limit, SI."""
    key: str = ""
    """Configuration key of the limit; empty for a constant."""

    def text(self, sentence: str) -> str:
        """Text line of the evidence; `sentence`: the row's, used if it has none of its own."""
        numbers = {"mm": self.value, "mm_limit": self.limit}
        thousandths = {name: 1e3 * each for name, each in numbers.items() if isinstance(each, float)}
        return (self.sentence or sentence).format(**self._asdict(), **thousandths)


class Finding(NamedTuple):
    """Report of a fault, at one leg or as a whole."""

    fault: str
    """Name of the bit."""
    tick: int
    time_s: float
    """Time in the run."""
    mode: str
    """Name of the mode before the fault."""
    leg: int | None
    value: float | str | None
    limit: float | str | None
    unit: str
    limit_key: str
    """As in `Evidence`."""
    text: str
    """One line, with the numbers of the tick."""
    next: str
    """What to do."""

    @property
    def place(self) -> str:
        """Fault name, time and mode."""
        return f"fault {self.fault} at {self.time_s:.3f} s (tick {self.tick}) in {self.mode}"

    @property
    def line(self) -> str:
        """Place and text in one line."""
        return f"{self.place}: {self.text}" if self.text else self.place

    @property
    def page(self) -> str:
        """Section of the glossary for this fault."""
        return f"{GLOSSARY}#fault-{self.fault.lower()}"

    def fields(self) -> dict[str, Any]:
        """The finding as plain values: null, text, or a finite number."""
        odd = {k: str(x) for k, x in self._asdict().items() if isinstance(x, float) and not isfinite(x)}
        return self._asdict() | odd | {"page": self.page}


DONE = {
    Mode.WAITING: "the faults were cleared on request",
    Mode.IDLE: "the brakes stayed closed",
    Mode.LOADING: "the brakes stayed closed while the force was built up",
    Mode.RELEASING: "the brakes were told to open",
    Mode.APPROACH: "the move to the start of the reference went on",
    Mode.TRACKING: "the motion along the reference went on",
    Mode.STOPPING: "a controlled stop along the reference began",
    Mode.PARKING: "the brakes were told to close, while the law held the platform",
    Mode.UNLOADING: "the closed brakes took the platform over, while the legs had to stand still",
    Mode.PARKED: "the drives were told to switch off",
    Mode.FAULT: "the drives were told to switch off",
    Mode.HELD: "the brakes were told to close and the force held the platform: not all are proven shut",
}
"""Reaction to a fault, by the mode that was entered."""
WITHOUT_FORCE = {
    Mode.LOADING: "the brakes stayed closed: these drives give no force on them",
    Mode.PARKING: "the drives were told to close their brakes, on which they give no force",
    Mode.UNLOADING: "the closed brakes carried the platform, while the legs had to stand still",
    Mode.HELD: "the drives were told to close their brakes, on which they give no force: nothing else holds "
    "the platform, and not all brakes are proven shut",
}
"""Reactions of drives that give no force on closed brakes."""
PLANT_PAGE = "docs/guides/own-fmu.md"
"""Page on the requirements for a plant."""
HELD_NEXT = "support the platform, then let go of it with `hil run CONFIG --release`"
HELD_PAGE = "docs/guides/real-drives.md#held-until-the-brakes-are-proven"
"""Page on brakes that are not proven shut."""
NUMBER = re.compile(r"^[-+]?\d+(\.\d+)?(e[-+]?\d+)?$")
_POWERED = (DriveState.READY.name, DriveState.RUN.name)


class DriveReport(NamedTuple):
    """Last report of a drive."""

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
        """True if it was powered at its last report."""
        return self.state in _POWERED

    @property
    def text(self) -> str:
        """State in words."""
        if self.age >= NEVER:
            return "never heard"
        silent = f" when last heard, {self.age} ticks ago" if self.age else ""
        return f"{self.state}{because(self.fault, self.meaning)}{silent}"


class Step(NamedTuple):
    """One step of the reaction."""

    tick: int
    time_s: float
    mode: str
    """Name of the mode that was entered; ESTOP for the stop frame, PLANT for a plant failure."""
    text: str


@dataclass(frozen=True)
class Story:
    """What happened, the drives' reports, the reaction, and what to do next."""

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
        """The reactions, in one line."""
        return "; ".join(step.text for step in self.done)

    def fields(self) -> dict[str, Any]:
        """The story as plain values."""
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
        """The story in words, one statement per line."""
        lines = [f"plant: {self.plant}"] if self.plant else []
        lines += [f"{each.place}: {text}" if text else each.place for each, text in _merged(self.findings)]
        lines.append(f"drives: {_grouped(self.drives)}")
        lines += [f"done: {step.text} ({step.time_s:.3f} s)" for step in self.done]
        lines.append(f"in the end: {_grouped(self.drives_at_end)}; {self.at_end}")
        lines += [f"next: {advice} ({page})" for advice, page in self.next.items()]
        return lines

    @property
    def next(self) -> dict[str, str]:
        """What to do next: each advice with its page."""
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
    """Leg numbers, separated by commas."""
    return ", ".join(map(str, legs))


def _merged(findings: Sequence[Finding]) -> Iterator[tuple[Finding, str]]:
    """Yield findings with their texts, merged where neighbours differ only in leg and numbers."""

    def alike(each: Finding) -> tuple[Any, ...]:
        words = tuple(NUMBER.sub("#", word) for word in each.text.split(" "))
        return each.fault, each.tick, words

    for _, group in groupby(findings, alike):
        first, *others = group
        columns = zip(*(each.text.split(" ") for each in (first, *others)), strict=True)
        yield first, " ".join(w[0] if len(set(w)) == 1 else ", ".join(w) for w in columns)


def _grouped(drives: Sequence[DriveReport]) -> str:
    """The drives' reports as text, with equal reports grouped."""
    texts: dict[str, list[int]] = {}
    for each in drives:
        texts.setdefault(each.text, []).append(each.leg)
    if len(texts) == 1:
        return f"all {next(iter(texts))}"
    return "; ".join(f"{listed(legs)} {text}" for text, legs in texts.items())
