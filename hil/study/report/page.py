"""Builds the report page: one HTML file that contains its styles, scripts and numbers, and loads nothing.

Its content security policy allows only the scripts below, by their checksums. All text is escaped, except
what `tag` has made.
"""

import base64
import hashlib
import importlib.resources
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array, Rows
from hil.app.configuration.configuration import Configuration
from hil.app.watch.state import robot_description
from hil.study.log_columns import has_pose, titled
from hil.study.report.charts import Chart, followed

STYLES = ("uPlot.min.css", "page.css")
SCRIPTS = ("uPlot.iife.min.js", "charts.js", "scene.js", "report.js")
LICENCE = "uPlot-LICENSE.txt"
BINS = 2000
"""Bins of a thinned curve, more than a screen has pixels across."""
FRAMES = 1500
"""Largest number of poses; the page interpolates between them."""
SHARED = {"page.css", "charts.js", "scene.js", "uPlot.iife.min.js", "uPlot.min.css", LICENCE}


class Html(str):
    """Finished HTML; any text of a log in it is escaped."""

    __slots__ = ()


def tag(name: str, *content: object, **attributes: object) -> Html:
    """HTML element; content that is not Html is escaped. `class_` means class, `data_x` means data-x."""
    given = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(str(value), quote=True)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Html(f"<{name}{given}>{joined(content)}</{name}>")


def joined(content: Iterable[object]) -> Html:
    """HTML of several contents in a row; contents that are not Html are escaped."""
    return Html("".join(x if isinstance(x, Html) else escape(str(x), quote=True) for x in content))


def prose(text: str) -> Html:
    """Text as HTML: escaped, with parts between backticks as code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:
        return joined([text])
    return joined(tag("code", part) if k % 2 else part for k, part in enumerate(parts))


def table(head: Iterable[object], rows: Iterable[Iterable[object]], caption: str = "") -> Html:
    """HTML table in a scrolling box; the first cell of each row is its heading."""
    _, *names = head = list(head)  # a narrow screen shows the name beside each value
    lines = [
        tag(
            "tr",
            tag("th", first, scope="row"),
            *(tag("td", x, data_label=n) for n, x in zip(names, rest, strict=True)),
        )
        for first, *rest in rows
    ]
    top = tag("thead", tag("tr", *(tag("th", cell, scope="col") for cell in head)))
    title = [tag("caption", caption)] if caption else []
    return tag("div", tag("table", *title, top, tag("tbody", *lines)), class_="scroll", tabindex=0)


def asset(name: str) -> str:
    """Text of a style sheet or script of the report, or of one shared with the page of `hil watch`."""
    room = "hil.app.watch" if name in SHARED else "hil.study.report"
    return importlib.resources.files(room).joinpath("assets", name).read_text("utf-8")


def page(title: str, body: Sequence[Html], data: dict[str, Any]) -> str:
    """Complete HTML text of the report page; data: plain values that the scripts draw."""
    licence = tag(
        "details", tag("summary", "Licence of uPlot, which draws the curves"), tag("pre", asset(LICENCE))
    )
    numbers = tag("script", Html(as_script(data)), type="application/json", id="data")
    scripts = [asset(name) for name in SCRIPTS]
    main = tag("main", *body, class_="page")
    beside = tag("div", contents(main), main, class_="beside")
    return document(title, [beside, tag("footer", licence), numbers], STYLES, scripts)


def contents(main: Html) -> Html:
    """Table of contents: links to the sections of a page that have a heading."""
    found = re.findall(r'<section id="([^"]*)">\s*<h2>(.*?)</h2>', main)
    links = (tag("a", Html(title), href=f"#{key}") for key, title in found)
    return tag("nav", *links, class_="contents", aria_label="contents")


def document(title: str, body: Sequence[Html], styles: Sequence[str], scripts: Sequence[str] = ()) -> str:
    """HTML text of a page with these assets as styles and these scripts at its end; it loads nothing."""
    sums = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    allowed = " ".join(f"'sha256-{each}'" for each in sums) or "'none'"
    policy = f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:"
    policy += "; base-uri 'none'; form-action 'none'"
    head = [
        Html('<meta charset="utf-8">'),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
        Html('<meta name="viewport" content="width=device-width, initial-scale=1">'),
        Html('<link rel="icon" href="data:,">'),
        tag("title", title),
        *(tag("style", Html(asset(name))) for name in styles),
    ]
    code = [tag("script", Html(script)) for script in scripts]
    whole = joined([tag("head", *head), tag("body", *body, *code)])
    return f"<!doctype html>\n{tag('html', whole, lang='en')}\n"


def as_script(data: dict[str, Any]) -> str:
    """Data as JSON text that cannot end the HTML script element around it."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def drawn(charts: Sequence[Chart], t: Array) -> list[dict[str, Any]]:
    """Charts as plain values for the scripts, thinned to the resolution of a screen; t (n,) s."""
    found = []
    for chart in charts:
        x, series = thin(t, [curve.values for curve in chart.curves])
        pairs = zip(chart.curves, series, strict=True)
        curves = [curve._asdict() | {"values": packed(values)} for curve, values in pairs]
        found.append(chart._asdict() | {"t": packed(x), "curves": curves})
    return found


