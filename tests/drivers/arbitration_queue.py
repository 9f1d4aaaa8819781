"""Arbitration of a queue of frames on one bus."""

from collections.abc import Sequence

import numpy as np

from drivers.can.arbitration import NUMBER, SENT, WIRE, transmit

Queued = tuple[int, int, int, int]
"""(time of queueing ns, priority, order of queueing, duration ns)."""


def arbitrate(queued: Sequence[Queued], free_ns: int, until_ns: int) -> tuple[list[tuple[int, int]], int]:
    """All frames that begin by `until_ns` as [(number, end ns)], and the time when the bus is free again."""
    queue = np.zeros((len(queued), WIRE + 1), np.int64)
    if queued:
        queue[:, :WIRE] = queued
    sent: list[tuple[int, int]] = []
    while True:
        row, end_ns = transmit(queue, len(queue), 0, free_ns, until_ns)
        if row < 0:
            return sent, int(free_ns)
        sent.append((int(queue[row, NUMBER]), int(end_ns)))
        queue[row, WIRE], free_ns = SENT, end_ns
