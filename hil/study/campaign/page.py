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
from hil.study.campaign.rates import by_value, causes, judged, shown, why, worst
from hil.study.campaign.show import HEAD, cells, rerun_command
from hil.study.report.html import Html, table, tag
from hil.study.report.page import document

WORST = 25
"""Failed rows on the page."""


def write_page(path: Path, plan: Plan, summary: dict[str, Any], folder: Path | None = None) -> None:
    """Write the page, over an earlier one; `folder`: that of --out. Raises LogError: it cannot be written."""
    rows, limits = summary["matrix"], plan.subject.limits
    low, high = summary["failed_interval_percent"]
    verdict = tag(
        "p",
        f"{summary['failed']} of {summary['rows']} rows failed: {summary['failed_percent']:.3g} %, "
        f"95 % interval {low:.3g} to {high:.3g} %",
        class_="verdict good" if summary["success"] else "verdict bad",
    )
    head = tag("header", tag("h1", f"Campaign {plan.name}"), tag("p", plan.settings.description))
    body = [
        head,
        verdict,
        tag("h2", "Limits"),
        table(("metric", "least", "most", "unit", "meaning"), _limits(plan), "what every row has to keep"),
        tag("h2", "By axis"),
        *_axes(plan, rows),
        tag("h2", "Distributions"),
        *_distributions(plan, rows),
    ]
    failed = worst(rows, limits, WORST)
    if failed:
        counts = table(("cause", "rows"), causes(rows))
        body += [tag("h2", "Worst rows"), counts, _worst(plan, failed, folder)]
    body.append(tag("p", "Wilson's interval takes rows as independent draws.", class_="note"))
    text = document(f"Campaign {plan.name}", [tag("main", *body)], ("report.css",))
    try:
        write_whole(path, text)
    except OSError as error:
        raise LogError(
            f"{path}: cannot be written: {error.strerror}; name another file with --page"
        ) from None


def _limits(plan: Plan) -> Iterator[tuple[object, ...]]:
    for name in judged(plan.subject.limits):
        limit, metric = plan.subject.limits[name], METRICS[name]
        ends = ("" if end is None else f"{end:g}" for end in (limit.min, limit.max))
        yield name, *ends, metric.unit, metric.meaning


def _axes(plan: Plan, rows: Sequence[Row]) -> Iterator[Html]:
    for name, axis in plan.subject.axes.items():
        rates = by_value(name, axis, rows)
        yield intervals(name, rates)
        yield tag("details", tag("summary", "Figures"), table(HEAD, map(cells, rates)))


def _distributions(plan: Plan, rows: Sequence[Row]) -> Iterator[Html]:
    """Yield the histogram of each metric that was measured and is not the same in all rows."""
    for name, metric in METRICS.items():
        parts = [
            np.array([r[name] for r in rows if r[name] is not None and r["passed"] is good], float)
            for good in (True, False)
        ]
        values = np.concatenate(parts)
        limit = plan.subject.limits.get(name)
        if name != "faulted" and len(values) and (limit is not None or np.ptp(values) > 0.0):
            unit = "" if name in COUNTS else metric.unit
            yield histogram(f"{name}, {metric.meaning}", unit, parts[0], parts[1], limit)


def _worst(plan: Plan, rows: Sequence[Row], folder: Path | None) -> Html:
    axes = list(plan.subject.axes)
    lines = [
        (
            row["row"],
            why(row, plan.subject.limits),
            *(shown(row[name]) for name in axes),
            tag("code", rerun_command(plan, row["row"], folder)),
        )
        for row in rows
    ]
    return table(("row", "why", *axes, "run it again, recorded"), lines)
