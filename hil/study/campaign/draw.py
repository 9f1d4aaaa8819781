"""Two pictures of a page: a distribution with its limits, and pass rates with their intervals."""

import base64
from collections.abc import Callable, Sequence
from html import escape
from io import BytesIO
from typing import Any

from drivers.arrays import Array
from hil.study.campaign.rates import Rate
from hil.study.campaign.settings import Limit
from hil.study.report.html import Html, tag

_GOOD, _BAD, _INK = "#2e7d32", "#b3261e", "#1c2733"


def histogram(title: str, unit: str, good: Array, bad: Array, limit: Limit | None) -> Html:
    """Return the distribution of a metric: rows that pass (n,) and rows that fail (m,), stacked."""

    def draw(axes: Any) -> None:
        axes.hist([good, bad], 30, stacked=True, color=[_GOOD, _BAD])
        for end in () if limit is None else (limit.min, limit.max):
            if end is not None:
                axes.axvline(end, color=_BAD, linestyle="--")
        axes.set(xlabel=unit, ylabel="rows")

    return _figure(f"{title}: number of rows; red: failed, dashed: its limit", 1.9, draw)


def intervals(title: str, rates: Sequence[Rate]) -> Html:
    """Return the pass rate of each value of an axis, with its 95 % interval."""

    def draw(axes: Any) -> None:
        for y, each in enumerate(rates):
            axes.plot([100.0 * each.low, 100.0 * each.high], [y, y], color=_INK)
            axes.plot([100.0 * each.passed / max(each.rows, 1)], [y], "o", color=_GOOD)
        axes.set_yticks(range(len(rates)), [each.label for each in rates], parse_math=False)
        axes.set(xlim=(0.0, 100.0), xlabel="% of the rows pass")
        axes.invert_yaxis()

    caption = f"{title}: share of rows that pass, with 95 % intervals (Wilson)"
    return _figure(caption, 0.8 + 0.3 * len(rates), draw)


def _figure(caption: str, height_in: float, draw: Callable[[Any], None]) -> Html:
    """Return a figure that holds its picture; a screen that is narrower scrolls."""
    from matplotlib import rc_context  # noqa: PLC0415 - half a second
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure, file = Figure(figsize=(6.4, height_in), layout="constrained"), BytesIO()
    draw(figure.subplots())
    with rc_context({"svg.fonttype": "none"}):
        figure.savefig(file, format="svg")
    data = base64.b64encode(file.getvalue()).decode()
    image = Html(f'<img alt="{escape(caption, quote=True)}" src="data:image/svg+xml;base64,{data}">')
    return tag("figure", tag("figcaption", caption), tag("div", image, class_="scroll", tabindex=0))
