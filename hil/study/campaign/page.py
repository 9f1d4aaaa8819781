"""A campaign as one HTML page without scripts: limits, rates, the worst rows."""

from pathlib import Path
from typing import Any

from drivers.errors import LogError
from hil.app.files import write_whole
from hil.study.campaign.figures import METRICS
from hil.study.campaign.plan import Plan
from hil.study.campaign.rates import HEAD, by_value
from hil.study.campaign.show import worst_lines
from hil.study.report.page import document, table, tag

WORST = 25
"""Failed rows on the page."""


def write_page(path: Path, plan: Plan, summary: dict[str, Any], folder: Path | None = None) -> None:
    """Write the page, over an earlier one; `folder`: that of --out. Raises LogError: it cannot be written."""
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
        table(("metric", "allowed", "unit", "meaning"), kept, "what every row has to keep"),
        tag("h2", "By axis"),
        *(
            table(HEAD, (each.cells for each in by_value(name, axis, summary["matrix"])), name)
            for name, axis in plan.settings.axes.items()
        ),
        tag("p", "Wilson's interval takes rows as independent draws.", class_="note"),
    ]
    if summary["failed"]:
        lines = worst_lines(plan, summary, folder, WORST)
        worst = tag("div", tag("pre", "\n".join(lines)), class_="scroll", tabindex=0)
        body += [tag("h2", "Worst rows"), worst]
    text = document(f"Campaign {plan.name}", [tag("main", *body)], ("report.css",))
    try:
        write_whole(path, text)
    except OSError as error:
        raise LogError(
            f"{path}: cannot be written: {error.strerror}; name another file with --page"
        ) from None
