"""What a log tells of its faults: from the story of its end, else from its events, else from its rows."""

import json
import re
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.family import Family
from drivers.signals import LEGS, DriveState, Fault, Mode
from drivers.tick_columns import COLUMNS
from hil.app.terminal import one_line
from hil.loop.report import because
from hil.loop.story.told import GLOSSARY, done_text
from hil.record.log import Event
from hil.record.schema import SUMMARY
from hil.study.report.timeline import spells

_NEXT = re.compile(r"next: (?P<text>.*) \((?P<page>[^()]*)\)")


class Found(NamedTuple):
    """One fault at one leg or as a whole, all of it as texts but the time."""

    fault: str
    time_s: float | None
    mode: str
    leg: str
    value: str
    limit: str
    text: str
    next: str
    page: str


class Told(NamedTuple):
    """What went wrong, as far as a log has it."""

    headline: str
    """Empty where nothing is known to have gone wrong."""
    findings: tuple[Found, ...]
    drives: tuple[str, ...]
    """What each drive said in the tick of the first fault."""
    done: tuple[tuple[float | None, str], ...]
    """When, s, and what."""
    at_end: str
    """What the drives said and what moved in the end; empty where the log does not have it."""
    next: tuple[tuple[str, str], ...]
    """What to do, and the page that explains it."""


def told(
    metadata: Mapping[str, Mapping[str, str]],
    events: Sequence[Event],
    rows: Rows,
    rate_Hz: float,
    protocol: Family | None = None,
) -> Told:
    """Return what went wrong in a run.

    metadata: that of the log; protocol: that of its configuration, None where that cannot be used. A story
    that is no story of ours counts as none: a log may hold anything.
    """
    ending = metadata.get(SUMMARY, {})
    story = _mapping(ending.get("story", ""))
    found = [_found(_mapping(each)) for each in _list(story.get("findings"))]
    if not found:
        found = [_found(fields) for event in events if (fields := _fields(event))]
    if not found:
        found = _from_rows(rows, rate_Hz)
    reason = _text(ending.get("reason"))
    names = ", ".join(dict.fromkeys(each.fault for each in found))
    headline = f"latched fault {names}" if names else reason
    advice = _advice(story) or {each.next: each.page for each in found if each.next}
    return Told(
        headline,
        tuple(found),
        tuple(_drives(story.get("drives"), protocol) or _drives_of_row(rows, found, rate_Hz, protocol)),
        tuple(_done(story, rows, found, rate_Hz, protocol)),
        _at_end(story),
        tuple(advice.items()),
    )


def _fields(event: Event) -> dict[str, Any]:
    """Return the fields of an event that tells a finding; empty for others."""
    fields = _mapping(event.text.rpartition("\n")[2]) if event.level == "error" else {}
    return fields if "fault" in fields else {}


def _found(fields: Mapping[str, Any]) -> Found:
    unit = _text(fields.get("unit"))
    limit = _quantity(fields.get("limit"), unit)
    key = _text(fields.get("limit_key"))
    return Found(
        _text(fields.get("fault")),
        _number(fields.get("time_s")),
        _text(fields.get("mode")),
        _text(fields.get("leg")),
        _quantity(fields.get("value"), unit),
        f"{limit} ({key})" if limit and key else limit,
        _text(fields.get("text")),
        _text(fields.get("next")),
        _text(fields.get("page")),
    )


def _from_rows(rows: Rows, rate_Hz: float) -> list[Found]:
    """Return the faults that are latched in the rows, without the story that is lost."""
    found = []
    for fault in Fault:
        struck: Any = np.flatnonzero(rows["faults"] & fault) if fault else []
        if len(struck):
            row, name = rows[struck[0]], str(fault.name)
            mode = rows["mode"][max(struck[0] - 1, 0)]
            page = f"{GLOSSARY}#fault-{name.lower()}"
            time_s = int(row["tick"]) / rate_Hz
            found.append(Found(name, time_s, mode_name(int(mode)), "", "", "", "", "see the glossary", page))
    return sorted(found, key=lambda each: each.time_s or 0.0)


