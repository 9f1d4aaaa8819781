"""Which of several payloads the verdict on springs is about: the worst, and what is worse yet with another.

No payload is the worst in everything: the lightest leaves the least delay to spare, the heaviest sags most.
"""

from collections.abc import Callable, Sequence
from math import inf
from typing import Any, NamedTuple

from hil.design.stability.assessment import Assessment

WORST_FIRST = ("unstable", "not proven", "conditional", "proven")


class _Figure(NamedTuple):
    name: str
    of: Callable[[dict[str, Any]], float | None]
    shown: str
    worse: int
    """1: the larger the worse, -1: the smaller."""


def _sampled(name: str) -> Callable[[dict[str, Any]], float | None]:
    return lambda figures: figures.get("sampled", {}).get(name)


_delay_margin = _sampled("delay_margin_ms")
_FIGURES = (
    _Figure("largest_pole", _sampled("largest_pole"), "largest |z| {:.4f}", 1),
    _Figure("delay_margin_ms", _delay_margin, "further delay {:.3g} ms", -1),
    _Figure("sag_mm", lambda figures: figures.get("energy", figures).get("sag_mm"), "sag {:.3g} mm", 1),
    _Figure(
        "stiffness_N_m",
        lambda figures: min(figures.get("energy", {}).get("stiffness_N_m", []), default=None),
        "stiffness {:.4g} N/m",
        -1,
    ),
    _Figure(
        "slowest_eigenvalue_1_s",
        lambda figures: figures.get("slowest_eigenvalue_1_s"),
        "slowest eigenvalue {:+.3g} 1/s",
        1,
    ),
)


def worst_of(found: Sequence[Assessment]) -> int:
    """Return which has the worst verdict, of equal ones that which bears the least delay, or the first."""

    def badness(k: int) -> tuple[int, float, float]:
        margin, pole = _delay_margin(found[k].figures), _sampled("largest_pole")(found[k].figures)
        delay = inf if margin is None else float(f"{margin:.6g}")  # the same but for rounding is equal
        return WORST_FIRST.index(found[k].status), delay, -(pole or 0.0)

    return min(range(len(found)), key=badness)


def told(chosen: Assessment, carried: str, found: Sequence[Assessment], words: Sequence[str]) -> Assessment:
    """Return the verdict with the payload that it is about, and a line of what is worse with another.

    found: the verdict with each payload, of which `words` say what it is.
    """
    worst: dict[str, Any] = {}
    more = []
    claim = f"{chosen.claim}, with {carried}"
    for figure in _FIGURES:
        values = [figure.of(one.figures) for one in found]
        known = [(figure.worse * value, k) for k, value in enumerate(values) if value is not None]
        if not known:
            continue
        of_worst, k = max(known)
        value, here = figure.worse * of_worst, figure.of(chosen.figures)
        worst[figure.name] = {"value": value, "carried": words[k]}
        shown = figure.shown.format(value)
        if here is None or figure.shown.format(here) != shown:
            more.append(f"{shown} with {words[k]}")
            if figure.name == "sag_mm" and chosen.status == "conditional":
                claim += f"; {value:.3g} mm of leg length off the set-point with {words[k]}"
    line = f"payloads       {len(found)} looked at; claim and figures are with {carried}"
    if more:
        line += f"; worse with another: {'; '.join(more)}"
    return chosen._replace(
        claim=claim,
        lines=[line, *chosen.lines],
        figures=chosen.figures | {"carried": carried, "worst": worst},
    )
