"""Curves over time in panels, with Matplotlib."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import LogError
from hil.app.files import made_whole

STYLES = ("-", "--", ":", "-.")
"""Of the logs, in their order."""
LARGEST = 1e300
"""Matplotlib lays out axes for numbers up to this; larger ones are not drawn, as what is not finite."""
_PANEL_IN = 2.8


class Curve(NamedTuple):
    """One number of one log over time."""

    label: str
    log: int
    """Which of the logs, from 0."""
    t: Array
    """(n,) s since the first tick."""
    values: Array
    """(n,)."""
    unit: str
    """Empty where there is none."""
    names: Mapping[str, int]
    """Of the values; empty where they have none."""
    flags: bool
    """The names are of bits, of which a value may have several."""
    prefix: str = ""
    """Of the label, for the log."""


def draw(
    titles: Sequence[str],
    panels: Sequence[Sequence[Curve]],
    path: Path,
    title: str,
    *,
    option: str = "--out",
) -> None:
    """Draw one panel above the other; the ending of the path says which format.

    option: what the file was named with. Raises LogError where the file cannot be written.
    """
    from matplotlib import rc_context  # noqa: PLC0415 - half a second
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(11, 0.8 + _PANEL_IN * len(panels)), layout="constrained")
    every = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name, curves in zip(every, titles, panels, strict=True):
        _panel(axes, name, curves)
    every[-1].set_xlabel("s")
    figure.suptitle(title, fontsize="medium", parse_math=False)
    dated = {"Date": None} if path.suffix.lower() == ".svg" else None
    try:
        with (
            made_whole(path, overwrite=True) as temporary,
            rc_context({"svg.hashsalt": "hil", "svg.fonttype": "none"}),  # one log, one file
            warnings.catch_warnings(),
        ):
            warnings.filterwarnings("ignore", "Glyph .* missing")  # of a name: boxes stand for it
            figure.savefig(temporary, dpi=110, metadata=dated)
    except OSError as error:
        raise LogError(f"{option} {path}: cannot be written: {error.strerror}") from None


def _panel(axes: Any, name: str, curves: Sequence[Curve]) -> None:
    first = curves[0]
    axes.set_title(name, fontsize="small", loc="left", parse_math=False)
    axes.grid(alpha=0.3)
    shown = [each for c in curves for each in _bits(c)] if first.flags else curves
    colours: dict[str, str] = {}
    for curve in shown:
        colour = colours.setdefault(curve.label, f"C{len(colours) % 10}")
        drawn = {"drawstyle": "steps-post" if curve.names else "default", "c": colour, "lw": 0.9}
        values = np.where(np.abs(curve.values) <= LARGEST, curve.values, np.nan)
        style, label = STYLES[curve.log % len(STYLES)], curve.prefix + curve.label
        axes.plot(curve.t, values, style, label=label, **drawn)
    if first.flags:
        axes.set_yticks([0, 1], ["off", "on"])
    elif first.names:
        there = np.unique(np.concatenate([c.values for c in curves]))
        texts = {value: text for text, value in first.names.items()}
        axes.set_yticks(there, [texts.get(int(v), f"{v:g}") for v in there], parse_math=False)
    else:
        axes.set_ylabel(" | ".join(dict.fromkeys(c.unit for c in curves)), parse_math=False)
    if shown:
        legend = axes.legend(fontsize="x-small", ncols=2, loc="upper right")
        for text in legend.get_texts():
            text.set_parse_math(False)


def _bits(curve: Curve) -> list[Curve]:
    """One curve for each bit of flags that is ever set."""
    values = curve.values.astype(np.int64)
    return [
        curve._replace(label=text, values=((values & bit) > 0).astype(np.float64))
        for text, bit in curve.names.items()
        if bit and (values & bit).any()
    ]
