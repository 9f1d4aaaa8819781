"""Rows of a log, read as they are needed, in groups of about one size."""

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.arrays import Rows
from hil.record.log import Log
from hil.record.selection import Component


def row_groups(log: Log, parts: Sequence[Component], size: int) -> Iterator[Rows]:
    """Yield the columns that the components need, and `tick` and `t_ns`, `size` rows at a time or a few more.

    Raises LogError: the log is damaged.
    """
    held: list[Rows] = []
    for block in log.blocks("tick", "t_ns", *(part.column.name for part in parts)):
        held.append(block)
        if sum(map(len, held)) >= size:
            yield np.concatenate(held)
            held = []
    if held:
        yield np.concatenate(held)
