"""The checklist of a bring-up: what was measured of each leg, by step, as lines."""

from collections.abc import Iterable
from typing import Any

from hil.lab.bringup.context import Context, Step
from hil.lab.bringup.procedure import STEPS, Outcome
from hil.lab.bringup.steps import gauge, scan

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
