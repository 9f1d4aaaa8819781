"""Reads the bus address of a running controller from a configuration, without checking the whole file.

Checking a whole file imports laws and mathematics, and takes a second. An emergency stop must not wait for
that, and a wrong value in another section must not block it.
"""

from pathlib import Path
from typing import NamedTuple

from drivers.bus_address import BusAddress
from hil.app.configuration.text_file import read_configuration
from hil.app.configuration.yaml_positions import parse


class Address(NamedTuple):
    """Bus of a controller and kind of its reference, which operator commands need."""

    bus: BusAddress
    live: bool
    """True if the reference takes set-points."""


def address(path: str | Path) -> Address:
    """Read the bus address from a configuration file, or from a shipped configuration by its name.

    A text that is not a mapping with these keys is loaded as a whole. Raises ConfigurationError with all
    problems found.
    """
    _, text = read_configuration(path)
    document = parse(text)
    match None if document.problems else document.value:
        case {"bus": dict(bus), "reference": dict(reference)}:
            channels = bus.get("channels")
            first = channels[0] if isinstance(channels, list) and channels else bus
            if isinstance(first, dict):
                words = bus.get("interface", "localcan"), first.get("channel", "hil0")
                if all(isinstance(word, str) for word in words):
                    return Address(BusAddress(*map(str, words)), reference.get("type") == "live")
    from hil.app.configuration.configuration import load  # noqa: PLC0415 - what this function avoids

    c = load(path)
    return Address(BusAddress(c.bus.interface, c.bus.channel), c.reference.type == "live")
