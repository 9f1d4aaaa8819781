"""Link: base class of all CAN interfaces, with the loop that waits for awaited frames."""

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
    """Object from which frames are received; `clock` is the clock of their reception times."""

    clock: Clock

    def receive(self) -> Rows:
        """Frames that have arrived since the last call: FRAME records, in memory owned by the result."""
        raise NotImplementedError

    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until more frames may have arrived, at most until the deadline (time of `clock`, ns).

        missing: identifiers still awaited; empty: any frame ends the sleep.
        """
        raise NotImplementedError


class Link(Source):
    """One CAN interface of a `Bus`; received frames may be error frames.

    The defaults suit an interface that reports neither controller state nor ends of frames on the wire.
    """

    knows_ends = False
    """True if the interface reports when a frame has ended on the wire."""
    virtual = False
    """True if frames arrive as soon as they are sent, without bus time."""
    overflow = 0
    """Received frames lost so far."""
    _taken_ns: list[int]

    @property
    def facts(self) -> str:
        """Settings and state read from the interface, one line of text; empty if unknown."""
        return ""

    @property
    def off(self) -> bool:
        """True while the interface reports the bus as off (bus-off) or the link as down."""
        return False

    def send(self, frames: Rows) -> int:
        """Send FRAME records, all on this interface; returns how many it accepted, from the first on."""
        raise NotImplementedError

    def sent_ns(self) -> Sequence[int]:
        """Time, ns, of each frame accepted by the last `send`: end on the wire if known, else acceptance."""
        return self._taken_ns

    def fileno(self) -> int:
        """Descriptor that is readable when a frame has arrived; -1: no descriptor."""
        return -1

    def foresee(self) -> int | None:
        """Expected end, ns, of the transmission of the next frame of another node; None if unknown."""
        return None

    def arm(self) -> bool:
        """Make `fileno` readable when a frame arrives; False if a frame has arrived already."""
        return True

    def worst_state(self) -> BusState:
        """Worst state of the CAN controller (active, warning, passive, off) since the last call."""
        return BusState.UNKNOWN

    def died(self) -> None:
        """Called when the bus counts as dead: drop frames that wait, as they would be sent late."""

    def flush_tx(self) -> object:
        """Drop frames that wait to be sent. Raises BusError if that fails."""

    def close(self) -> None:
        """Close the interface and free its resources."""


def collect(source: Source, deadline_ns: int, wanted: AbstractSet[int] | None = None) -> Rows:
    """Receive from a source until all identifiers in `wanted` (None: any frame) have arrived.

    The result is all frames received by then or by `deadline_ns`, in order. An empty `wanted` does not wait.
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
