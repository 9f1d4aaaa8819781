"""What a log has of its faults: the story of its end, else the faults of its rows."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from drivers.arrays import Rows
from drivers.family import Family
from drivers.signals import DriveState, Fault, Mode
from drivers.tick_columns import COLUMNS
from hil.app.terminal import one_line
from hil.loop.report import because
from hil.loop.story.told import GLOSSARY, done_text
from hil.record.schema import SUMMARY
from hil.study.report.timeline import spells

_NEXT = re.compile(r"next: (?P<text>.*) \((?P<page>[^()]*)\)")
_END = "in the end: "
Whole = Annotated[int, Field(ge=0, lt=2**63)]


class Finding(BaseModel):
    """One fault at one leg or as a whole."""

    fault: str
    time_s: FiniteFloat | None = None
    mode: str = ""
    leg: Whole | None = None
    value: FiniteFloat | str | None = None
    limit: FiniteFloat | str | None = None
    unit: str = ""
    limit_key: str = ""
    text: str = ""
    next: str = ""
    page: str = ""

    @property
    def cells(self) -> tuple[str, str, str]:
        """Leg, value and limit in words; empty where the log has none."""
        value, limit = (
            quantity(x, self.unit) if isinstance(x, float) else x or "" for x in (self.value, self.limit)
        )
        key = f" ({self.limit_key})" if limit and self.limit_key else ""
        return "" if self.leg is None else str(self.leg), value, limit + key


class _Drive(BaseModel):
    state: str = ""
    fault: Whole = 0
    age: Whole = 0

    def words(self, protocol: Family | None) -> str:
        heard = f", last heard {self.age} ticks before" if self.age else ""
        return f"{self.state}{_reason(self.fault, protocol)}{heard}"


class _Step(BaseModel):
    text: str
    time_s: FiniteFloat | None = None


class _Story(BaseModel):
    """The story of a run's faults as the summary of its log has it."""

    findings: tuple[Finding, ...] = ()
    drives: Annotated[tuple[_Drive, ...], Field(max_length=6)] = ()
    done: tuple[_Step, ...] = ()
    lines: tuple[str, ...] = ()


class Told(NamedTuple):
    """What went wrong, as far as a log has it."""

    headline: str
    """Empty where nothing is known to have gone wrong."""
    findings: tuple[Finding, ...]
    drives: tuple[str, ...]
    """What each drive reported in the tick of the first fault."""
    done: tuple[tuple[float | None, str], ...]
    """When, s, and what."""
    at_end: str
    """What the drives reported and what moved in the end; empty where the log does not have it."""
    next: tuple[tuple[str, str], ...]
    """What to do, and the page that explains it."""


def told(
    metadata: Mapping[str, Mapping[str, str]], rows: Rows, rate_Hz: float, protocol: Family | None = None
) -> Told:
    """Tell what went wrong in a run.

    metadata: that of the log; protocol: that of its configuration, None where that cannot be used. A story
    that is not one of ours counts as none: a log may hold anything.
    """
    ending = metadata.get(SUMMARY, {})
    try:
        story = _Story.model_validate_json(ending.get("story", "{}"))
    except ValidationError:
        story = _Story()
    found = story.findings or tuple(_from_rows(rows, rate_Hz))
    names = ", ".join(dict.fromkeys(each.fault for each in found))
    advice = [each.groupdict() for line in story.lines if (each := _NEXT.fullmatch(line))]
    nexts = {each["text"]: each["page"] for each in advice} or {e.next: e.page for e in found if e.next}
    first_s = min((each.time_s for each in found if each.time_s is not None), default=None)
    return Told(
        one_line(f"latched fault {names}" if names else ending.get("reason", "")),
        found,
        tuple(each.words(protocol) for each in story.drives)
        or _drives_of_row(rows, first_s, rate_Hz, protocol),
        tuple((step.time_s, step.text) for step in story.done) or _done(rows, first_s, rate_Hz, protocol),
        next((line.removeprefix(_END) for line in story.lines if line.startswith(_END)), ""),
        tuple(nexts.items()),
    )


def _from_rows(rows: Rows, rate_Hz: float) -> list[Finding]:
    """Faults that are latched in the rows, without the story that is lost."""
    found = []
    for fault in Fault:
        struck: Any = np.flatnonzero(rows["faults"] & fault) if fault else []
        if len(struck):
            name, mode = str(fault.name), mode_name(int(rows["mode"][max(struck[0] - 1, 0)]))
            page, time_s = f"{GLOSSARY}#fault-{name.lower()}", int(rows["tick"][struck[0]]) / rate_Hz
            found.append(Finding(fault=name, time_s=time_s, mode=mode, next="see the glossary", page=page))
    return sorted(found, key=lambda each: each.time_s or 0.0)


def mode_name(mode: int) -> str:
    """Return the name of a Mode, or the number where it has none."""
    return Mode(mode).name if mode in {int(m) for m in Mode} else str(mode)


def _reason(fault: int, protocol: Family | None) -> str:
    return because(fault, "" if protocol is None or not fault else protocol.fault_text(fault))


def _drives_of_row(
    rows: Rows, first_s: float | None, rate_Hz: float, protocol: Family | None
) -> tuple[str, ...]:
    at: Any = [] if first_s is None else np.flatnonzero(rows["tick"] >= np.rint(first_s * rate_Hz))
    if not len(at):
        return ()
    row = rows[at[0]]
    pairs = zip(row["drive_state"].tolist(), row["drive_fault"].tolist(), strict=True)
    known = {int(s): s.name for s in DriveState}
    return tuple(f"{known.get(state, state)}{_reason(fault, protocol)}" for state, fault in pairs)


def _done(
    rows: Rows, first_s: float | None, rate_Hz: float, protocol: Family | None
) -> tuple[tuple[float | None, str], ...]:
    if first_s is None:
        return ()
    modes = [(int(rows["tick"][a]) / rate_Hz, mode) for mode, a, _ in spells(rows["mode"])]
    force = protocol is None or protocol.traits.force_on_brakes
    known = {int(mode): done_text(mode, force_on_brakes=force) for mode in Mode}
    return tuple((t, known[mode]) for t, mode in modes if t >= first_s and mode in known)


def quantity(value: float, unit: str) -> str:
    """Return a number with its unit, four digits of it; small lengths with the prefix of a thousandth."""
    if unit == COLUMNS["q"].unit and 0.0 < abs(value) < 0.1:
        value, unit = 1e3 * value, f"m{unit}"
    text = f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.4g}"
    return text if unit in ("", COLUMNS["R"].unit) else f"{text} {unit}"
