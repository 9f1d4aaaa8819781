"""Sections of the report page: what happened, the margins to the limits, and the timing."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.signals import Mode
from hil.app.output import number
from hil.record.log import Event, Log
from hil.record.schema import ENVIRONMENT, SUMMARY
from hil.study.report.charts import lanes
from hil.study.report.margins import Margin
from hil.study.report.page import Html, joined, prose, table, tag
from hil.study.report.story import HEADINGS, Failure, mode_name, quantity
from hil.study.report.timing import PERCENTILES

EVENTS = 200
"""Largest number of events shown, from the first on."""
MACHINE = ("cpu", "cpus", "kernel", "scheduler", "affinity", "clock", "git", "version")
"""Keys shown of the machine and of the settings granted to a loop in real time."""
UNSEEN = (
    "The table lacks jumps of a leg rate, and readings that stand still while their leg strays from its "
    "reference: a log has these figures only after they have raised a fault."
)


def opening(failure: Failure, rows: Rows, remark: str) -> Html:
    """First section of the page: whether the run ended well, and which part of the log is missing."""
    mode = mode_name(int(rows["mode"][-1]))
    if failure.headline:
        kind, text = "bad", f"Went wrong: {failure.headline}{_where(failure)}"
    elif mode == Mode.PARKED.name and not remark:
        kind, text = "good", "Parked without a fault"
        tracking = rows[rows["mode"] == Mode.TRACKING]
        if len(tracking):
            error_mm = 1e3 * float(np.abs(tracking["q_d"] - tracking["q"]).max())
            text += f", peak leg error {number(error_mm)} mm while tracking"
    else:
        kind, text = "open", f"No fault in this log; it ends in {mode}"
    lines = [tag("p", text, class_=f"verdict {kind}", role="status")]
    if remark:
        lines.append(tag("p", f"This page shows the readable part of the log: {remark}.", class_="remark"))
    return tag("section", *lines, id="verdict")


def _where(failure: Failure) -> str:
    """Leg and time of the first fault, for the headline."""
    first = next(iter(failure.findings), None)
    if first is None:
        return ""
    leg = "" if first.leg is None else f" on leg {first.leg}"
    return leg + ("" if first.time_s is None else f" at {first.time_s:.3f} s")


def what_went_wrong(failure: Failure) -> Html:
    """Section about the faults: leg, value, limit, time, drives, reaction and next steps."""
    head = ("fault", "since, s", "in mode", "leg", "value", "limit", "what happened")
    rows = [
        (f.fault, "" if f.time_s is None else f"{f.time_s:.3f}", f.mode, *f.cells, prose(f.text))
        for f in failure.findings
    ]
    parts = [tag("h2", "What went wrong"), *([table(head, rows)] if rows else [])]
    for key, lines in failure.lines.items():
        if lines:
            parts += [tag("h3", HEADINGS[key]), tag("ul", *(tag("li", prose(line)) for line in lines))]
    return tag("section", *parts, id="story")


def limits(found: Sequence[Margin], t: Array, why_not: str) -> Html:
    """Section with a table of the smallest margin to every limit, the nearest first."""
    title = tag("h2", "Smallest margin of every limit")
    if why_not:
        return tag("section", title, tag("p", why_not), id="limits")
    head = ("limit", "used", "worst value", "allowed", "left", "leg", "at, s", "set by")
    rows = [
        (
            m.name,
            _used(m.used_percent),
            quantity(m.value, m.unit),
            quantity(m.limit, m.unit),
            quantity(m.limit - m.value, m.unit),
            "" if m.leg is None else m.leg,
            f"{t[m.row]:.3f}",
            tag("code", m.key) if m.key else "constant",
        )
        for m in found
    ]
    note = "Each limit over the ticks in which its rule applies."
    return tag("section", title, table(head, rows), tag("p", f"{note} {UNSEEN}", class_="note"), id="limits")


def _used(percent: float) -> Html:
    """Bar that shows a percentage of a limit, with its number."""
    text, ends = f"{percent:.1f} %", {"min": 0, "max": 100, "low": 80, "high": 95, "optimum": 0}
    bar = tag("meter", text, **ends, value=f"{percent:.2f}", aria_label=text)
    return joined((bar, tag("span", f" {text}")))


def figures(values: Sequence[tuple[str, str]]) -> Html:
    """Section with a table of the run's figures: names and values."""
    shown = ((name.replace(" ", "\u2003", len(name) - len(name.lstrip())), value) for name, value in values)
    return tag("section", tag("h2", "Figures of the run"), table(("figure", "value"), shown), id="figures")


def modes(rows: Rows, t: Array, events: Sequence[Event]) -> list[Html]:
    """Tables of the modes, of fault and warning bits that were set, and of events."""
    lines = [
        (mode_name(mode), f"{t[a]:.3f}", f"{t[min(b, len(t) - 1)] - t[a]:.3f}")
        for mode, a, b in spells(rows["mode"])[:EVENTS]
    ]
    parts = [table(("mode", "from, s", "for, s"), lines, "Modes")]
    bits = [(label, f"{t[np.argmax(there)]:.3f}", np.count_nonzero(there)) for label, there in lanes(rows)]
    if bits:
        parts.append(table(("set", "first at, s", "ticks"), bits, "Faults, warnings and other bits"))
    if events:
        start = int(rows["t_ns"][0])
        shown = [
            (f"{1e-9 * (e.t_ns - start):.3f}", e.level, prose(e.text.partition("\n")[0]))
            for e in events[:EVENTS]
        ]
        more = f", the first {EVENTS} of {len(events)}" if len(events) > EVENTS else ""
        parts.append(table(("at, s", "level", "event"), shown, f"Events{more}"))
    return parts


def spells(values: Ints) -> list[tuple[int, int, int]]:
    """Runs of equal values (n,), n > 0: list of (value, first row, row after the last)."""
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return [(int(values[a]), a, b) for a, b in pairwise(edges)]


def timing(
    log: Log,
    spreads: Sequence[tuple[str, Array]],
    counted: Sequence[tuple[str, int]],
    stood: Sequence[tuple[str, str]],
) -> Html:
    """Section about timing: percentiles, counts, pauses of the bench's time, and the machine."""
    parts: list[Html] = [tag("h2", "Timing and machine")]
    if log.lockstep:
        parts.append(
            tag("p", "Simulated time: wake-ups and computing time were not measured.", class_="note")
        )
    if spreads:
        head = ("time", *(f"p{p:g}" if p < 100 else "max" for p in PERCENTILES))
        rows = [(name, *(f"{1e-3 * ns:.1f} µs" for ns in values.tolist())) for name, values in spreads]
        parts.append(table(head, rows))
    parts.append(table(("counted over the whole log", "number"), counted))
    if stood:
        parts.append(table(("bench time that stood still", ""), stood))
    machine = log.metadata.get(SUMMARY, {}) | log.metadata.get(ENVIRONMENT, {})
    shown = [(key, machine[key]) for key in MACHINE if key in machine]
    if shown:
        parts.append(table(("machine and version", ""), shown))
    return tag("section", *parts, id="timing")
