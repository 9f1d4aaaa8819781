"""Where the fields of a message of the DBC lie, and `struct` calls for those whose fields are whole bytes."""

import struct
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

from cantools.database.can import Database

from drivers.errors import ProtocolError
from drivers.protocol import BRS, FD

_CODES = {
    (4, False, False): "B",
    (8, False, False): "B",
    (16, False, False): "H",
    (16, True, False): "h",
    (32, True, False): "i",
    (32, False, False): "I",
    (64, True, True): "d",
}


class Place(NamedTuple):
    """Where a field lies in its message."""

    start: int
    """First bit."""
    size: int
    """Bits."""
    is_float: bool


class Layout(NamedTuple):
    """One message of a DBC: little-endian fields that do not overlap."""

    id: int
    length: int
    flags: int
    signals: tuple[str, ...]
    places: tuple[Place, ...]
    units: tuple[str | None, ...]
    scale: tuple[float, ...]
    low: tuple[float, ...]
    """Ranges in the DBC's units."""
    high: tuple[float, ...]
    exact: bool
    """Its quantities are float64: they are not rounded, and their range has to be checked."""

    def place(self, signal: str) -> Place:
        """Return where a signal lies."""
        return self.places[self.signals.index(signal)]


class Codec(NamedTuple):
    """One message of a DBC whose fields are bytes and halves of them, the last one its CRC-8, if any."""

    id: int
    length: int
    flags: int
    pack: Callable[..., bytes]
    """All fields but the CRC."""
    unpack: Callable[[bytes], tuple[Any, ...]]
    """All fields but the CRC."""
    scale: tuple[float, ...]
    low: tuple[float, ...]
    """Ranges in SI."""
    high: tuple[float, ...]


def read_dbc(package: str, name: str) -> str:
    """Return the text of a DBC of ours, for the log and for other tools."""
    return resources.files(package).joinpath(name).read_text(encoding="ascii")


@cache
def parsed(dbc: str) -> Database:
    """Return the messages of a DBC text; parsed once, for all who read them, and for reading only."""
    database = Database()
    database.add_dbc_string(dbc)
    return database


def layout_of(message: Any, *signals: str) -> Layout:
    """Return the layout of a cantools message; `signals` are the names expected, in order of position.

    Raises ProtocolError if the message has others, or fields that the kernels cannot read.
    """
    fields = sorted(message.signals, key=lambda s: s.start)
    names = tuple(s.name for s in fields)
    if names != signals:
        raise ProtocolError(f"DBC: {message.name} has the signals {names}, expected {signals}")
    for s in fields:  # they do not overlap: the parser sees to that
        if s.byte_order != "little_endian" or s.offset or (s.start % 8 and s.length > 32):
            raise ProtocolError(f"DBC: {message.name}.{s.name} is no little-endian field that can be read")
    brs = "CANFD_BRS" in message.dbc.attributes and str(message.dbc.attributes["CANFD_BRS"].value) == "1"
    return Layout(
        id=message.frame_id,
        length=message.length,
        flags=(FD if message.is_fd else 0) | (BRS if brs else 0),
        signals=names,
        places=tuple(Place(s.start, s.length, s.is_float) for s in fields),
        units=tuple(s.unit for s in fields),
        scale=tuple(float(s.scale) for s in fields),
        low=tuple(float(s.minimum) for s in fields),
        high=tuple(float(s.maximum) for s in fields),
        exact=fields[0].is_float,
    )


def compile_message(message: Any, *signals: str) -> Codec:
    """Turn a cantools message into a struct codec; `signals` are the names expected, in order of position."""
    of = layout_of(message, *signals)
    fields = sorted(message.signals, key=lambda s: s.start)
    layout, at = "<", 0
    for s in fields:
        if s.start // 8 == at - 1 and s.start % 8 + s.length <= 8:
            continue  # upper half of the byte that the signal before it opened
        key = (s.length, s.is_signed or s.is_float, s.is_float)
        start = s.start // 8
        if s.start % 8 or key not in _CODES:
            raise ProtocolError(f"DBC: {message.name}.{s.name} is not a little-endian field on a byte")
        layout += f"{start - at}x" + ("" if s.name == "CRC" else _CODES[key])
        at = start + max(1, s.length // 8)
    check = signals[-1] == "CRC"
    if at != message.length or (check and fields[-1].length != 8):
        raise ProtocolError(f"DBC: the last field of {message.name} is not its last byte")
    return Codec(
        id=of.id,
        length=of.length,
        flags=of.flags,
        pack=struct.Struct(layout).pack,
        unpack=struct.Struct(layout + "x" * check).unpack,
        scale=of.scale,
        low=of.low,
        high=of.high,
    )
