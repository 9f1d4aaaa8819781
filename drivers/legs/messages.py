"""The messages of legs.dbc that a run uses: those of its layout, their forces in newtons.

The short force fields, of the classic command and the fd feedback, count in per cent of the drives' rated
force. That is said once, in `drives.force_limit_N`; both ends, the log's copy of the DBC and the checksum of
a drive's set-up take it from there.
"""

import re
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

from cantools.database.can import Database

from drivers.errors import ConfigurationError, ProtocolError
from drivers.legs.kernels import check
from drivers.protocol import BRS, FD, Frame

COMMANDS = {
    "classic": (("COMMAND_CLASSIC_A", "COMMAND_CLASSIC_B"), ("COMMAND_CLASSIC_A",)),
    "fd": (("COMMAND_FD",), ("COMMAND_FD_SHORT",)),
    "ideal": (("COMMAND_IDEAL",), ("COMMAND_IDEAL",)),
}
"""Of each layout; the second ones of a bus with SHORT legs or fewer."""
SHORT = 3
RATED_N = 0.001, 4294967.295
"""Least and largest rated force that the checksum of a set-up can carry, N."""
_SHARE = re.compile(r'\(([\d.]+),0\) \[(-[\d.]+)\|([\d.]+)\] "%"')


class Layout(NamedTuple):
    """One message of a DBC: little-endian fields that do not overlap, in order of position."""

    id: int
    length: int
    flags: int
    signals: tuple[str, ...]
    places: tuple[tuple[int, int], ...]
    """First bit and bits of each field; a field of 64 bits is a float64."""
    scale: tuple[float, ...]
    low: tuple[float, ...]
    """Ranges in SI."""
    high: tuple[float, ...]

    def place(self, signal: str) -> tuple[int, int]:
        """Return first bit and bits of a field."""
        return self.places[self.signals.index(signal)]

    def pack(self, *values: int) -> bytes:
        """Return the bytes with the low bits of whole numbers in the first fields."""
        fields = zip(values, self.places, strict=False)
        whole = sum((value & (1 << bits) - 1) << start for value, (start, bits) in fields)
        return whole.to_bytes(self.length, "little")

    def unpack(self, data: bytes) -> list[int]:
        """Return the fields as whole numbers that are not negative."""
        whole = int.from_bytes(data, "little")
        return [whole >> start & (1 << bits) - 1 for start, bits in self.places]

    def frame(self, identifier: int, *values: int) -> Frame:
        """Return the frame with whole numbers in all fields but the last, which is the CRC-8."""
        data = self.pack(*values)[:-1]
        return Frame(identifier, data + bytes([check(identifier, data, 1)]), self.flags)


def read_dbc(package: str, name: str) -> str:
    """Return the text of a DBC of ours, for the log and for other tools."""
    return resources.files(package).joinpath(name).read_text(encoding="ascii")


@cache
def parsed(dbc: str) -> Database:
    """Return the messages of a DBC text; parsed once, for all who read them, and for reading only."""
    database = Database()
    database.add_dbc_string(dbc)
    return database


def layout_of(message: Any, rated_N: float = 100.0) -> Layout:
    """Return the layout of a cantools message; its fields in per cent are of a rated force.

    Raises ProtocolError for fields that the kernels cannot read.
    """
    fields = sorted(message.signals, key=lambda s: s.start)
    for s in fields:  # they do not overlap: the parser sees to that
        if s.byte_order != "little_endian" or s.offset or (s.start % 8 and s.length > 32):
            raise ProtocolError(f"DBC: {message.name}.{s.name} is no little-endian field that can be read")
    brs = "CANFD_BRS" in message.dbc.attributes and str(message.dbc.attributes["CANFD_BRS"].value) == "1"
    units = [rated_N / 100.0 if s.unit == "%" else 1.0 for s in fields]

    def times(values: list[float]) -> tuple[float, ...]:
        return tuple(float(value) * unit for value, unit in zip(values, units, strict=True))

    return Layout(
        id=message.frame_id,
        length=message.length,
        flags=(FD if message.is_fd else 0) | (BRS if brs else 0),
        signals=tuple(s.name for s in fields),
        places=tuple((s.start, s.length) for s in fields),
        scale=times([s.scale for s in fields]),
        low=times([s.minimum for s in fields]),
        high=times([s.maximum for s in fields]),
    )


def read_messages(rated_force_N: float) -> tuple[str, int, dict[str, Layout]]:
    """Return legs.dbc with the forces in N, the version of the protocol, and the messages by their names.

    Raises ConfigurationError for a force that the checksum of a set-up cannot carry.
    """
    if not RATED_N[0] <= rated_force_N <= RATED_N[1]:
        raise ConfigurationError(
            f"drives.force_limit_N: out of range for protocol legs, allowed: {RATED_N[0]:g} to "
            f"{RATED_N[1]:.12g}, given: {rated_force_N:g}"
        )
    text = read_dbc("drivers.legs", "legs.dbc")
    database = parsed(text)

    def newtons(found: re.Match[str]) -> str:
        scale, low, high = (float(number) * (rated_force_N / 100.0) for number in found.groups())
        return f'({scale!r},0) [{low!r}|{high!r}] "N"'

    version = int((database.version or "").partition(".")[0])
    messages = {message.name: layout_of(message, rated_force_N) for message in database.messages}
    return _SHARE.sub(newtons, text), version, messages


def set_up_checksum(identifier: int, config: bytes, rated_force_N: float) -> int:
    """Return what a status says of a set-up: of its CONFIG without the CRC and the drive's rated force."""
    return check(identifier, config + round(rated_force_N * 1e3).to_bytes(4, "little"), 2)
