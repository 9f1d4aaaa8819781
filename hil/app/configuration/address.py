"""Where a controller is spoken to, read without composing the whole configuration.

Checking all of a file imports laws and mathematics, and takes a second. An emergency stop does not wait for
that, nor does a wrong value in another section hold it up.
"""

from pathlib import Path
from typing import NamedTuple

from drivers.bus_address import BusAddress
from hil.app.configuration.text_file import read_configuration
from hil.app.configuration.yaml_positions import parse


class Address(NamedTuple):
    """What an operator's command needs of a configuration."""

    bus: BusAddress
    live: bool
    """Whether its reference takes set-points."""


def address(path: str | Path) -> Address:
    """Read the address from a file, or by the name of a shipped one.

    Raises ConfigurationError with all problems found where its text is no mapping with these keys.
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
