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
    passed, failed = (np.histogram(part, edges)[0] for part in (good, bad))
    top = int(max(1, (passed + failed).max()))
    span = _WIDTH - 40 - _RIGHT
    wide = span / _BINS
    parts = []
    for k in range(_BINS):
        y = 160.0
        for count, colour in ((passed[k], _GOOD), (failed[k], _BAD)):
            tall = 140 * float(count) / top
            y -= tall
            parts.append(_mark("rect", x=40 + k * wide, y=y, width=wide - 1, height=tall, fill=colour))
    for x in marks:
        at = 40 + (x - low) / (high - low) * span
        parts += [_line(at, 15, at, 160, _BAD, dash="6 4"), _text(at, 12, f"limit {x:g}", "middle")]
    parts += [
        _line(40, 160, _WIDTH - _RIGHT, 160, _INK),
        _text(36, 164, "0", "end"),
        _text(36, 26, str(top), "end"),
        _text(40, 178, f"{low:.4g}"),
        _text(_WIDTH - _RIGHT, 178, f"{high:.4g} {unit}", "end"),
    ]
    return _figure(f"{title}: number of rows; red: failed", 190, parts)


def intervals(title: str, rates: Sequence[Rate]) -> Html:
    """Return the pass rate of each value of an axis, with its 95 % interval."""
    span, bottom = _WIDTH - _LEFT - _RIGHT, 14 + 24 * len(rates)
    parts = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        x = _LEFT + span * share
        parts += [_line(x, 8, x, bottom, _LINE), _text(x, bottom + 16, f"{100 * share:.0f} %", "middle")]
    for k, each in enumerate(rates):
        y = 22 + 24 * k
        parts.append(_text(_LEFT - 8, y + 4, each.label, "end"))
        parts.append(_line(_LEFT + span * each.low, y, _LEFT + span * each.high, y, _INK))
        if each.rows:
            parts.append(_mark("circle", cx=_LEFT + span * each.passed / each.rows, cy=y, r=4, fill=_GOOD))
    return _figure(f"{title}: share of rows that pass, with 95 % intervals (Wilson)", bottom + 24, parts)


def _figure(caption: str, height: float, parts: Sequence[Html]) -> Html:
    style = f"max-width:{_WIDTH}px;min-width:{_LEAST}px"
    place = {"viewBox": f"0 0 {_WIDTH} {height}", "width": "100%", "style": style, "font_size": 11}
    drawing = tag("svg", *parts, role="img", aria_label=caption, **place)
    return tag("figure", tag("figcaption", caption), tag("div", drawing, class_="scroll", tabindex=0))


def _mark(name: str, *content: object, **attributes: object) -> Html:
    """Return an element of a drawing; its places to a tenth."""
    rounded = {key: f"{x:.1f}" if isinstance(x, float) else x for key, x in attributes.items()}
    return tag(name, *content, **rounded)


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, dash: str | None = None) -> Html:
    return _mark("line", x1=x1, y1=y1, x2=x2, y2=y2, stroke=colour, stroke_width=2, stroke_dasharray=dash)


def _text(x: float, y: float, words: str, anchor: str = "start") -> Html:
    return _mark("text", words, x=x, y=y, text_anchor=anchor, fill=_INK)
