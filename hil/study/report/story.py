"""Faults of a logged run: the explanation stored in the log's summary, else the fault bits in its rows."""

from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from drivers.arrays import Rows
from drivers.signals import Fault, Mode
from drivers.tick_columns import COLUMNS
from hil.app.terminal import one_line
from hil.loop.story.story import GLOSSARY
from hil.record.schema import SUMMARY

HEADINGS = {
    "next": "What to do next",
    "done": "What was done",
    "drives": "What the drives reported then",
    "in the end": "In the end",
}
"""Prefix of a line of the explanation -> heading on the page."""


class Finding(BaseModel):
    """One fault of a run, at one leg or of the whole machine, with value, limit and text."""

    fault: str
    time_s: FiniteFloat | None = None
    mode: str = ""
    leg: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    value: FiniteFloat | str | None = None
    limit: FiniteFloat | str | None = None
    unit: str = ""
    limit_key: str = ""
    text: str = ""

    @property
    def cells(self) -> tuple[str, str, str]:
        """Leg, value and limit as table cells; empty if the log has none."""
        value, limit = (
            quantity(x, self.unit) if isinstance(x, float) else x or "" for x in (self.value, self.limit)
        )
        key = f" ({self.limit_key})" if limit and self.limit_key else ""
        return "" if self.leg is None else str(self.leg), value, limit + key


class _Story(BaseModel):
    """Explanation of a run's faults, as stored in the summary of its log."""

    findings: tuple[Finding, ...] = ()
    lines: tuple[str, ...] = ()


class Failure(NamedTuple):
    """Failure of a run, as far as its log describes it."""

    headline: str
    """One line about the failure; empty: no known failure."""
    findings: Sequence[Finding]
    lines: dict[str, list[str]]
    """Lines of the explanation, by key of HEADINGS."""


def failure_of(metadata: Mapping[str, Mapping[str, str]], rows: Rows, rate_Hz: float) -> Failure:
    """Failure of a run with this log metadata. An invalid stored explanation counts as missing."""
    ending = metadata.get(SUMMARY, {})
    try:
        story = _Story.model_validate_json(ending.get("story", "{}"))
    except ValidationError:
        story = _Story()
    found = story.findings or _from_rows(rows, rate_Hz)
    names = ", ".join(dict.fromkeys(each.fault for each in found))
    lines = {
        key: [line.removeprefix(f"{key}: ") for line in story.lines if line.startswith(f"{key}: ")]
        for key in HEADINGS
    }
    if not story.lines:
        lines["next"] = [f"see {GLOSSARY}#fault-{each.fault.lower()}" for each in found]
    return Failure(one_line(f"latched fault {names}" if names else ending.get("reason", "")), found, lines)


def _from_rows(rows: Rows, rate_Hz: float) -> list[Finding]:
    """Faults that appear in the rows, for a log without a stored explanation."""
    found = []
    for fault in Fault:
        struck = np.flatnonzero(rows["faults"] & fault).tolist()
        if struck:
            mode, tick = rows["mode"][max(struck[0] - 1, 0)], rows["tick"][struck[0]]
            found.append(
                Finding(fault=str(fault.name), time_s=int(tick) / rate_Hz, mode=mode_name(int(mode)))
            )
    return sorted(found, key=lambda each: each.time_s or 0.0)


def mode_name(mode: int) -> str:
    """Name of a controller mode, or its number as text if it is unknown."""
    return Mode(mode).name if mode in {int(m) for m in Mode} else str(mode)


def quantity(value: float, unit: str) -> str:
    """Number with four digits and its unit as text; lengths below 0.1 m in mm."""
    if unit == COLUMNS["q"].unit and 0.0 < abs(value) < 0.1:
        value, unit = 1e3 * value, f"m{unit}"
    text = f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.4g}"
    return text if unit in ("", COLUMNS["R"].unit) else f"{text} {unit}"
