"""Arbitration: which of the waiting frames has the bus, and when."""

from collections.abc import Sequence
from heapq import heappop, heappush
from operator import itemgetter
from typing import Any, TypeVar

from drivers.protocol import ERROR, EXTENDED, REMOTE


def priority(id: int, flags: int) -> int:  # noqa: A002 - the field's name in Frame
    """Return the arbitration field as a number: of two frames the smaller wins the bus.

    Bits in the order of the wire, dominant 0: identifier 28..18 | RTR or SRR | IDE | identifier 17..0 | RTR.
    A standard frame beats the extended one with the same eleven leading bits, a data frame the remote one.
    An error frame comes before everything.
    """
    if flags & ERROR:
        return 0
    remote = 1 if flags & REMOTE else 0
    if flags & EXTENDED:
        return 1 + ((id >> 18) << 21 | 3 << 19 | (id & 0x3FFFF) << 1 | remote)
    return 1 + (id << 21 | remote << 20)


Queued = tuple[int, int, int, int]
"""(queued at ns, priority, number in order of queueing, duration ns): compares in this order."""

Entry = TypeVar("Entry", bound=tuple[Any, ...])
"""A `Queued`, followed by whatever belongs to the frame."""

_RANK = itemgetter(1, 2)


def arbitrate(queued: Sequence[Queued], free_ns: int, until_ns: int) -> tuple[list[tuple[int, int]], int]:
    """Return [(number, end ns)] of what `transmit` sends, and when the bus falls free after it."""
    sent, _, free_ns = transmit(queued, free_ns, until_ns)
    return [(entry[2], end) for end, entry in sent], free_ns


def transmit(
    queued: Sequence[Entry], free_ns: int, until_ns: int
) -> tuple[list[tuple[int, Entry]], list[Entry], int]:
    """Decide all transmissions that begin by `until_ns`.

    The bus falls free at `free_ns`. Whenever it is free, the frame of the smallest priority among those
    queued by then starts and holds it for its duration; if none is queued, the next one to come starts at
    once. Equal priorities go in order of number. The end may lie after `until_ns`; a frame that answers one
    is queued at that one's end.

    queued need not be sorted; numbers differ. Returns [(end ns, entry)] in the order of the wire, the entries
    that have not started, and when the bus falls free.
    """
    order = sorted(queued)
    sent: list[tuple[int, Entry]] = []
    # a heap of what was queued by the time that the bus falls free
    waiting: list[tuple[int, int, Entry]] = []
    n = len(order)
    i = 0
    while i < n or waiting:
        start = free_ns
        if not waiting and order[i][0] > start:
            start = order[i][0]
        if start > until_ns:
            break
        if not waiting and order[-1][0] <= start:  # the usual case: all that are left are there
            left = order[i:]
            left.sort(key=_RANK)
            for k, entry in enumerate(left):
                if start > until_ns:
                    return sent, left[k:], start
                start += entry[3]
                sent.append((start, entry))
            return sent, [], start
        while i < n and order[i][0] <= start:
            heappush(waiting, (order[i][1], order[i][2], order[i]))
            i += 1
        entry = heappop(waiting)[2]
        free_ns = start + entry[3]
        sent.append((free_ns, entry))
    return sent, [*order[i:], *(entry for _, _, entry in waiting)], free_ns