def figure(chart: Chart, t: Array) -> Html:
    """HTML of a chart's place, with a table of its curves' extremes for readers who cannot see it."""
    title = titled(chart.title, chart.unit)
    columns = [" ", tag("code", chart.columns)] if chart.columns else []
    caption = tag("figcaption", tag("span", title, *columns))
    named = {"data_key": chart.key, "aria_label": title}
    place = tag("div", class_="chart", tabindex=0, role="application", **named)
    if chart.names:
        return tag("figure", caption, place)
    rows = []
    for curve in chart.curves:
        finite = np.flatnonzero(np.isfinite(curve.values))
        if len(finite):
            y = curve.values[finite]
            low, high = finite[int(np.argmin(y))], finite[int(np.argmax(y))]
            ends = (f"{curve.values[k]:.5g} at {t[k]:.3f} s" for k in (low, high))
            rows.append((curve.label, *ends, f"{float(np.sqrt(np.mean(y**2))):.5g}"))
    numbers = tag("details", tag("summary", "Extremes"), table(("curve", "least", "largest", "rms"), rows))
    return tag("figure", caption, place, numbers)


def curves(shown: Sequence[Chart], t: Array, note: str, more: Mapping[str, Sequence[Html]]) -> list[Html]:
    """Sections of a page with charts, in their order; the first has a note, others have more content."""
    made = []
    for n, name in enumerate(dict.fromkeys(chart.section for chart in shown)):
        places = (figure(chart, t) for chart in shown if chart.section == name)
        parts = (*[tag("p", note, class_="note")] * (n == 0), tag("div", *places, class_="curves"))
        made.append(tag("section", tag("h2", name), *parts, *more.get(name, ()), id=f"curves-{n}"))
    return made


def thin(t: Array, series: list[Array], bins: int = BINS) -> tuple[Array, list[Array]]:
    """Thin each series to two samples per bin, its minimum and its maximum in the bin.

    t (n,) s; each of series (n,). Up to 2 bins samples are returned unchanged. A bin has two instants, those
    of its first and its middle sample; the minimum comes first if the series rises across the bin. NaN
    remains only if a whole bin is NaN.
    """
    n = len(t)
    if n <= 2 * bins:
        return t, series
    starts = np.linspace(0, n, bins + 1).astype(np.int64)
    first, last = starts[:-1], starts[1:] - 1
    x = np.stack((t[first], t[(first + last + 1) // 2]), axis=1).ravel()
    thinned = []
    for y in series:
        low, high = np.fmin.reduceat(y, first), np.fmax.reduceat(y, first)
        pair, falls = np.stack((low, high), axis=1), y[first] > y[last]
        pair[falls] = pair[falls, ::-1]
        thinned.append(pair.ravel())
    return x, thinned


def packed(values: ArrayLike) -> str:
    """Any array as little-endian float32 in base 64, row by row; non-finite values become NaN."""
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = np.asarray(values, np.float64).astype("<f4").ravel()
    narrow[~np.isfinite(narrow)] = np.nan
    return base64.b64encode(narrow.tobytes()).decode("ascii")


def scene(rows: Rows, t: Array, c: Configuration) -> dict[str, Any] | None:
    """Joints, poses and leg forces for the 3D view of the page; None if the log has no pose.

    t (n,) s. p (m, 3) m and R (m, 9) of platform and reference in the base frame; load (m, 6): tau as a share
    of the largest allowed force.
    """
    posed = np.flatnonzero(has_pose(rows, "p", "R"))
    if not len(posed):
        return None
    kept = posed[np.unique(np.linspace(0, len(posed) - 1, FRAMES).astype(np.int64))]
    robot = robot_description(c)
    led = followed(rows)[kept][:, None]
    return robot | {
        "t": packed(t[kept]),
        **{name: packed(rows[name][kept]) for name in ("p", "R")},
        **{
            name: packed(np.where(led, rows[name][kept].reshape(len(kept), -1), 0.0))
            for name in ("p_d", "R_d")
        },
        "load": packed(rows["tau"][kept] / robot["force_limit_N"]),
    }
