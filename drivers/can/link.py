"""One interface behind a bus, and waiting for frames on it."""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

from drivers.arrays import Rows
from drivers.clock import Clock
from drivers.frame_array import joined
from drivers.protocol import ERROR
from drivers.signals import BusState

OWN = 1 << 6
"""Flag of a received frame that its reader has sent itself."""


class Source:
    """Where frames come from; `clock` is that of their times."""

    clock: Clock

    def receive(self) -> Rows:
        """Return the frames that have arrived: elements of FRAME in memory of their own."""
        raise NotImplementedError

    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until there may be more, at most until the deadline.

        missing: the identifiers that are awaited; empty where anything is.
        """
        raise NotImplementedError


class Link(Source):
    """One interface; received frames may be error frames.

    What stands here is that of an interface which knows neither a controller nor its wire.
    """

    knows_ends = False
    """Whether it knows when a frame ended on the wire."""
    virtual = False
    """Whether frames are there as soon as they are sent."""
    overflow = 0
    """Frames lost so far."""
    _taken_ns: list[int]

    @property
    def facts(self) -> str:
        """What was read of the interface, in one line; empty where there is nothing to read."""
        return ""

    @property
    def off(self) -> bool:
        """Whether the interface says that the bus is off or down."""
        return False

    def send(self, frames: Rows) -> int:
        """Return how many elements of FRAME were taken, from the first on; all are for this interface."""
        raise NotImplementedError

    def sent_ns(self) -> Sequence[int]:
        """Return when each frame that the last `send` took ended on the wire, else when it was taken."""
        return self._taken_ns

    def fileno(self) -> int:
        """Return a descriptor that is readable when something has come; -1 where there is none."""
        return -1

    def foresee(self) -> int | None:
        """Return when the next foreign frame that is under way will have ended; None where none is known."""
        return None

    def arm(self) -> bool:
        """Ask for a word by `fileno`, unless something has come; return whether nothing has."""
        return True

    def worst_state(self) -> BusState:
        """Return the worst state of the controller since the last call."""
        return BusState.UNKNOWN

    def died(self) -> None:
        """Take note that the bus has died: frames that wait to be sent are stale."""

    def flush_tx(self) -> object:
        """Drop frames that wait to be sent. Raises BusError where that fails."""

    def close(self) -> None:
        """Free the interface."""


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