def mode_name(mode: int) -> str:
    """Return the name of a Mode, or the number where it has none."""
    return Mode(mode).name if mode in {int(m) for m in Mode} else str(mode)


def _reason(fault: int, protocol: Family | None) -> str:
    return because(fault, "" if protocol is None or not fault else protocol.fault_text(fault))


def _drives(said: Any, protocol: Family | None) -> list[str]:
    texts = []
    for drive in map(_mapping, _list(said)):
        fault, age = drive.get("fault"), drive.get("age")
        heard = f", last heard {age} ticks before" if isinstance(age, int) and age else ""
        reason = _reason(fault, protocol) if isinstance(fault, int) else ""
        texts.append(f"{_text(drive.get('state'))}{reason}{heard}")
    return texts[:LEGS]


def _drives_of_row(rows: Rows, found: Sequence[Found], rate_Hz: float, protocol: Family | None) -> list[str]:
    times = [each.time_s for each in found if each.time_s is not None]
    at: Any = np.flatnonzero(rows["tick"] >= np.rint(min(times) * rate_Hz)) if times else []
    if not len(at):
        return []
    row = rows[at[0]]
    pairs = zip(row["drive_state"].tolist(), row["drive_fault"].tolist(), strict=True)
    known = {int(s): s.name for s in DriveState}
    return [f"{known.get(state, state)}{_reason(fault, protocol)}" for state, fault in pairs]


def _done(
    story: Mapping[str, Any],
    rows: Rows,
    found: Sequence[Found],
    rate_Hz: float,
    protocol: Family | None,
) -> list[tuple[float | None, str]]:
    steps = [_mapping(each) for each in _list(story.get("done"))]
    if steps:
        return [(_number(step.get("time_s")), _text(step.get("text"))) for step in steps]
    times = [each.time_s for each in found if each.time_s is not None]
    if not times:
        return []
    modes = [(int(rows["tick"][a]) / rate_Hz, mode) for mode, a, _ in spells(rows["mode"])]
    force = protocol is None or protocol.traits.force_on_brakes
    known = {int(mode): done_text(mode, force_on_brakes=force) for mode in Mode}
    return [(t, known[mode]) for t, mode in modes if t >= min(times) and mode in known]


def _at_end(story: Mapping[str, Any]) -> str:
    lines = [_text(line) for line in _list(story.get("lines"))]
    return next((line.partition(": ")[2] for line in lines if line.startswith("in the end: ")), "")


def _mapping(value: Any) -> dict[str, Any]:
    """Return a mapping, or the one that a JSON text holds; empty for anything else."""
    if isinstance(value, str):
        try:
            value = json.loads(value)
        except (ValueError, RecursionError):
            return {}
    return value if isinstance(value, dict) else {}


def _advice(story: Mapping[str, Any]) -> dict[str, str]:
    """Return what the lines of a story say to do next, each with its page."""
    lines = (_NEXT.fullmatch(_text(line)) for line in _list(story.get("lines")))
    return {found["text"]: found["page"] for found in lines if found}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _text(value: Any) -> str:
    return "" if value is None else one_line(str(value))


def _number(value: Any) -> float | None:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    try:
        number = float(value)
    except OverflowError:  # JSON's whole numbers have no end
        return None
    return number if isfinite(number) else None


def _quantity(value: Any, unit: str) -> str:
    number = _number(value)
    return _text(value) if number is None else quantity(number, unit)


def quantity(value: float, unit: str) -> str:
    """Return a number with its unit, four digits of it; small lengths with the prefix of a thousandth."""
    if unit == COLUMNS["q"].unit and 0.0 < abs(value) < 0.1:
        value, unit = 1e3 * value, f"m{unit}"
    text = f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.4g}"
    return text if unit in ("", COLUMNS["R"].unit) else f"{text} {unit}"
