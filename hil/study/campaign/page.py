"""A campaign as one HTML page without scripts: rates, distributions, the worst rows."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import LogError
from hil.app.files import write_whole
from hil.study.campaign.draw import histogram, intervals
from hil.study.campaign.figures import COUNTS, METRICS
from hil.study.campaign.parquet import Row
from hil.study.campaign.plan import Plan
from hil.study.campaign.rates import HEAD, by_value
from hil.study.campaign.show import worst_lines
from hil.study.report.html import Html, table, tag
from hil.study.report.page import document

WORST = 25
"""Failed rows on the page."""


def write_page(path: Path, plan: Plan, summary: dict[str, Any], folder: Path | None = None) -> None:
    """Write the page, over an earlier one; `folder`: that of --out. Raises LogError: it cannot be written."""
    rows, limits = summary["matrix"], plan.settings.kept
    low, high = summary["failed_interval_percent"]
    verdict = tag(
        "p",
        f"{summary['failed']} of {summary['rows']} rows failed: {summary['failed_percent']:.3g} %, "
        f"95 % interval {low:.3g} to {high:.3g} %",
        class_="verdict good" if summary["success"] else "verdict bad",
    )
    head = tag("header", tag("h1", f"Campaign {plan.name}"), tag("p", plan.settings.description))
    kept = [(name, limit.words, METRICS[name].unit, METRICS[name].meaning) for name, limit in limits.items()]
    body = [
        head,
        verdict,
        tag("h2", "Limits"),
        table(("metric", "allowed", "unit", "meaning"), kept, "what every row has to keep"),
        tag("h2", "By axis"),
        *_axes(plan, rows),
        tag("h2", "Distributions"),
        *_distributions(plan, rows),
    ]
    if summary["failed"]:
        lines = worst_lines(plan, summary, folder, WORST)
        body += [
            tag("h2", "Worst rows"),
            tag("div", tag("pre", "\n".join(lines)), class_="scroll", tabindex=0),
        ]
    body.append(tag("p", "Wilson's interval takes rows as independent draws.", class_="note"))
    text = document(f"Campaign {plan.name}", [tag("main", *body)], ("report.css",))
    try:
        write_whole(path, text)
    except OSError as error:
        raise LogError(
            f"{path}: cannot be written: {error.strerror}; name another file with --page"
        ) from None


def _axes(plan: Plan, rows: Sequence[Row]) -> Iterator[Html]:
    for name, axis in plan.settings.axes.items():
        rates = by_value(name, axis, rows)
        yield intervals(name, rates)
        yield tag("details", tag("summary", "Figures"), table(HEAD, (each.cells for each in rates)))


def _distributions(plan: Plan, rows: Sequence[Row]) -> Iterator[Html]:
    """Yield the histogram of each metric that was measured and is not the same in all rows."""
    for name, metric in METRICS.items():
        measured = [row for row in rows if row[name] is not None]
        good, bad = (
            np.array([row[name] for row in measured if row["passed"] is passed], float)
            for passed in (True, False)
        )
        limit = plan.settings.kept.get(name)
        if name != "faulted" and len({row[name] for row in measured}) > (limit is None):
            unit = "" if name in COUNTS else metric.unit
            yield histogram(f"{name}, {metric.meaning}", unit, good, bad, limit)
