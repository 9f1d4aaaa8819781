"""One interface behind a bus, and waiting for its frames."""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

from drivers.arrays import Rows
from drivers.clock import Clock
from drivers.frame_array import joined
from drivers.protocol import ERROR
from drivers.signals import BusState

OWN = 1 << 6
"""Flag of a received frame that its reader sent itself."""


class Source:
    """Source of frames; `clock` is the clock of their times."""

    clock: Clock

    def receive(self) -> Rows:
        """Frames that have arrived: elements of FRAME in memory of their own."""
        raise NotImplementedError

    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until more frames may have arrived, at most until the deadline.

        missing: the awaited identifiers; empty: any frame.
        """
        raise NotImplementedError


class Link(Source):
    """One interface; received frames may be error frames.

    The defaults suit an interface that knows neither its controller nor its wire.
    """

    knows_ends = False
    """True if the end of a frame on the wire is known."""
    virtual = False
    """True if frames arrive as soon as they are sent."""
    overflow = 0
    """Frames lost so far."""
    _taken_ns: list[int]

    @property
    def facts(self) -> str:
        """Facts read from the interface, in one line; empty without any."""
        return ""

    @property
    def off(self) -> bool:
        """True while the interface reports the bus as off or down."""
        return False

    def send(self, frames: Rows) -> int:
        """Send elements of FRAME, all for this interface; the result counts the leading ones accepted."""
        raise NotImplementedError

    def sent_ns(self) -> Sequence[int]:
        """Times, ns, of the frames accepted by the last `send`: end on the wire if known, else acceptance."""
        return self._taken_ns

    def fileno(self) -> int:
        """Descriptor that is readable when a frame has arrived; -1: no descriptor."""
        return -1

    def foresee(self) -> int | None:
        """Expected end of the next foreign frame under way, ns; None if none is known."""
        return None

    def arm(self) -> bool:
        """Request a signal on `fileno`, unless a frame has arrived; True if none has."""
        return True

    def worst_state(self) -> BusState:
        """Worst state of the controller since the last call."""
        return BusState.UNKNOWN

    def died(self) -> None:
        """React to a dead bus: frames that wait to be sent are stale."""

    def flush_tx(self) -> object:
        """Drop frames that wait to be sent. Raises BusError if that fails."""

    def close(self) -> None:
        """Free the interface."""


def collect(source: Source, deadline_ns: int, wanted: AbstractSet[int] | None = None) -> Rows:
    """Receive until all of `wanted` (None: any frame) has arrived, or until the deadline.

    An empty `wanted` does not wait.
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
