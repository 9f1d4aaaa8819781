"""`hil plot`: any column of one log or several, one above the other, into a PNG or SVG file."""

from collections.abc import Sequence
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import LogError
from hil.app.files import new_file, printable
from hil.app.readable import readable
from hil.study.log_columns import curves, named_columns, seconds
from hil.study.plot.draw import Curve, draw

DEFAULT = ("q_d - q", "tau", "mode")
"""What is drawn where nothing is named."""
SUFFIXES = (".png", ".svg")


def plot(
    logs: Sequence[Path],
    columns: Sequence[str] = (),
    *,
    out: Path | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Draw columns of logs, one panel a name, and return the summary.

    columns: names as `hil.study.log_columns.curves` takes them. start_s and end_s cut all logs, s since the
    first tick of each. Every log is drawn over the others, in a line style of its own.

    Raises LogError for what cannot be read, for names that a log does not have, and for a file that exists.
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
    """Return the curves of each panel, and what is to be said of logs that end early."""
    panels: list[list[Curve]] = [[] for _ in names]
    shown, remarks = _names(logs), list[str]()
    for n, log_path in enumerate(logs):
        log, rows, remark = readable(log_path, named_columns(names) | {"t_ns"})
        if not len(rows):
            raise LogError("; ".join(filter(None, (f"{log_path}: has no tick: nothing to draw", remark))))
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
    """Return what logs are called in a legend: the stem, or the path where another one has that stem."""
    stems = [path.stem for path in logs]
    return [printable(path if stems.count(path.stem) > 1 else path.stem) for path in logs]


def _path(log: Path, out: Path | None, *, force: bool) -> Path:
    path = log.with_name(f"{log.stem}-plot.png") if out is None else out
    if path.suffix.lower() not in SUFFIXES:
        raise LogError(f"--out {path}: allowed are the endings {' and '.join(SUFFIXES)}")
    return new_file(path, force=force)
