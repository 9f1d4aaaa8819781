"""Waiting for frames on an interface that can only be asked and waited for."""

from collections.abc import Set as AbstractSet
from typing import Protocol

from drivers.arrays import Rows
from drivers.clock import Clock
from drivers.frame_array import joined
from drivers.protocol import ERROR


class Source(Protocol):
    """Where frames come from."""

    @property
    def clock(self) -> Clock:
        """The clock of their times."""

    def receive(self) -> Rows:
        """Return the frames that have arrived: elements of FRAME in memory of their own."""

    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until there may be more, at most until the deadline.

        missing: the identifiers that are awaited; empty where anything is.
        """


def collect(source: Source, deadline_ns: int, wanted: AbstractSet[int] | None = None) -> Rows:
    """Receive until all of `wanted` (None: anything) has come, or the deadline.

    An empty `wanted` is fulfilled at once.
    """
    received: list[Rows] = []
    missing = set(wanted or ())
    while True:
        now = source.clock.now()
        new = source.receive()
        if len(new):
            received.append(new)
        if missing:
            which = zip(new["id"].tolist(), new["flags"].tolist(), strict=True)
            missing.difference_update([identifier for identifier, flags in which if not flags & ERROR])
        if now >= deadline_ns or (received if wanted is None else not missing):
            return received[0] if len(received) == 1 else joined(received)
        source.block(deadline_ns, missing)
