"""What an interface says of a controller that it does not have, or does not show."""

from drivers.signals import BusState


class NoController:
    """An interface without a controller whose state is known."""

    facts = ""
    """What was read of the interface, in one line; empty where there is nothing to read."""

    knows_ends = False
    """Whether it knows when a frame ended on the wire."""
    virtual = False
    """Whether frames are there as soon as they are sent."""

    def worst_state(self) -> BusState:
        """Return the worst state since the last call: none is known."""
        return BusState.UNKNOWN

    def died(self) -> None:
        """Take note that the bus has died: here nothing waits that is not seen."""
