"""Two pictures as SVG: a distribution with its limits, and pass rates with their intervals."""

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array
from hil.study.campaign.rates import Rate
from hil.study.campaign.settings import Limit
from hil.study.report.html import Html, tag

_WIDTH, _LEFT, _RIGHT = 640, 200, 20
_LEAST = 560
"""A drawing on a narrower screen scrolls, so that its letters stay legible."""
_GOOD, _BAD, _LINE, _INK = "#2e7d32", "#b3261e", "#d7dce2", "#1c2733"
_BINS = 30


def histogram(title: str, unit: str, good: Array, bad: Array, limit: Limit | None) -> Html:
    """Return the distribution of a metric: rows that pass (n,) and rows that fail (m,), stacked."""
    values = np.concatenate([good, bad])
    marks = [] if limit is None else [x for x in (limit.min, limit.max) if x is not None]
    low, high = float(min([*values, *marks])), float(max([*values, *marks]))
    if high <= low:
        high = low + (abs(low) or 1.0)
    edges = np.linspace(low, high, _BINS + 1)
    counts = [np.histogram(part, edges)[0] for part in (good, bad)]
    top, height = int(max(1, (counts[0] + counts[1]).max())), 140
    wide = (_WIDTH - 40 - _RIGHT) / _BINS
    parts = []
    for k in range(_BINS):
        y = 160.0
        for count, colour in zip((counts[0][k], counts[1][k]), (_GOOD, _BAD), strict=True):
            tall = height * float(count) / top
            y -= tall
            if count:
                parts.append(_rect(40 + k * wide, y, wide - 1, tall, colour))
    for x in marks:
        at = 40 + (x - low) / (high - low) * _BINS * wide
        parts += [_line(at, 15, at, 160, _BAD, dash="6 4"), _text(at, 12, f"limit {x:g}", anchor="middle")]
    parts += [
        _line(40, 160, _WIDTH - _RIGHT, 160, _INK),
        _text(36, 164, "0", anchor="end"),
        _text(36, 26, str(top), anchor="end"),
        _text(40, 178, f"{low:.4g}"),
        _text(_WIDTH - _RIGHT, 178, f"{high:.4g} {unit}", anchor="end"),
    ]
    return _figure(f"{title}: number of rows; red: failed", 190, parts)


def intervals(title: str, rates: Sequence[Rate]) -> Html:
    """Return the pass rate of each value of an axis, with its 95 % interval."""
    span = _WIDTH - _LEFT - _RIGHT
    bottom = 14 + 24 * len(rates)
    parts = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        x = _LEFT + span * share
        parts += [
            _line(x, 8, x, bottom, _LINE),
            _text(x, bottom + 16, f"{100 * share:.0f} %", anchor="middle"),
        ]
    for k, each in enumerate(rates):
        y = 22 + 24 * k
        low, high = (_LEFT + span * share for share in (each.low, each.high))
        parts.append(_text(_LEFT - 8, y + 4, each.label, anchor="end"))
        parts.append(_line(low, y, high, y, _INK))
        if each.rows:
            at = _LEFT + span * each.passed / each.rows
            parts.append(tag("circle", cx=f"{at:.1f}", cy=y, r=4, fill=_GOOD))
    return _figure(f"{title}: share of rows that pass, with 95 % intervals (Wilson)", bottom + 24, parts)


def _figure(caption: str, height: float, parts: Sequence[Html]) -> Html:
    drawing = tag(
        "svg",
        *parts,
        viewBox=f"0 0 {_WIDTH} {height}",
        width="100%",
        style=f"max-width:{_WIDTH}px;min-width:{_LEAST}px",
        role="img",
        aria_label=caption,
        font_size=11,
    )
    return tag("figure", tag("figcaption", caption), tag("div", drawing, class_="scroll", tabindex=0))


def _rect(x: float, y: float, width: float, height: float, colour: str) -> Html:
    place = {"x": f"{x:.1f}", "y": f"{y:.1f}", "width": f"{width:.1f}", "height": f"{height:.1f}"}
    return tag("rect", **place, fill=colour)


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, dash: str | None = None) -> Html:
    ends = {"x1": f"{x1:.1f}", "y1": f"{y1:.1f}", "x2": f"{x2:.1f}", "y2": f"{y2:.1f}"}
    return tag("line", **ends, stroke=colour, stroke_width=2, stroke_dasharray=dash)


def _text(x: float, y: float, words: str, anchor: str = "start") -> Html:
    return tag("text", words, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, fill=_INK)
