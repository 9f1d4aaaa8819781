"""Runs the steps of a bring-up in order, each after the operator's consent, and formats its checklist.

A step marked `gate` begins only without findings, and ends the bring-up if it has one.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

from drivers.signals import LEGS
from hil.lab.bringup.context import Context, Finding, RefusedError, Request, Step, StoppedError
from hil.lab.bringup.steps import brakes, encoder, force, gauge, hoisted, ids, mounted, scan, silence

STEPS: tuple[Step, ...] = tuple(
    module.STEP for module in (scan, silence, ids, encoder, brakes, force, gauge, mounted, hoisted)
)
"""All steps in order; gates are the first three and the last two, which begin only without findings."""
ENDS = frozenset({
    "runaway", "coupling_or_clamp", "brake_not_shut",
    "not_powered", "lost_power", "not_heard", "encoder_jumps",
})  # fmt: skip
"""Findings after which the bring-up ends at once."""


class Outcome(NamedTuple):
    """Result of a bring-up: steps passed, findings, and the step at which it ended early."""

    passed: tuple[str, ...]
    """Steps without a finding."""
    findings: tuple[Finding, ...]
    gaps: tuple[tuple[str, Finding], ...] = ()
    """Steps with a property that cannot be proven with these drives; the operator accepted each."""
    stopped: str = ""
    """Step at which it ended early; empty: all steps were done."""

    @property
    def success(self) -> bool:
        """True if all steps were done without a finding."""
        return not self.findings and not self.stopped


def bring_up(c: Context, steps: tuple[Step, ...] = STEPS) -> Outcome:
    """Run the steps of a bring-up. Forces are zero and brakes shut on every exit, by return or exception.

    On return all drives have their own watchdogs again and no lock-out fault. Raises RefusedError if the
    operator does not consent.
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

    def ended(stopped: str) -> Outcome:
        return Outcome(tuple(passed), tuple(merged(c, findings)), tuple(gaps), stopped)

    for step in steps:
        if findings and step.gate:
            return ended(step.name)
        known, found = _proceed(c, step)
        findings += found
        for finding in found:
            c.operator.tell(f"  {finding.line}")
        if found and (step.gate or not ENDS.isdisjoint(each.name for each in found)):
            return ended(step.name)
        if found:
            continue
        gap = step.gap(c)
        if gap is not None:  # taken over at every start: the operator may be another
            c.operator.tell(f"  {gap.line}")
            text = f"{step.name} is not proven: take responsibility for it by typing `accept`"
            c.ask(Request("accept", text=text, word="accept"))
            gaps.append((step.name, gap))
        elif step.by_drive and len(c.facts.get(step.name, {})) < LEGS:
            c.operator.tell("  not measured: see the findings above")
        else:
            passed.append(step.name)
            c.keep("passed", step.name, fact=True)
            c.operator.tell("  passed before" if known else "  passed")
    return ended("")


def _proceed(c: Context, step: Step) -> tuple[bool, list[Finding]]:
    """Run a step unless it passed before; return (passed before, findings)."""
    c.operator.tell(f"{step.name}: {step.title}")
    known = step.kept_whole(c)
    if not known and not c.operator.consent(step.title, step.will, step.stop):
        raise RefusedError(f"ended before step {step.name}; results so far are kept")
    try:
        if not known:
            step.find(c)
        return known, list(step.judge(c))
    except StoppedError as stop:
        return known, [stop.finding]


def merged(c: Context, findings: list[Finding]) -> list[Finding]:
    """Merge findings that are symptoms of one cause: a wrong screw lead, or a drive that turns the wrong way.

    Without a force measurement a wrong encoder scale may also be a wrong lead.
    """
    named: dict[tuple[str, tuple[int, ...]], Finding] = {}
    more: list[Finding] = []
    for finding in findings:
        first = named.setdefault((finding.name, finding.legs), finding)
        if finding.name == "brake_crossed" and finding.text != first.text:
            more.append(finding)
    for legs in sorted({finding.legs for finding in findings}):
        if ("wrong_lead", legs) in named or ("scale_or_lead", legs) in named:
            named.pop(("encoder_scale", legs), None)
        if ("encoder_scale", legs) in named and c.known("gauge", legs[0]) is None:
            scale = abs(c.reads().get(legs[0], (0, 1.0))[1])
            if gauge.as_lead(scale):
                del named["encoder_scale", legs]
                named["scale_or_lead", legs] = gauge.scale_or_lead(legs[0], scale, None)
        if ("encoder_sign", legs) in named and ("force_sign", legs) in named:
            del named["encoder_sign", legs], named["force_sign", legs]
            text = "its reading falls as the leg extends, and a force that should extend the leg shortens it"
            remedy = "Invert the drive's direction of rotation."
            named["drive_reversed", legs] = Finding("drive_reversed", legs, text, remedy)
    return [*named.values(), *more]


_UNITS = {"m", "s", "N", "kg"}


def checklist(c: Context, outcome: Outcome, together: Iterable[str]) -> list[str]:
    """Lines of the checklist: each step, marked passed, failed or not provable, then the figures by leg."""
    lines, gaps = [], dict(outcome.gaps)
    for step in STEPS:
        figures, gap = _figures(c, step), gaps.get(step.name)
        mark = "x" if step.name in outcome.passed else "!" if figures and outcome.findings else " "
        lines.append(f"[{'-' if gap else mark}] {step.name}: {step.title}")
        if gap:
            figures.append(f"{gap.line}; the operator took responsibility")
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
        lines.append(f"drive {drive}: {gain.value:.3f} N per commanded N; expected: 1 within {within:.2g} %")
    return lines


def _words(value: Any) -> str:
    """A stored result as text; its units come from its keys."""
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
