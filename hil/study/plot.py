"""`hil plot`: draws columns of one or several logs into a PNG or SVG file, one panel per column."""

import warnings
from collections.abc import Mapping, Sequence
from enum import IntFlag
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import LogError
from hil.app.files import made_whole, new_file, printable
from hil.app.readable import readable
from hil.study.log_columns import curves, named_columns, seconds

DEFAULT = ("q_d - q", "tau", "mode")
"""Curves drawn by default."""
SUFFIXES = (".png", ".svg")
STYLES = ("-", "--", ":", "-.")
"""Line styles of the logs, in their order."""
LARGEST = 1e300
"""Largest value for which Matplotlib can lay out axes; larger and non-finite values are not drawn."""
_PANEL_IN = 2.8


class Curve(NamedTuple):
    """One number of one log over time, as drawn by `hil plot`."""

    label: str
    log: int
    """Index of the log."""
    t: Array
    """(n,) s since the first tick."""
    values: Array
    """(n,)."""
    unit: str
    """Empty: no unit."""
    names: Mapping[str, int]
    """Name -> value of an enumeration or of flags; empty for plain numbers."""
    flags: bool
    """The names are of bits; a value may have several of them set."""
    prefix: str = ""
    """Name of the log, before the label."""


def plot(
    logs: Sequence[Path],
    columns: Sequence[str] = (),
    *,
    out: Path | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Draw columns of logs, one panel per name; return the summary.

    columns : names as `hil.study.log_columns.curves` takes them. start_s, end_s : interval drawn of each log,
    s since its first tick. All logs share the panels; each has its own line style.

    Raises LogError: unreadable log, unknown column, or existing file.
    """
    names = tuple(columns) or DEFAULT
    path = _path(logs[0], out, force=force)
    panels, remarks = _read(logs, names, start_s, end_s)
    draw(names, panels, path, ", ".join(printable(each.name) for each in logs))
    return {
        "success": True,
        "kind": "plot",
        "logs": [str(each) for each in logs],
        "columns": list(names),
        "remark": "; ".join(remarks) or None,
        "picture": str(path),
    }


def _read(
    logs: Sequence[Path], names: Sequence[str], start_s: float | None, end_s: float | None
) -> tuple[list[list[Curve]], list[str]]:
    """Curves of each panel, and remarks on logs that end early."""
    panels: list[list[Curve]] = [[] for _ in names]
    shown, remarks = _names(logs), list[str]()
    for n, log_path in enumerate(logs):
        log, rows, remark = readable(log_path, named_columns(names) | {"t_ns"})
        if not len(rows):
            raise LogError("; ".join(filter(None, (f"{log_path}: has no tick to draw", remark))))
        if remark:
            remarks.append(f"{log_path}: {remark}")
        t = seconds(rows)
        kept = (t >= (t[0] if start_s is None else start_s)) & (t <= (t[-1] if end_s is None else end_s))
        if not kept.any():
            raise LogError(f"{log_path}: no tick between --from and --to, allowed: within 0 to {t[-1]:.3f} s")
        prefix = f"{shown[n]}: " if len(logs) > 1 else ""
        for panel, name in zip(panels, names, strict=True):
            for each in curves(log.columns, name, str(log_path)):
                values, column = each.of(rows[kept]).astype(np.float64), each.part.column
                flags = issubclass(column.type, IntFlag)
                panel.append(Curve(each.label, n, t[kept], values, each.unit, column.names, flags, prefix))
    return panels, remarks


def _names(logs: Sequence[Path]) -> list[str]:
    """Names of the logs in the legend: the stem, or the path if another log has the same stem."""
    stems = [path.stem for path in logs]
    return [printable(path if stems.count(path.stem) > 1 else path.stem) for path in logs]


def _path(log: Path, out: Path | None, *, force: bool) -> Path:
    path = log.with_name(f"{log.stem}-plot.png") if out is None else out
    if path.suffix.lower() not in SUFFIXES:
        raise LogError(f"--out {path}: unknown file ending, allowed: {' and '.join(SUFFIXES)}")
    return new_file(path, force=force)


def draw(titles: Sequence[str], panels: Sequence[Sequence[Curve]], path: Path, title: str) -> None:
    """Draw panels of curves, one above the other; the ending of the path selects PNG or SVG.

    Raises OSError: the file cannot be written.
    """
    from matplotlib import rc_context  # noqa: PLC0415 - half a second
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(11, 0.8 + _PANEL_IN * len(panels)), layout="constrained")
    every = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name, panel in zip(every, titles, panels, strict=True):
        _panel(axes, name, panel)
    every[-1].set_xlabel("s")
    figure.suptitle(title, fontsize="medium", parse_math=False)
    dated = {"Date": None} if path.suffix.lower() == ".svg" else None
    with (
        made_whole(path, overwrite=True) as temporary,
        rc_context({"svg.hashsalt": "hil", "svg.fonttype": "none"}),  # one log, one file
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", "Glyph .* missing")  # boxes are drawn for it
        figure.savefig(temporary, dpi=110, metadata=dated)


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
        legend = axes.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        for text in legend.get_texts():
            text.set_parse_math(False)


def _bits(curve: Curve) -> list[Curve]:
    """One curve for each flag that is set in at least one value."""
    values = curve.values.astype(np.int64)
    return [
        curve._replace(label=text, values=((values & bit) > 0).astype(np.float64))
        for text, bit in curve.names.items()
        if bit and (values & bit).any()
    ]
