"""Rows of two logs in pairs, read as they are needed."""

from collections.abc import Iterator

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.errors import LogError
from drivers.signals import Mode
from hil.loop.modes import MOVING
from hil.record.log import Log

MOVED = MOVING - {Mode.RELEASING}
"""Modes in which the platform moves as planned; a run that ends before its approach has none."""


def first_motion(log: Log) -> tuple[int, int]:
    """Return tick and t_ns of the first tick in which the platform moves.

    Raises LogError: it never does, or the log has no modes.
    """
    for rows in log.blocks("tick", "t_ns", "mode"):
        moving = np.flatnonzero(np.isin(rows["mode"], [int(mode) for mode in MOVED]))
        if len(moving):
            return int(rows["tick"][moving[0]]), int(rows["t_ns"][moving[0]])
    raise LogError(f"{log.path}: its platform never moves, and --align motion asks when; use --align tick")


def paired(
    one: Log, other: Log, names: tuple[str, ...], starts: tuple[int, int]
) -> Iterator[tuple[Rows, Rows, Ints, Ints]]:
    """Yield rows of the same number in both logs, counted from a tick in each; and the ticks of one alone.

    names : columns, `tick` among them; starts : the ticks from which on each log counts.

    Raises LogError: a log is damaged.
    """
    blocks = [_from(log, names, start) for log, start in zip((one, other), starts, strict=True)]
    a, b = (next(each, None) for each in blocks)
    while a is not None and b is not None:
        m, n = a["tick"] - starts[0], b["tick"] - starts[1]
        end = min(m[-1], n[-1])
        common, i, j = np.intersect1d(m, n, return_indices=True)
        one_alone, other_alone = ((k <= end) & ~np.isin(k, common) for k in (m, n))
        yield a[i], b[j], a["tick"][one_alone], b["tick"][other_alone]
        a = a[m > end] if m[-1] > end else next(blocks[0], None)
        b = b[n > end] if n[-1] > end else next(blocks[1], None)
    while a is not None:
        yield a[:0], a[:0], a["tick"], a["tick"][:0]
        a = next(blocks[0], None)
    while b is not None:
        yield b[:0], b[:0], b["tick"][:0], b["tick"]
        b = next(blocks[1], None)


def _from(log: Log, names: tuple[str, ...], start: int) -> Iterator[Rows]:
    for rows in log.blocks(*names):
        kept = rows[rows["tick"] >= start]
        if len(kept):
            yield kept
