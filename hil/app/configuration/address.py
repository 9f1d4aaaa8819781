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

    Where its text is no plain mapping with these keys as text, the whole configuration is read.
    Raises ConfigurationError with all problems found then.
    """
    _, text = read_configuration(path)
    document = parse(text)
    sections = document.value or {}
    bus, reference = sections.get("bus"), sections.get("reference")
    if not document.problems and isinstance(bus, dict) and isinstance(reference, dict):
        default = BusAddress()
        interface = bus.get("interface", default.interface)
        several = bus.get("channels")
        first = several[0] if isinstance(several, list) and several and isinstance(several[0], dict) else bus
        channel = first.get("channel", default.channel)
        if isinstance(interface, str) and isinstance(channel, str):
            return Address(BusAddress(interface, channel), reference.get("type") == "live")
    from hil.app.configuration.configuration import load  # noqa: PLC0415 - what this module is there to avoid

    c = load(path)
    return Address(BusAddress(c.bus.interface, c.bus.channel), c.reference.type == "live")
