"""`hil report`: writes one HTML page about the run in a log."""

import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.can.bus_time import BitTiming
from drivers.config import UDP
from hil.app.files import new_file, write_whole
from hil.app.output import figure_rows
from hil.app.run.stretching import stretches
from hil.record.figures import figures
from hil.study.log_columns import seconds
from hil.study.report import sections
from hil.study.report.charts import MODES, charts
from hil.study.report.comparison import comparison
from hil.study.report.margins import margins
from hil.study.report.page import Html, asset, curves, drawn, page, scene, tag
from hil.study.report.run import Run, read
from hil.study.report.timing import counts, spreads, traffic

HINT = (
    "All curves share one time axis. Drag to zoom, double click to see all. Arrows move the cursor, "
    "+ and - zoom, Shift with arrows pans, 0 shows all. A name below a chart shows or hides its curve. "
    "CSV and PNG download what is in view. Errors are reference minus measurement."
)


def report(
    path: Path, other: Path | None = None, *, out: Path | None = None, force: bool = False
) -> dict[str, Any]:
    """Write the HTML page about the run in a log, or about two runs side by side; return the summary.

    Raises LogError: not a log of `hil run` or `hil sim`, columns of another version, no tick, or `out` exists
    and `force` is not set; OSError: `out` cannot be written.
    """
    begun = time.perf_counter()
    target = new_file(path.with_suffix(".html") if out is None else out, force=force)
    with np.errstate(all="ignore"):  # a log may hold any number
        run = read(path)
        text = _page(run) if other is None else comparison(run, read(other))
    write_whole(target, text)
    return {
        "success": True,
        "kind": "report",
        "log": str(path),
        "remark": "; ".join(filter(None, (run.remark, run.why_not))) or None,
        "went_wrong": run.story.headline or None,
        "size_MB": len(text.encode()) * 1e-6,
        "wall_s": time.perf_counter() - begun,
        "page": str(target),
    }


def _page(run: Run) -> str:
    log, rows, c, story = run.log, run.rows, run.c, run.story
    events, t = log.events(), seconds(rows)
    timings = [
        None if each.interface == UDP else BitTiming.of(each)
        for each in (() if c is None or c.bus.layout == "ideal" else c.bus.buses)
    ]
    bus = traffic(log, rows, timings)
    shown = charts(rows, c, bus, run.rate_Hz)
    moving = None if c is None else scene(rows, t, c)
    stood = figure_rows(stretches(rows["stretched_ns"])) if rows["stretched_ns"].any() else []
    body = [
        tag("header", tag("h1", run.name), tag("p", run.title)),
        sections.opening(story, rows, run.remark),
        *([sections.what_went_wrong(story)] if story.headline else []),
        sections.limits([] if c is None else margins(rows, c, run.rate_Hz), t, run.why_not),
        *([Html(asset("pose.html"))] if moving is not None else []),
        *curves(shown, t, HINT, {MODES: sections.modes(rows, t, events)}),
        sections.timing(log, spreads(rows, bus.answered_ns), counts(rows), stood),
        sections.figures(figure_rows(figures(rows))),
    ]
    first = [each.time_s for each in story.findings if each.time_s is not None]
    data = {"charts": drawn(shown, t), "scene": moving, "end": float(t[-1]), "start": min(first, default=0.0)}
    return page(f"{run.name}: {story.headline or 'report'}", body, data)
