"""Which row of the plant's log belongs to which tick: the one of the SYNC that started it."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.errors import LogError

SYNC = ("t_ns", "syncs")
"""Columns of the plant that tell its SYNCs."""
SENT = ("t_ns", "lateness_ns")
"""Columns of the controller that tell when it sent them."""
CLOCK_NS = 10_000_000_000
"""The clocks of two logs of one run started at UTC instants that differ by less."""


def plant_rows_of(ticks: Rows, plant: Rows, period_ns: float | None = None) -> Ints:
    """Return the place of each tick's row in the plant's log, -1 where it has none: (n,).

    A tick sends its SYNC when it wakes up, at `t_ns` + `lateness_ns`. The row of that SYNC is the nearest one
    in which `syncs` rises, half a period away at most and no other tick's: the plant steps on a grid of its
    own. A plant that counts no SYNC is read at its nearest row.

    ticks : (n,) rows with the columns SENT; plant : (m,) rows with the columns SYNC, both in their order;
    period_ns : of the loop; None: the usual distance of the ticks.
    """
    none = np.full(len(ticks), -1, np.int64)
    rises = np.flatnonzero(np.diff(plant["syncs"], prepend=0) > 0)
    candidates = rises if len(rises) else np.arange(len(plant))
    if not len(ticks) or not len(candidates):
        return none
    sent = ticks["t_ns"] + ticks["lateness_ns"]
    t = plant["t_ns"][candidates]
    row, tick = _nearest(t, sent), _nearest(sent, t)
    if period_ns is None:
        period_ns = float(np.median(np.diff(ticks["t_ns"]))) if len(ticks) > 1 else np.inf
    own = (np.abs(t[row] - sent) <= period_ns / 2) & (tick[row] == np.arange(len(ticks)))
    found: Ints = np.where(own, candidates[row], none)
    return found


def _nearest(there: Ints, wanted: Ints) -> Ints:
    """Return the place in `there` (m,), which rises, of what is nearest to each of `wanted` (n,): (n,)."""
    right = np.minimum(np.searchsorted(there, wanted), len(there) - 1)
    left = (right - 1).clip(0)
    nearest: Ints = np.where(wanted - there[left] < there[right] - wanted, left, right)
    return nearest


class Side(NamedTuple):
    """What tells whether two logs are of one run."""

    path: str
    epoch_ns: int
    lockstep: bool
    configuration: bytes | None
    """None where the log has none."""
    run: str | None = None
    """What both logs of one simulation carry, and no other's does; None where the log has none."""


def require_one_run(log: Side, plant: Side, places: Ints) -> None:
    """Refuse two logs whose clocks, ticks or configurations do not fit each other.

    In real time the plant may have a file of its own; in lockstep all clocks begin at one instant, both ends
    have one configuration, and one identity of the run.

    Raises
    ------
    LogError
        They are not of one run.

    """
    far = abs(log.epoch_ns - plant.epoch_ns) > CLOCK_NS or (len(places) and not (places >= 0).any())
    both = log.lockstep and plant.lockstep and None not in (log.configuration, plant.configuration)
    other = log.lockstep != plant.lockstep or (both and log.configuration != plant.configuration)
    apart = None not in (log.run, plant.run) and log.run != plant.run
    if far or other or apart:
        why = f"no tick of {log.path} is in it"
        if not far:
            why = (
                "its configuration is another one" if other else "set-points, commands or faults were others"
            )
        raise LogError(
            f"{log.path}: the plant's log {plant.path} is of another run: {why}; name the right one with "
            "Log(path, plant=FILE)"
        )
