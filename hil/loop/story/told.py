"""What a tick shows of a fault, and the story that is told of it: in words, and as plain values."""

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

    def remembered(self, name: str) -> int:
        """Return what the rules of safety remember, as bits."""
        return int(self.cycle.parts.safety.memory[name])

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

    def text(self, sentence: str) -> str:
        """Return the line of what was seen, by the row's sentence where it has none of its own."""
        numbers = {"mm": self.value, "mm_limit": self.limit}
        thousandths = {name: 1e3 * each for name, each in numbers.items() if isinstance(each, float)}
        return (self.sentence or sentence).format(**self._asdict(), **thousandths)


class Finding(NamedTuple):
    """What is told of a fault, at one leg or as a whole."""

    fault: str
    """Name of the bit."""
    tick: int
    time_s: float
    """Of the run."""
    mode: str
    """Name of the mode until then."""
    leg: int | None
    value: float | str | None
    limit: float | str | None
    unit: str
    limit_key: str
    """As in `Seen`."""
    text: str
    """One line, with the numbers of the tick."""
    next: str
    """What to do."""

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
        odd = {k: str(x) for k, x in self._asdict().items() if isinstance(x, float) and not isfinite(x)}
        return self._asdict() | odd | {"page": self.page}


DONE = {
    Mode.WAITING: "the faults were cleared on request",
    Mode.IDLE: "the brakes stayed closed",
    Mode.LOADING: "the brakes stayed closed while the force was built up",
    Mode.RELEASING: "the brakes were told to open",
    Mode.APPROACH: "the move to the start of the reference went on",
    Mode.TRACKING: "the reference was followed on",
    Mode.STOPPING: "a controlled stop along the reference began",
    Mode.PARKING: "the brakes were told to close, while the law held the platform",
    Mode.UNLOADING: "the closed brakes took the platform over, while the legs had to stand still",
    Mode.PARKED: "the drives were told to switch off",
    Mode.FAULT: "the drives were told to switch off",
    Mode.HELD: "the brakes were told to close and the force held the platform: not all are proven shut",
}
"""What was done about a fault, by the mode that was entered."""
WITHOUT_FORCE = {
    Mode.LOADING: "the brakes stayed closed: these drives give no force on them",
    Mode.PARKING: "the drives were told to close their brakes, on which they give no force",
    Mode.UNLOADING: "the closed brakes carried the platform, while the legs had to stand still",
    Mode.HELD: "the drives were told to close their brakes, on which they give no force: nothing else holds "
    "the platform, and not all brakes are proven shut",
}
"""The same where the drives give no force on closed brakes."""
PLANT_PAGE = "docs/guides/own-fmu.md"
"""What a plant has to do."""
HELD_NEXT = "support the platform, then let go of it with `hil run CONFIG --release`"
HELD_PAGE = "docs/guides/real-drives.md#held-until-the-brakes-are-proven"
"""What it means that not all brakes are proven shut."""
NUMBER = re.compile(r"^[-+]?\d+(\.\d+)?(e[-+]?\d+)?$")
_POWERED = (DriveState.READY.name, DriveState.RUN.name)


class DriveSaid(NamedTuple):
    """What a drive has said of itself."""

    leg: int
    state: str
    """Name of a DriveState."""
    fault: int
    age: int
    """Ticks since it was last heard."""
    meaning: str = ""
    """What a fault code of its maker's means; empty where that is not known."""

    @property
    def powered(self) -> bool:
        """Whether it was, when it was last heard."""
        return self.state in _POWERED

    @property
    def text(self) -> str:
        """Its state in words."""
        if self.age >= NEVER:
            return "never heard"
        silent = f" when last heard, {self.age} ticks ago" if self.age else ""
        return f"{self.state}{because(self.fault, self.meaning)}{silent}"


class Step(NamedTuple):
    """One thing that was done."""

    tick: int
    time_s: float
    mode: str
    """Name of the mode that was entered; ESTOP for the frame, PLANT where that has failed."""
    text: str


@dataclass(frozen=True)
class Story:
    """What happened, what the drives said, what was done, what to do next."""

    findings: tuple[Finding, ...]
    """In the order in which the faults struck, causes first where several did at once."""
    drives: tuple[DriveSaid, ...]
    """In the tick of the first fault."""
    done: tuple[Step, ...]
    drives_at_end: tuple[DriveSaid, ...]
    at_end: str
    """What moves in the end."""
    plant: str = ""
    """Why the plant of a simulation failed; empty while it lives."""

    @property
    def short(self) -> str:
        """The faults and what shows them, in one line."""
        return short(self.findings)

    @property
    def done_text(self) -> str:
        """What was done, in one line."""
        return "; ".join(step.text for step in self.done)

    def fields(self) -> dict[str, Any]:
        """Return it as plain values."""
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
        """Return it in words, one thing a line."""
        lines = [f"plant: {self.plant}"] if self.plant else []
        lines += [f"{each.place}: {text}" if text else each.place for each, text in _merged(self.findings)]
        lines.append(f"drives: {_grouped(self.drives)}")
        lines += [f"done: {step.text} ({step.time_s:.3f} s)" for step in self.done]
        lines.append(f"in the end: {_grouped(self.drives_at_end)}; {self.at_end}")
        lines += [f"next: {mend} ({page})" for mend, page in self.next.items()]
        return lines

    @property
    def next(self) -> dict[str, str]:
        """What to do next: each advice with its page in the glossary."""
        modes = [step.mode for step in self.done if step.mode in Mode.__members__]
        advice = {HELD_NEXT: HELD_PAGE} if modes[-1:] == [Mode.HELD.name] else {}
        if self.plant:
            advice["mend the plant: its own words stand above"] = PLANT_PAGE
        advice |= {each.next or "see the glossary": each.page for each in self.findings}
        return advice


def short(findings: Sequence[Finding]) -> str:
    """Return faults and what shows them in one line; empty without any."""
    if not findings:
        return ""
    names = ", ".join(dict.fromkeys(each.fault for each in findings))
    texts = "; ".join(text for _, text in _merged(findings) if text)
    return f"latched fault {names}" + (f" ({texts})" if texts else "")


def listed(legs: Sequence[int]) -> str:
    """Return numbers of legs with commas."""
    return ", ".join(map(str, legs))


def _merged(findings: Sequence[Finding]) -> Iterator[tuple[Finding, str]]:
    """Yield the findings with their texts; as one those in a row that differ in leg and figures alone."""

    def alike(each: Finding) -> tuple[Any, ...]:
        words = tuple(NUMBER.sub("#", word) for word in each.text.split(" "))
        return each.fault, each.tick, words

    for _, group in groupby(findings, alike):
        first, *others = group
        columns = zip(*(each.text.split(" ") for each in (first, *others)), strict=True)
        yield first, " ".join(w[0] if len(set(w)) == 1 else ", ".join(w) for w in columns)


def _grouped(drives: Sequence[DriveSaid]) -> str:
    """Return what the drives say, those together that say the same."""
    texts: dict[str, list[int]] = {}
    for each in drives:
        texts.setdefault(each.text, []).append(each.leg)
    if len(texts) == 1:
        return f"all {next(iter(texts))}"
    return "; ".join(f"{listed(legs)} {text}" for text, legs in texts.items())
