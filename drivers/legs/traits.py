"""What our own protocol answers to the questions that other families make the contract ask."""

from drivers.arrays import Array
from drivers.protocol import Frame
from drivers.signals import Reaction


class Traits:
    """One identifier a feedback, a stop that latches, every reaction, its own brake."""

    stop_latches = True
    force_on_brakes = True
    dangers = ()
    reactions = tuple(Reaction)
    shares_identifiers = False

    def reported_lengths(self) -> tuple[Array, Array] | None:
        """Return None: the field is wider than any leg."""
        return None

    def awaited(self, frame: Frame) -> int:
        """Return the identifier."""
        return frame.id

    def fault_text(self, _code: int) -> str:
        """Return nothing: all codes are DriveFault."""
        return ""
