"""Which of several payloads the verdict on springs is about: the worst, and what is worse yet with another.

No payload is the worst in everything: the lightest leaves the least delay to spare, the heaviest sags most.
"""

from collections.abc import Callable, Sequence
from math import inf
from typing import Any

import numpy as np

from hil.app.stability.wording import Assessment

WORST_FIRST = ("unstable", "not proven", "conditional", "proven")
FIGURES: tuple[tuple[str, str, Callable[..., int]], ...] = (
    ("largest_pole", "largest |z| {:.4f}", max),
    ("delay_margin_ms", "further delay {:.3g} ms", min),
    ("sag_mm", "sag {:.3g} mm", max),
    ("stiffness_N_m", "stiffness {:.4g} N/m", min),
    ("slowest_eigenvalue_1_s", "slowest eigenvalue {:+.3g} 1/s", max),
)
"""What may be worse with another payload, and which of two is."""


def worst_of(found: Sequence[Assessment]) -> int:
    """Return which has the worst verdict, of equal ones that which bears the least delay, or the first."""

    def badness(k: int) -> tuple[int, float, float]:
        margin, pole = (_figure(found[k], name) for name in ("delay_margin_ms", "largest_pole"))
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
    for name, text, worse in FIGURES:
        values = {k: value for k, one in enumerate(found) if (value := _figure(one, name)) is not None}
        if not values:
            continue
        k = worse(sorted(values, reverse=True), key=values.__getitem__)
        worst[name] = {"value": values[k], "carried": words[k]}
        shown, here = text.format(values[k]), _figure(chosen, name)
        if here is None or text.format(here) != shown:
            more.append(f"{shown} with {words[k]}")
            if name == "sag_mm" and chosen.status == "conditional":
                claim += f"; {values[k]:.3g} mm of leg length off the set-point with {words[k]}"
    line = f"payloads       {len(found)} looked at; claim and figures are with {carried}"
    if more:
        line += f"; worse with another: {'; '.join(more)}"
    figures = chosen.figures | {"carried": carried, "worst": worst}
    return chosen._replace(claim=claim, lines=[line, *chosen.lines], figures=figures)


def _figure(one: Assessment, name: str) -> float | None:
    """Return a figure wherever it stands, of six the least; None where there is none."""
    parts = [one.figures, one.figures.get("sampled", {}), one.figures.get("energy", {})]
    value = next((part[name] for part in parts if part.get(name) is not None), None)
    return None if value is None else float(np.min(value))
