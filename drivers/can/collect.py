"""Waiting for frames on an interface that can only be asked and waited for."""

from collections.abc import Set as AbstractSet
from typing import Protocol

from drivers.clock import Clock
from drivers.protocol import ERROR, Received


class Source(Protocol):
    """Where frames come from."""

    @property
    def clock(self) -> Clock:
        """The clock of their times."""

    def receive(self) -> list[Received]:
        """Return what is there."""

    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until there may be more, at most until the deadline.

        missing: the identifiers that are awaited; empty where anything is.
        """


def collect(source: Source, deadline_ns: int, wanted: AbstractSet[int] | None = None) -> list[Received]:
    """Receive until all of `wanted` (None: anything) has come, or the deadline.

    An empty `wanted` is fulfilled at once.
    """
    received: list[Received] = []
    missing = set(wanted or ())
    while True:
        now = source.clock.now()
        new = source.receive()
        received += new
        if missing:
            missing.difference_update([frame.id for _, frame in new if not frame.flags & ERROR])
        if now >= deadline_ns or (received if wanted is None else not missing):
            return received
        source.block(deadline_ns, missing)
