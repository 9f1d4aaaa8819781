"""What tells one drive from another of the same node number: serial number and revision, if it has them.

An own contract beside `drivers.protocol.DriveProtocol`: not every family can be asked.
"""

from typing import NamedTuple, Protocol, runtime_checkable

from drivers.protocol import Frame

SERIAL, REVISION = "serial number", "revision"
"""What a drive may say of itself."""


class Said(NamedTuple):
    """One figure that a drive has said of itself."""

    leg: int
    what: str
    """SERIAL or REVISION."""
    value: int

    @property
    def tells(self) -> bool:
        """Whether it tells one drive from another: a serial number of 0 or all ones was never written."""
        return self.what != SERIAL or self.value not in _UNWRITTEN


_UNWRITTEN = frozenset({0, *((1 << bits) - 1 for bits in (32, 48, 64, 96))})
"""The widths of serial numbers."""


@runtime_checkable
class Identified(Protocol):
    """A protocol whose drives say who they are."""

    def identity_requests(self) -> tuple[tuple[Frame, ...], ...]:
        """Return the requests, one frame a drive, in rounds: each is answered before the next is sent."""

    def identity(self, frame: Frame) -> Said | None:
        """Return what a frame says of who sends it; None for any other frame."""
