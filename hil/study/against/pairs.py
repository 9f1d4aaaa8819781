"""Rows of two logs in pairs, read as they are needed."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.errors import LogError
from drivers.signals import Mode
from hil.loop.modes import MOVING
from hil.record.log import Log

MOVED = MOVING - {Mode.RELEASING}
"""Modes in which the platform moves as planned; a run that ends before its approach has none."""


@dataclass
class Unpaired:
    """Ticks that one log has and the other not. Mutable while the pairs come."""

    count: int = 0
    first: int | None = None
    """Its number in the log that has it."""

    def add(self, ticks: Ints) -> None:
        """Take in ticks, in their order."""
        if len(ticks) and self.first is None:
            self.first = int(ticks[0])
        self.count += len(ticks)


@dataclass
class Alone:
    """Of both logs what the other one lacks."""

    one: Unpaired = field(default_factory=Unpaired)
    other: Unpaired = field(default_factory=Unpaired)


def first_motion(log: Log) -> tuple[int, int]:
    """Return tick and t_ns of the first tick in which the platform moves.

    Raises LogError: it never does, or the log has no modes.
    """
    if not any(column.name == "mode" and column.kind == "<i8" and not column.shape for column in log.columns):
        raise LogError(
            f"{log.path}: has no column of modes, and --align motion asks for one; use --align tick"
        )
    for rows in log.blocks("tick", "t_ns", "mode"):
        moving = np.flatnonzero(np.isin(rows["mode"], [int(mode) for mode in MOVED]))
        if len(moving):
            return int(rows["tick"][moving[0]]), int(rows["t_ns"][moving[0]])
    raise LogError(f"{log.path}: its platform never moves, and --align motion asks when; use --align tick")


def paired(
    one: Log, other: Log, names: tuple[str, ...], starts: tuple[int, int], alone: Alone
) -> Iterator[tuple[Rows, Rows]]:
    """Yield rows of the same number in both logs, counted from a tick in each; `alone` gets the others.

    names : columns, `tick` among them; starts : the ticks from which on each log counts.

    Raises LogError: a log is damaged.
    """
    blocks = [_from(log, names, start) for log, start in zip((one, other), starts, strict=True)]
    held, lacking = [next(each, None) for each in blocks], (alone.one, alone.other)
    while (a := held[0]) is not None and (b := held[1]) is not None:
        counts: tuple[Ints, Ints] = (a["tick"] - starts[0], b["tick"] - starts[1])
        end = min(counts[0][-1], counts[1][-1])
        common, i, j = np.intersect1d(*counts, return_indices=True)
        if len(common):
            yield a[i], b[j]
        for n, rows in enumerate((a, b)):
            lacking[n].add(rows["tick"][(counts[n] <= end) & ~np.isin(counts[n], common)])
            rest = rows[counts[n] > end]
            held[n] = rest if len(rest) else next(blocks[n], None)
    for n, left in enumerate(held):
        for rows in () if left is None else (left, *blocks[n]):
            lacking[n].add(rows["tick"])


def _from(log: Log, names: tuple[str, ...], start: int) -> Iterator[Rows]:
    for rows in log.blocks(*names):
        kept = rows[rows["tick"] >= start]
        if len(kept):
            yield kept
