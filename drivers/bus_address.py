"""Address of a bus, by which its participants and the operator find each other."""

from typing import NamedTuple


class BusAddress(NamedTuple):
    """The keys `bus.interface` and `bus.channel`, with their defaults."""

    interface: str = "localcan"
    channel: str = "hil0"
