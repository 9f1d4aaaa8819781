"""The bring-up: the steps in their order, each with consent, until one names a mistake; and its checklist.

Nothing later begins while a gate has findings. Facts that are known are not asked for again.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

from drivers.signals import LEGS
from hil.lab.bringup.context import Context, Finding, RefusedError, Request, Step, StoppedError
from hil.lab.bringup.steps import brakes, encoder, force, gauge, ids, mounted, scan, silence

STEPS: tuple[Step, ...] = tuple(
    module.STEP for module in (scan, silence, ids, encoder, brakes, force, gauge, mounted)
)
"""In their order; the first three and `mounted` are gates, the others end at the one before `mounted`."""
ENDS = frozenset({"runaway", "not_powered", "lost_power", "not_heard", "encoder_jumps"})
"""Findings after which nothing more is tried."""


class Outcome(NamedTuple):
    """How far a bring-up came."""

    passed: tuple[str, ...]
    """Steps without a finding."""
    findings: tuple[Finding, ...]
    gaps: tuple[tuple[str, Finding], ...] = ()
    """Steps that cannot prove all with these drives, and what; the operator has taken that over."""
    stopped: str = ""
    """Step at which it ended early; empty: all steps were done."""

    @property
    def success(self) -> bool:
        """Whether all steps passed."""
        return not self.findings and not self.stopped


def bring_up(c: Context, steps: tuple[Step, ...] = STEPS) -> Outcome:
    """Do the steps. However it ends, forces are zero and brakes shut before it returns or raises.

    When it returns, all drives have their own watchdogs again and no fault of a lock-out. Raises RefusedError
    where the operator does not consent.
    """
    try:
        outcome = _done(c, steps)
    finally:
        c.drives.off(c.machine.brake_shut_s)
    c.drives.prepare(None)
    return outcome


def _done(c: Context, steps: tuple[Step, ...]) -> Outcome:
    passed: list[str] = []
    findings: list[Finding] = []
    gaps: list[tuple[str, Finding]] = []
    stopped = ""
    for step in steps:
        if findings and step.gate:
            stopped = step.name
            break
        known, found = _proceed(c, step)
        findings += found
        for finding in found:
            c.operator.tell(f"  {finding.line}")
        if found and (step.gate or not ENDS.isdisjoint(each.name for each in found)):
            stopped = step.name
            break
        if found:
            continue
        gap = step.gap(c)
        if gap is not None:  # taken over at every start: the operator may be another
            c.operator.tell(f"  {gap.line}")
            text = f"{step.name} is not proven: take it over by typing `accept`"
            c.ask(Request("accept", text=text, word="accept"))
            gaps.append((step.name, gap))
        elif step.by_drive and len(c.facts.get(step.name, {})) < LEGS:
            c.operator.tell("  not measured: see the findings above")
        else:
            passed.append(step.name)
            c.keep("passed", step.name, fact=True)
            c.operator.tell("  passed before" if known else "  passed")
    return Outcome(tuple(passed), tuple(merged(findings)), tuple(gaps), stopped)


def _proceed(c: Context, step: Step) -> tuple[bool, list[Finding]]:
    """Do a step if it has not passed before; return whether it has, and its findings."""
    c.operator.tell(f"{step.name}: {step.title}")
    known = step.kept_whole(c, len(c.machine.pose_lengths) if step is mounted.STEP else LEGS)
    if not known and not c.operator.consent(step.title, step.will, step.stop):
        raise RefusedError(f"ended before step {step.name}; what was found is kept")
    try:
        if not known:
            step.find(c)
        return known, list(step.judge(c))
    except StoppedError as stop:
        return known, [stop.finding]


def merged(findings: list[Finding]) -> list[Finding]:
    """Return the findings with one cause for what has one: a wrong lead, a drive the other way round."""
    named: dict[tuple[str, tuple[int, ...]], Finding] = {}
    more: list[Finding] = []
    for finding in findings:
        first = named.setdefault((finding.name, finding.legs), finding)
        if finding.name == "brake_crossed" and finding.text != first.text:
            more.append(finding)
    for legs in sorted({finding.legs for finding in findings}):
        if ("wrong_lead", legs) in named or ("scale_or_lead", legs) in named:
            named.pop(("encoder_scale", legs), None)
        if ("encoder_sign", legs) in named and ("force_sign", legs) in named:
            del named["encoder_sign", legs], named["force_sign", legs]
            text = "its reading falls as it grows, and a force that should extend it shortens it"
            mend = "Turn the drive's direction of rotation."
            named["drive_reversed", legs] = Finding("drive_reversed", legs, text, mend)
    return [*named.values(), *more]


_UNITS = {"m", "s", "N", "kg"}


def checklist(c: Context, outcome: Outcome, together: Iterable[str]) -> list[str]:
    """Return the lines: a line a step with its verdict, below it the figures of each leg."""
    lines, gaps = [], dict(outcome.gaps)
    for step in STEPS:
        figures, gap = _figures(c, step), gaps.get(step.name)
        mark = "x" if step.name in outcome.passed else "!" if figures and outcome.findings else " "
        lines.append(f"[{'-' if gap else mark}] {step.name}: {step.title}")
        if gap:
            figures.append(f"{gap.line}; taken over by the operator")
        lines += [f"      {line}" for line in figures]
    return [*lines, *(f"    ! {finding.line}" for finding in outcome.findings), *together]


def _figures(c: Context, step: Step) -> list[str]:
    tables = ("identity", "scan") if step is scan.STEP else step.tables or (step.name,)
    lines = [
        f"{table} {name}: {_words(fact)}" for table in tables for name, fact in c.facts.get(table, {}).items()
    ]
    gains = gauge.gains(c) if step is gauge.STEP else {}
    for drive, gain in gains.items():
        within = 100.0 * (gauge.WITHIN + gain.error + c.machine.losses)
        lines.append(f"drive {drive}: {gain.value:.3f} N a commanded N; right is 1 within {within:.2g} %")
    return lines


def _words(value: Any) -> str:
    """Return a fact with the figures and units of its keys."""
    match value:
        case dict():
            words = []
            for key, each in value.items():
                name, _, unit = key.rpartition("_")
                words.append(f"{name} {_words(each)} {unit}" if unit in _UNITS else f"{key} {_words(each)}")
            return ", ".join(words)
        case list():
            return " ".join(map(_words, value)) or "none"
        case None | "":
            return "none"
        case float():
            return f"{value:.5g}"
    return str(value)
