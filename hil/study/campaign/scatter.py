"""Plots of a campaign's page: every figure over every swept value, one dot a row, with quantiles."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from drivers.arrays import Array, Flags
from hil.study.campaign.figures import METRICS
from hil.study.campaign.parquet import Row
from hil.study.campaign.rates import BINS, shown
from hil.study.log_columns import titled
from hil.study.report.page import Html, table, tag

QUANTILES = (0.1, 0.5, 0.9)
HEAD = ("figure", "least", "10 %", "median", "90 %", "largest")
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 236, 4, 124
"""Frame of a plot, in units of its drawing of 240 x 150."""


def plots(axes: Sequence[str], rows: Sequence[Row]) -> Iterator[Html]:
    """Table of the quantiles of the figures that vary, and their plots over each axis."""
    measured = {
        name: np.array([np.nan if row[name] is None else float(row[name]) for row in rows])
        for name in METRICS
    }
    varied = {name: y for name, y in measured.items() if len(np.unique(y[np.isfinite(y)])) > 1}
    spreads = {name: np.nanquantile(y, (0.0, *QUANTILES, 1.0)).tolist() for name, y in varied.items()}
    cells = [(titled(name, METRICS[name].unit), *map(shown, spread)) for name, spread in spreads.items()]
    yield table(HEAD, cells, "quantiles over all rows, of the figures that vary")
    note = "A dot is a row, red if it failed. Lines: 10 %, 50 % and 90 % of the rows near a value."
    yield tag("p", note, class_="note")
    passed = np.array([bool(row["passed"]) for row in rows])
    for axis in axes:
        x, ends = _numbers([row[axis] for row in rows])
        yield tag("h3", f"over {axis}")
        yield tag("div", *(_plot(name, x, y, passed, ends) for name, y in varied.items()), class_="scatter")


def _numbers(values: Sequence[Any]) -> tuple[Array, tuple[str, str]]:
    """Swept values as numbers, other values by their place in a list; and the names of both ends."""
    if not all(isinstance(value, int | float) for value in values):
        names = sorted({shown(value) for value in values})
        return np.array([names.index(shown(value)) for value in values], np.float64), (names[0], names[-1])
    return np.array(values, np.float64), (shown(min(values)), shown(max(values)))


def _places(values: Array, start: float, end: float) -> Array:
    """Places of values between start and end, with a little room at both."""
    low, span = values.min(), np.ptp(values) or 1.0
    places: Array = start + (end - start) * (0.05 + 0.9 * (values - low) / span)
    return places


def _plot(name: str, x: Array, y: Array, passed: Flags, ends: tuple[str, str]) -> Html:
    there, title = np.isfinite(y), titled(name, METRICS[name].unit)
    across, up, good = _places(x, _LEFT, _RIGHT)[there], _places(y[there], _BOTTOM, _TOP), passed[there]
    lines = {
        "box": f"M{_LEFT} {_TOP}V{_BOTTOM}H{_RIGHT}",
        "pass": _dots(across[good], up[good]),
        "fail": _dots(across[~good], up[~good]),
        "quantile": _quantiles(across, up),
    }
    low, high = shown(float(np.nanmin(y))), shown(float(np.nanmax(y)))
    numbers = [(_LEFT - 3, _TOP + 8, "end", high), (_LEFT - 3, _BOTTOM, "end", low)]
    numbers += [(_LEFT, _BOTTOM + 12, "start", ends[0]), (_RIGHT, _BOTTOM + 12, "end", ends[1])]
    parts = [tag("path", class_=kind, d=path) for kind, path in lines.items()]
    parts += [tag("text", text, x=at, y=down, text_anchor=side) for at, down, side, text in numbers]
    svg = tag("svg", *parts, viewBox="0 0 240 150", role="img", aria_label=title)
    return tag("figure", tag("figcaption", title), svg)


def _dots(x: Array, y: Array) -> str:
    """Path with a dot at each place."""
    return "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x.tolist(), y.tolist(), strict=True))


def _quantiles(x: Array, y: Array) -> str:
    """Path with the quantiles of y of each x, or of each quarter of the rows if x has many values."""
    order = np.argsort(x, kind="stable")
    edges = np.flatnonzero(np.diff(x[order])) + 1
    parts = np.split(order, edges) if len(edges) < BINS else np.array_split(order, BINS)
    found = []
    for part in parts:
        for level in np.quantile(y[part], QUANTILES).tolist():
            found.append(f"M{x[part[0]] - 4:.1f} {level:.1f}H{x[part[-1]] + 4:.1f}")
    return "".join(found)
