"""Where the text of a configuration stands: in a file, or in a shipped one, by its name.

Cheap to import. Checking all of a file imports laws and mathematics, and takes a second: an emergency stop
does not wait for that, nor does a wrong value in another section hold it up.
"""

import importlib.resources
from pathlib import Path
from typing import NamedTuple

from drivers.bus_address import BusAddress
from drivers.errors import ConfigurationError
from drivers.files import read_regular
from hil.app.configuration.yaml_positions import parse


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises FileNotFoundError where there is none, ConfigurationError where it is no regular file, too large,
    or cannot be read as UTF-8.
    """
    try:
        raw = read_regular(path)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        line, column = before.count(b"\n") + 1, error.start - before.rfind(b"\n")
        raise ConfigurationError(f"{path}:{line}:{column}: not UTF-8 text") from None


def shipped(kind: str = "") -> tuple[str, ...]:
    """Return the names of the configurations that come with the product, or of its controllers or designs."""
    files = importlib.resources.files("configs").joinpath(kind).iterdir()
    return tuple(sorted(f.name.removesuffix(".yaml") for f in files if f.name.endswith(".yaml")))


def shipped_file(name: str, kind: str = "") -> Path:
    """Return the file of a shipped configuration, controller or design."""
    return Path(str(importlib.resources.files("configs").joinpath(kind, f"{name}.yaml")))


def read_configuration(path: str | Path) -> tuple[Path, str]:
    """Return the file of a configuration, or of a shipped one by its name (`virtual`), and its text.

    A file of that name comes first, a folder does not: `python -m venv virtual` hides nothing.
    Raises ConfigurationError where there is none, or it cannot be read.
    """
    file = Path(path)
    if (not file.exists() or file.is_dir()) and str(path) in shipped():
        file = shipped_file(str(path))
    try:
        return file, read_text(file)
    except FileNotFoundError:
        names = ", ".join(shipped())
        raise ConfigurationError(f"{path}: no such file; shipped configurations are: {names}") from None


class Address(NamedTuple):
    """What an operator's command needs of a configuration."""

    bus: BusAddress
    live: bool
    """Whether its reference takes set-points."""


def address(path: str | Path) -> Address:
    """Read the address from a file, or by the name of a shipped one, without composing the configuration.

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
