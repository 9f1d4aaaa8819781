"""Interface and channel of a CAN bus, by which controller, plant and operator tools find each other."""

from typing import NamedTuple


class BusAddress(NamedTuple):
    """Interface and channel of a bus: the keys `bus.interface` and `bus.channel`, with their defaults."""

    interface: str = "localcan"
    channel: str = "hil0"
