"""Rows of a log as a pandas DataFrame: one column per component, with units and names of numbers.

Each tick gets the row of the plant's log that belongs to the SYNC of that tick.

Only this module imports pandas, an optional dependency.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntFlag
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.log_file import LogFile
from hil.record.schema import CONFIGURATION, IDENTITY, RUN
from hil.record.selection import Component, components, name_of

if TYPE_CHECKING:
    import pandas as pd

PLANT = "plant"
"""First part of the names of the plant's columns."""
SYNC = ("t_ns", "syncs")
"""Columns of the plant that count and time its SYNCs."""
SENT = ("t_ns", "lateness_ns")
"""Columns of the controller that give the time of its SYNC."""
CLOCK_NS = 10_000_000_000
"""Largest difference between the UTC epochs of two logs of one run, ns."""


def data_frame(
    log: LogFile,
    plant: Callable[[], LogFile],
    names: Sequence[str],
    start_s: float | None,
    stop_s: float | None,
    *,
    numbers: bool,
) -> pd.DataFrame:
    """Columns of a log and of its plant's log, as `hil.record.log.Log.frame` describes them.

    Raises LogError: unknown column, pandas is not installed, or the plant's log is missing or of another run.
    """
    try:
        import pandas as pd  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise LogError(
            f"a DataFrame needs pandas, which is not installed ({error}): "
            'pip install "hexapod-hil[analysis]"; Log.rows() gives NumPy arrays without it'
        ) from error
    theirs = [name for name in names if name.split(".")[0] == PLANT]
    own = [name for name in names if name not in theirs]
    parts = components(log.columns, own, str(log.path)) if own or not theirs else []
    wanted = {part.column.name for part in parts} | {"t_ns"} | (set(SENT) if theirs else set())
    rows = log.rows(*wanted, start_s=start_s, stop_s=stop_s)
    values: dict[str, Any] = {part.label: part.of(rows) for part in parts}
    if theirs:
        whole = start_s is None and stop_s is None
        more, added = _of_plant(log, plant(), rows, [name.partition(".")[2] for name in theirs], whole=whole)
        values |= added
        parts += more
    for part in parts:
        if part.column.names and not numbers:
            values[part.label] = pd.Categorical.from_codes(*_categories(part.column, values[part.label]))
    t_s = pd.Index((rows["t_ns"] - log.origin_ns) * 1e-9, name="t_s")
    frame = pd.DataFrame(values, index=t_s, copy=False)
    frame.attrs = {
        "units": {part.label: part.unit for part in parts},
        "meanings": {part.label: part.column.meaning for part in parts},
        "epoch_ns": log.epoch_ns,
        "log": str(log.path),
    }
    return frame


def _categories(column: Column, values: Ints) -> tuple[Ints, list[str]]:
    """Category codes (n,) of the numbers of a column, and the category names.

    Names of an enumeration keep their order; a number without a name is its own category. Missing values,
    nan, have the code -1.
    """
    there = np.isfinite(values)
    found, places = np.unique(values[there].astype(np.int64), return_inverse=True)
    names = [name_of(column, number) for number in found.tolist()]
    categories = names if issubclass(column.type, IntFlag) else list(dict.fromkeys([*column.names, *names]))
    codes = np.full(len(values), -1, np.int64)
    codes[there] = np.array([categories.index(name) for name in names], np.int64)[places]
    return codes, categories


def plant_rows_of(ticks: Rows, plant: Rows, period_ns: float) -> Ints:
    """Index (n,) of the plant row of each tick; -1 for a tick without one.

    A tick sends its SYNC when it wakes up, at `t_ns` + `lateness_ns`. The plant steps on its own time grid,
    so the row is the nearest one in which `syncs` rises, at most half a period away. No two ticks share a
    row. A plant that counts no SYNC is read at its nearest row.

    ticks : (n,) rows with the columns SENT; plant : (m,) rows with the columns SYNC, both in time order;
    period_ns : period of the loop.
    """
    none = np.full(len(ticks), -1, np.int64)
    rises = np.flatnonzero(np.diff(plant["syncs"], prepend=0) > 0)
    candidates = rises if len(rises) else np.arange(len(plant))
    if not len(ticks) or not len(candidates):
        return none
    sent = ticks["t_ns"] + ticks["lateness_ns"]
    t = plant["t_ns"][candidates]
    row, tick = _nearest(t, sent), _nearest(sent, t)
    own = (np.abs(t[row] - sent) <= period_ns / 2) & (tick[row] == np.arange(len(ticks)))
    found: Ints = np.where(own, candidates[row], none)
    return found


def _nearest(there: Ints, wanted: Ints) -> Ints:
    """Indices (n,) of the elements of `there` (m,), in rising order, that are nearest to `wanted` (n,)."""
    right = np.minimum(np.searchsorted(there, wanted), len(there) - 1)
    left = (right - 1).clip(0)
    nearest: Ints = np.where(wanted - there[left] < there[right] - wanted, left, right)
    return nearest


def require_one_run(log: LogFile, plant: LogFile, places: Ints) -> None:
    """Check that clocks, ticks and configurations of two logs belong to one run.

    In real time the plant may have its own configuration file. In lockstep all clocks start at one instant,
    and both ends share one configuration and one run identity.

    Raises LogError: the logs belong to different runs.
    """
    texts = [each.attachments.get(CONFIGURATION) for each in (log, plant)]
    runs = [each.metadata[IDENTITY].get(RUN) for each in (log, plant)]
    why = ""
    if None not in runs and runs[0] != runs[1]:
        why = "set-points, commands or faults differ"
    if log.lockstep != plant.lockstep or (log.lockstep and None not in texts and texts[0] != texts[1]):
        why = "its configuration differs"
    if abs(log.epoch_ns - plant.epoch_ns) > CLOCK_NS or (len(places) and not (places >= 0).any()):
        why = f"it has no tick of {log.path}"
    if why:
        raise LogError(
            f"{log.path}: the plant's log {plant.path} belongs to another run: {why}; give the right one as "
            "Log(path, plant=FILE)"
        )


def _of_plant(
    log: LogFile, plant: LogFile, rows: Rows, names: Sequence[str], *, whole: bool
) -> tuple[list[Component], dict[str, Any]]:
    """Components of the plant by name ("": all), and their values at the ticks of `rows`.

    whole: `rows` is the complete log, so that at least one tick must have a plant row.
    """
    chosen = components(plant.columns, [] if "" in names else names, str(plant.path))
    truth = plant.rows(*({part.column.name for part in chosen} | set(SYNC)))
    try:
        period_ns = 1e9 / float(log.metadata[IDENTITY]["rate_Hz"])
    except (KeyError, ValueError, ZeroDivisionError):
        period_ns = np.inf
    places = plant_rows_of(rows, truth, period_ns)
    require_one_run(log, plant, places if whole else places[:0])
    parts: list[Component] = []
    values: dict[str, Any] = {}
    there = places >= 0
    for part in chosen:
        found = np.full(len(rows), np.nan)
        found[there] = part.of(truth)[places[there]]
        parts.append(part._replace(label=f"{PLANT}.{part.label}"))
        values[parts[-1].label] = found
    return parts, values
