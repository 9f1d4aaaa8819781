"""The page: one HTML file with its styles, scripts and numbers in it, that fetches nothing.

Its content security policy allows the scripts below by their checksums and nothing else.
"""

import base64
import hashlib
import importlib.resources
import json
from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np

from drivers.arrays import Array
from hil.study.report.charts import Chart
from hil.study.report.html import Html, joined, table, tag
from hil.study.report.samples import packed, thin

STYLES = ("uPlot.min.css", "report.css")
SCRIPTS = ("uPlot.iife.min.js", "scene.js", "report.js")
LICENCE = "uPlot-LICENSE.txt"
SHARED = {"scene.js", "uPlot.iife.min.js", "uPlot.min.css", LICENCE}


def asset(name: str) -> str:
    """Content of a file of the report's assets, or of those that the live page has, too."""
    room = "hil.app.watch" if name in SHARED else "hil.study.report"
    return importlib.resources.files(room).joinpath("assets", name).read_text("utf-8")


def page(title: str, body: Sequence[Html], data: dict[str, Any]) -> str:
    """Return the whole file. data: what the scripts draw, plain values."""
    licence = tag(
        "details", tag("summary", "Licence of uPlot, which draws the curves"), tag("pre", asset(LICENCE))
    )
    numbers = tag("script", Html(as_script(data)), type="application/json", id="data")
    scripts = [asset(name) for name in SCRIPTS]
    return document(title, [tag("main", *body), tag("footer", licence), numbers], STYLES, scripts)


def document(title: str, body: Sequence[Html], styles: Sequence[str], scripts: Sequence[str] = ()) -> str:
    """Return a file with these assets as styles and these scripts at its end; it fetches nothing."""
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
    """Return JSON that cannot end the script element that it stands in."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def drawn(charts: Sequence[Chart], t: Array) -> list[dict[str, Any]]:
    """Return the charts as the scripts read them, thinned out to what a screen can show. t (n,) s."""
    found = []
    for chart in charts:
        x, series = thin(t, [curve.values for curve in chart.curves])
        found.append(
            {
                "key": chart.key,
                "title": chart.title,
                "unit": chart.unit,
                "t": packed(x),
                "curves": [
                    {"label": curve.label, "kind": curve.kind, "values": packed(values)}
                    for curve, values in zip(chart.curves, series, strict=True)
                ],
                "levels": [level for level in chart.levels if isfinite(level)],
                "names": [list(each) for each in chart.names],
            }
        )
    return found


def figure(chart: Chart, t: Array) -> Html:
    """Return the place of a chart, with the extremes of its curves as a table for who cannot see it."""
    unit = f" [{chart.unit}]" if chart.unit else ""
    caption = tag("figcaption", chart.title + unit)
    place = tag(
        "div",
        class_="chart",
        data_key=chart.key,
        tabindex=0,
        role="application",
        aria_label=f"{chart.title}{unit}",
    )
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
