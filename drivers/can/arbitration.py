"""Arbitration: which of the waiting frames has the bus, and when."""

from drivers.arrays import Ints
from drivers.compiled.compiler import helper
from drivers.protocol import ERROR, EXTENDED, REMOTE

FOREVER = 1 << 62


@helper
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


QUEUED_NS, PRIORITY, NUMBER, DURATION_NS, WIRE = range(5)
"""Columns of a transmit queue: ns, number in order of queueing, which of several buses; SENT: it is on it."""
SENT = -1


@helper
def transmit(queue: Ints, count: int, wire: int, free_ns: int, until_ns: int) -> tuple[int, int]:
    """Return the row of the frame that begins next on a bus and when it ends; -1: none begins by `until_ns`.

    The bus falls free at `free_ns`. Whenever it is free, the frame of the smallest priority among those
    queued by then starts and holds it for its duration; if none is queued, the next one to come starts at
    once. Equal priorities go in order of number. The end may lie after `until_ns`; a frame that answers one
    is queued at that one's end. The caller marks the row as SENT.
    """
    soonest = FOREVER
    for k in range(count):
        if queue[k, WIRE] == wire:
            soonest = min(soonest, queue[k, QUEUED_NS])
    start = max(free_ns, soonest)
    row = -1
    if soonest == FOREVER or start > until_ns:
        return row, start
    for k in range(count):
        if queue[k, WIRE] == wire and queue[k, QUEUED_NS] <= start:
            rank = queue[k, PRIORITY]
            before = row < 0 or rank < queue[row, PRIORITY]
            if before or (rank == queue[row, PRIORITY] and queue[k, NUMBER] < queue[row, NUMBER]):
                row = k
    return row, start + queue[row, DURATION_NS]
