"""Page with two runs side by side: figures, configurations, one column over the other."""

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.arrays import Array
from hil.app.configuration.changes import differences
from hil.app.configuration.configuration import Configuration
from hil.app.output import figure_rows
from hil.record.figures import figures
from hil.study.report.charts import Chart, Curve, columns_over_time
from hil.study.report.page import Html, curves, drawn, page, table, tag
from hil.study.report.run import Run


def comparison(one: Run, other: Run) -> str:
    """HTML text of the page about two runs."""
    t, shown = overlaid(one, other)
    head = ("figure", one.name, other.name)
    runs = [("run", one.title, other.title), ("verdict", one.verdict, other.verdict)]
    body = [
        tag("header", tag("h1", f"{one.name} and {other.name}")),
        tag("section", tag("h2", "Two runs"), table(head, runs), id="runs"),
        tag("section", tag("h2", "Figures"), table(head, _figures(one, other)), id="figures"),
        tag("section", tag("h2", "Configuration"), *_differences(head, one.c, other.c), id="configuration"),
    ]
    note = f"Solid: {one.name}; dotted: {other.name}. Time 0 is the begin of TRACKING."
    body += curves(shown, t, note, {})
    return page(f"{one.name} and {other.name}", body, {"charts": drawn(shown, t), "scene": None})


def _figures(one: Run, other: Run) -> Iterator[tuple[str, ...]]:
    """Figures of both runs, by the path of their names."""
    sides = [dict(_named(figure_rows(figures(side.rows)))) for side in (one, other)]
    for name in dict.fromkeys([*sides[0], *sides[1]]):
        yield name, *(side.get(name, "") for side in sides)


def _named(rows: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Rows with a value; the name of an indented row begins with that of the row above it."""
    group = ""
    for name, value in rows:
        if not name.startswith(" "):
            group = name
        if value:
            yield (f"{group}: {name.strip()}" if name.startswith(" ") else name), value


def _differences(head: Sequence[str], one: Configuration | None, other: Configuration | None) -> list[Html]:
    if one is None or other is None:
        return [tag("p", "One of the configurations cannot be read.")]
    different = [
        (key, *("–" if value is None else str(value) for value in values))
        for key, *values in differences(one, other)
    ]
    return [table(("key", *head[1:]), different)] if different else [tag("p", "Equal in every key.")]


def overlaid(one: Run, other: Run) -> tuple[Array, list[Chart]]:
    """Time (n,), s, and the charts that both runs have, with the curves of both."""
    first, last = min(one.t[0], other.t[0]), max(one.t[-1], other.t[-1])
    t = first + np.arange(round((last - first) * one.rate_Hz) + 1) / one.rate_Hz
    mine, theirs = (
        {chart.key: chart for chart in columns_over_time(s.rows, s.c, s.rate_Hz)} for s in (one, other)
    )
    found = []
    for key in mine.keys() & theirs.keys():
        first_run, second_run = _curves(t, one, mine[key]), _curves(t, other, theirs[key])
        dotted = (c._replace(kind="dotted", label=f"{c.label}, second") for c in second_run)
        found.append(mine[key]._replace(curves=(*first_run, *dotted)))
    return t, sorted(found, key=lambda chart: list(mine).index(chart.key))


def _curves(t: Array, side: Run, chart: Chart) -> list[Curve]:
    """Solid curves of a chart at the times t (n,); references and reported forces are left out."""
    kept = (curve for curve in chart.curves if curve.kind == "line")
    return [c._replace(values=_at(t, side, c.values), hue=k) for k, c in enumerate(kept)]


def _at(t: Array, side: Run, values: Array) -> Array:
    """Values (m,) of the rows that are nearest to the times t (n,), within a period; NaN elsewhere."""
    own = side.t
    k = np.clip(np.searchsorted(own, t - 0.5 / side.rate_Hz), 0, len(own) - 1)
    return np.where(np.abs(own[k] - t) <= 0.51 / side.rate_Hz, values[k], np.nan)
