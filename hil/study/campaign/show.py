"""Shows a campaign's results on the terminal and as a page: pass rates by swept value, and worst rows."""

import shlex
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

from hil.app.files import write_whole
from hil.study.campaign.figures import METRICS
from hil.study.campaign.plan import Plan
from hil.study.campaign.rates import HEAD, by_value, causes, shown, why, worst
from hil.study.campaign.scatter import plots
from hil.study.junit import Verdict
from hil.study.report.page import document, table, tag
from hil.study.table import Column, print_rows

WORST, WORST_ON_PAGE = 10, 25
"""Failed rows shown on the terminal and on the page."""


def show(plan: Plan, summary: dict[str, Any], folder: Path | None) -> None:
    """Print the result tables of a campaign; folder: option --out, for the commands that repeat a row."""
    rows = summary["matrix"]
    lines = [
        (name if n == 0 else "", *each.cells)
        for name, axis in plan.settings.axes.items()
        for n, each in enumerate(by_value(name, axis, rows))
    ]
    columns = [Column(title, itemgetter(n), left=n < 2) for n, title in enumerate(("axis", *HEAD))]
    print_rows(columns, lines)
    if summary["failed"]:
        print("", *worst_lines(plan, summary, folder, WORST), "", sep="\n")


def worst_lines(plan: Plan, summary: dict[str, Any], folder: Path | None, most: int) -> list[str]:
    """Text lines: causes of failure, and at most `most` failed rows with the commands that repeat them."""
    rows, limits = summary["matrix"], plan.settings.kept
    failed = worst(rows, limits, most)
    lines = [f"failed rows by cause: {', '.join(f'{name} {count}' for name, count in causes(rows))}", ""]
    lines.append(f"the worst {len(failed)} of {summary['failed']} failed rows:")
    for row in failed:
        lines.append(f"  row {row['row']}: {why(row, limits)}")
        lines += [f"    {_values(plan, row, ', ', ' ')}", f"    {rerun_command(plan, row['row'], folder)}"]
    return lines


def _values(plan: Plan, row: dict[str, Any], between: str, of: str) -> str:
    return between.join(f"{name}{of}{shown(row[name])}" for name in plan.settings.axes)


def rerun_command(plan: Plan, row: int, folder: Path | None) -> str:
    """Command line that repeats a row and records its log."""
    out = [] if folder is None else ["--out", str(folder)]
    return shlex.join(["hil", "campaign", "rerun", str(plan.path), str(row), *out, "--log"])


def verdicts(plan: Plan, summary: dict[str, Any], folder: Path | None) -> Iterator[Verdict]:
    """Yield one JUnit test case per row of a campaign; its name lists the axis values."""
    for row in summary["matrix"]:
        yield Verdict(
            group=plan.name,
            name=f"row {row['row']} {_values(plan, row, ' ', '=')}",
            failure=None if row["passed"] else why(row, plan.settings.kept),
            detail="\n".join(filter(None, (row["trouble"], rerun_command(plan, row["row"], folder)))),
        )


def summary_lines(plan: Plan, summary: dict[str, Any]) -> dict[str, Any]:
    """Summary of a campaign for the terminal: without rows, the confidence interval as text."""
    low, high = summary["failed_interval_percent"]
    found = {key: value for key, value in summary.items() if key != "matrix"}
    limits = [f"{name} {limit.words}" for name, limit in plan.settings.kept.items()]
    return found | {"limits": limits, "failed_interval_percent": f"{low:.3g} to {high:.3g}"}


def write_page(path: Path, plan: Plan, summary: dict[str, Any], folder: Path | None = None) -> None:
    """Write a campaign's results as an HTML page. folder: option --out. Raises OSError if that fails."""
    limits = plan.settings.kept
    low, high = summary["failed_interval_percent"]
    verdict = (
        f"{summary['failed']} of {summary['rows']} rows failed: {summary['failed_percent']:.3g} %, "
        f"95 % interval {low:.3g} to {high:.3g} %"
    )
    kept = [(name, limit.words, METRICS[name].unit, METRICS[name].meaning) for name, limit in limits.items()]
    body = [
        tag("header", tag("h1", f"Campaign {plan.name}"), tag("p", plan.settings.description)),
        tag("p", verdict, class_="verdict good" if summary["success"] else "verdict bad"),
        tag("h2", "Limits"),
        table(("metric", "allowed", "unit", "meaning"), kept, "limits of every row"),
        tag("h2", "By axis"),
        *(
            table(HEAD, (each.cells for each in by_value(name, axis, summary["matrix"])), name)
            for name, axis in plan.settings.axes.items()
        ),
        tag("p", "Wilson's interval assumes independent rows.", class_="note"),
        tag("h2", "Figures over the swept values"),
        *plots(list(plan.settings.axes), summary["matrix"]),
    ]
    if summary["failed"]:
        lines = worst_lines(plan, summary, folder, WORST_ON_PAGE)
        worst = tag("div", tag("pre", "\n".join(lines)), class_="scroll", tabindex=0)
        body += [tag("h2", "Worst rows"), worst]
    text = document(f"Campaign {plan.name}", [tag("main", *body)], ("page.css",))
    write_whole(path, text)
