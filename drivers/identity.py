"""What tells one drive from another of the same node number: serial number and revision, if it has them."""

from typing import NamedTuple

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
