"""A campaign on the terminal: pass rates by every swept value, and the worst rows with their commands."""

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.text import Text

from hil.app.output import print_table
from hil.app.terminal import visible
from hil.study.campaign.plan import Plan
from hil.study.campaign.rates import Rate, by_value, causes, judged, shown, why, worst
from hil.study.junit import Verdict
from hil.study.table import results

WORST = 10
"""Failed rows that are shown."""
HEAD = ("value", "rows", "failed", "pass %", "95 % interval")
"""Of `cells`."""


def show(plan: Plan, summary: dict[str, Any], folder: Path | None) -> None:
    """Print the tables of a campaign; `folder`: that of --out, for the commands that repeat a row."""
    rows = summary["matrix"]
    table = results("axis", *HEAD, left=("axis", "value"))
    for name, axis in plan.subject.axes.items():
        for n, each in enumerate(by_value(name, axis, rows)):
            table.add_row(visible(name) if n == 0 else "", *cells(each))
    print_table(table)
    if summary["failed"]:
        found = (f"{name} {count}" for name, count in causes(rows))
        print(f"\nfailed rows by cause: {', '.join(found)}")
    failed = worst(rows, plan.subject.limits, WORST)
    if not failed:
        return
    print(f"\nthe worst {len(failed)} of {summary['failed']} failed rows:")
    for row in failed:
        values = ", ".join(f"{name} {shown(row[name])}" for name in plan.subject.axes)
        print(f"  row {row['row']}: {why(row, plan.subject.limits)}\n    {values}")
        print(f"    {rerun_command(plan, row['row'], folder)}")
    print()


def cells(each: Rate) -> tuple[str | Text, ...]:
    """Return value, rows, failed rows, pass rate and its interval as words."""
    failed = each.rows - each.passed
    percent = f"{100.0 * each.passed / each.rows:.1f}" if each.rows else "-"
    interval = f"{100.0 * each.low:.1f} to {100.0 * each.high:.1f}"
    return visible(each.label), str(each.rows), str(failed), percent, interval


def rerun_command(plan: Plan, row: int, folder: Path | None) -> str:
    """Return the command line that repeats a row with its log."""
    out = [] if folder is None else ["--out", str(folder)]
    return shlex.join(["hil", "campaign", "rerun", str(plan.path), str(row), *out, "--log"])


def verdicts(plan: Plan, summary: dict[str, Any], folder: Path | None) -> Iterator[Verdict]:
    """Yield a case of JUnit for each row, named by its values."""
    for row in summary["matrix"]:
        values = " ".join(f"{name}={shown(row[name])}" for name in plan.subject.axes)
        yield Verdict(
            group=plan.name,
            name=f"row {row['row']} {values}",
            failure=None if row["passed"] else why(row, plan.subject.limits),
            detail="\n".join(filter(None, (row["trouble"], rerun_command(plan, row["row"], folder)))),
        )


def summary_lines(plan: Plan, summary: dict[str, Any]) -> dict[str, Any]:
    """Return the summary as the terminal has it: without rows, the interval in words."""
    low, high = summary["failed_interval_percent"]
    found = {key: value for key, value in summary.items() if key not in ("matrix", "failed_interval_percent")}
    limits = [
        " ".join(filter(None, (name, f">= {limit.min:g}" if limit.min is not None else "",
                               f"<= {limit.max:g}" if limit.max is not None else "")))
        for name in judged(plan.subject.limits)
        for limit in (plan.subject.limits[name],)
    ]  # fmt: skip
    return found | {"limits": limits, "failed_interval_percent": f"{low:.3g} to {high:.3g}"}
