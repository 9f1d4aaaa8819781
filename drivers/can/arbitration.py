"""CAN arbitration on an emulated bus: which waiting frame gets the bus, and when."""

from drivers.arrays import Ints
from drivers.compiled.compiler import helper
from drivers.protocol import ERROR, EXTENDED, REMOTE

FOREVER = 1 << 62


@helper
def priority(id: int, flags: int) -> int:  # noqa: A002 - the field's name in Frame
    """Arbitration rank of a frame: the smaller number wins the bus.

    Bits in the order of the wire, dominant is 0: identifier 28..18 | RTR or SRR | IDE | identifier 17..0 |
    RTR.
    A standard frame beats an extended frame with the same eleven leading bits; a data frame beats a remote
    frame. An error frame comes first.
    """
    if flags & ERROR:
        return 0
    remote = 1 if flags & REMOTE else 0
    if flags & EXTENDED:
        return 1 + ((id >> 18) << 21 | 3 << 19 | (id & 0x3FFFF) << 1 | remote)
    return 1 + (id << 21 | remote << 20)


QUEUED_NS, PRIORITY, NUMBER, DURATION_NS, WIRE = range(5)
"""Columns of a transmit queue: time of queueing (ns), priority, order of queueing, duration (ns), bus. WIRE
is SENT once the frame is on the bus."""
SENT = -1


@helper
def transmit(queue: Ints, count: int, wire: int, free_ns: int, until_ns: int) -> tuple[int, int]:
    """Next frame that wins the bus: (row in `queue`, end of transmission, ns); row -1: none starts in time.

    queue: `count` waiting frames, one per row; wire: index of the bus, which is free from `free_ns`. The
    frame starts by `until_ns` and may end later. On a free bus the queued frame with the smallest priority
    starts; on an empty queue the next frame to be queued starts at once. Equal priorities go in order of
    NUMBER. A reply is queued at the end of the frame that it answers. The caller marks the row as SENT.
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
