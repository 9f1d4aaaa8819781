"""What the bring-up needs of a bus: one tick at a time."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from drivers.protocol import Frame, Received


class Heard(NamedTuple):
    """What a tick has brought."""

    since_ns: int
    """When the tick began."""
    frames: tuple[Received, ...]
    """All frames since the last tick, the answers to this one's first frames among them."""
    stretched_ns: int = 0
    """How long the bench's time has stood still since the last tick."""


class Line(Protocol):
    """The bus to six drives. Mutable state: the tick, and what is under way."""

    rate_Hz: float

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        """Wait for the next tick, send what starts it, and collect the answers."""

    def send(self, frames: Sequence[Frame]) -> None:
        """Send the frames that end a tick."""
