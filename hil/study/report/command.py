"""`hil report`: writes one HTML page about the run in a log."""

import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.can.bus_time import BitTiming
from drivers.errors import ConfigurationError, LogError
from hil.app.configuration.configuration import Configuration, loads
from hil.app.files import new_file, printable, write_whole
from hil.app.output import figure_rows
from hil.app.readable import Readable, readable
from hil.app.replay import refuse_unread, run_of
from hil.app.run.stretching import stretches
from hil.record.figures import figures
from hil.record.log import Log
from hil.record.schema import IDENTITY
from hil.study.log_columns import seconds
from hil.study.report import sections
from hil.study.report.charts import MODES, Chart, charts
from hil.study.report.comparison import Side, comparison
from hil.study.report.margins import margins
from hil.study.report.page import Html, asset, drawn, figure, page, scene, tag
from hil.study.report.story import Failure, failure_of
from hil.study.report.timing import counts, spreads, traffic


class _Run(NamedTuple):
    """Run of a log, as far as it can be read."""

    path: Path
    found: Readable
    c: Configuration | None
    why_not: str
    """Why there is no configuration."""
    story: Failure
    rate_Hz: float


def report(
    path: Path, other: Path | None = None, *, out: Path | None = None, force: bool = False
) -> dict[str, Any]:
    """Write the HTML page about the run in a log, or about two runs side by side; return the summary.

    Raises LogError: not a log of `hil run` or `hil sim`, columns of another version, no tick, or `out` exists
    and `force` is not set.
    """
    begun = time.perf_counter()
    target = new_file(path.with_suffix(".html") if out is None else out, force=force)
    with np.errstate(all="ignore"):  # a log may hold any number
        run, second = _read(path), None if other is None else _read(other)
        text = _page(*run) if second is None else comparison(_side(run), _side(second))
    try:
        write_whole(target, text)
    except OSError as error:
        raise LogError(f"--out {target}: cannot be written: {error.strerror}") from None
    return {
        "success": True,
        "kind": "report",
        "log": str(path),
        "remark": "; ".join(filter(None, (run.found.remark, run.why_not))) or None,
        "went_wrong": run.story.headline or None,
        "size_MB": len(text.encode()) * 1e-6,
        "wall_s": time.perf_counter() - begun,
        "page": str(target),
    }


def _read(path: Path) -> _Run:
    found = readable(path)
    rate_Hz = run_of(found.log, path, ["rate_Hz"])["rate_Hz"]
    refuse_unread(found.log)
    if not len(found.rows):
        raise LogError("; ".join(filter(None, (f"{path}: has no tick to report", found.remark))))
    c, why_not = _configuration(found.log)
    return _Run(path, found, c, why_not, failure_of(found.log.metadata, found.rows, rate_Hz), rate_Hz)


def _side(run: _Run) -> Side:
    log, rows, remark = run.found
    title = _subtitle(log, rows, run.c, run.rate_Hz)
    verdict = "; ".join(filter(None, (run.story.headline, remark)))
    return Side(printable(run.path.name), title, verdict, rows, run.c, run.rate_Hz)


def _configuration(log: Log) -> tuple[Configuration | None, str]:
    """(configuration of the run, ""), or (None, reason) if the log's configuration cannot be read."""
    try:
        return loads(log.configuration, f"{log.path}:config.yaml", files=log.attachments), ""
    except (LogError, ConfigurationError) as error:
        first = str(error).partition("\n")[0]
        return None, f"no limits, bus load and 3D view, because the configuration cannot be read: {first}"


def _page(
    path: Path, found: Readable, c: Configuration | None, why_not: str, story: Failure, rate_Hz: float
) -> str:
    log, rows, remark = found
    events = log.events()
    t, name = seconds(rows), printable(path.name)
    timings = [] if c is None or c.bus.layout == "ideal" else [BitTiming.of(each) for each in c.bus.buses]
    bus = traffic(log, rows, timings)
    shown = charts(rows, c, bus, rate_Hz)
    moving = None if c is None else scene(rows, t, c)
    stood = figure_rows(stretches(rows["stretched_ns"])) if rows["stretched_ns"].any() else []
    body = [
        tag("header", tag("h1", name), tag("p", _subtitle(log, rows, c, rate_Hz))),
        sections.opening(story, rows, remark),
        *([sections.what_went_wrong(story)] if story.headline else []),
        sections.limits([] if c is None else margins(rows, c, rate_Hz), t, why_not),
        *([Html(asset("pose.html"))] if moving is not None else []),
        *_curves(shown, t, sections.modes(rows, t, events)),
        sections.timing(log, spreads(rows, bus.answered_ns), counts(rows), stood),
        sections.figures(figure_rows(figures(rows))),
    ]
    first = [each.time_s for each in story.findings if each.time_s is not None]
    data = {"charts": drawn(shown, t), "scene": moving, "end": float(t[-1]), "start": min(first, default=0.0)}
    return page(f"{name}: {story.headline or 'report'}", body, data)


def _subtitle(log: Log, rows: Rows, c: Configuration | None, rate_Hz: float) -> str:
    started = datetime.fromtimestamp((log.epoch_ns + int(rows["t_ns"][0])) // 1_000_000_000, UTC)
    words = [
        f"hil {log.metadata[IDENTITY]['kind']}",
        "" if c is None else c.name,
        "" if c is None else f"law {c.controller.law}",
        f"{rate_Hz:g} Hz",
        "simulated time" if log.lockstep else f"real time, begun {started:%Y-%m-%dT%H:%M:%SZ}",
    ]
    return ", ".join(filter(None, words))


def _curves(shown: Sequence[Chart], t: Array, modes: Sequence[Html]) -> list[Html]:
    """Sections of the page with charts, in their order; the tables of modes follow the charts of modes."""
    hint = (
        "All curves share one time axis. Drag to zoom, double click to see all. Arrows move the cursor, "
        "+ and - zoom, Shift with arrows pans, 0 shows all. A name below a chart shows or hides its curve. "
        "CSV and PNG download what is in view. Errors are reference minus measurement."
    )
    made = []
    for n, name in enumerate(dict.fromkeys(chart.section for chart in shown)):
        figures = [figure(chart, t) for chart in shown if chart.section == name]
        note = [tag("p", hint, class_="note")] * (n == 0)
        curves = tag("div", *figures, class_="curves")
        more = modes if name == MODES else ()
        made.append(tag("section", tag("h2", name), *note, curves, *more, id=f"curves-{n}"))
    return made
