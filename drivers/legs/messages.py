"""The messages of legs.dbc that a run uses: those of its layout, with forces in newtons.

The short force fields, of the classic command and the fd feedback, count in per cent of the drives' rated
force. `drives.force_limit_N` sets it for both ends, the log's copy of the DBC and the checksum of a drive's
set-up.
"""

import re
from functools import cache
from importlib import resources
from typing import NamedTuple

from drivers.errors import ConfigurationError
from drivers.legs.crc import check
from drivers.protocol import BRS, FD, Frame

COMMANDS = {
    "classic": (("COMMAND_CLASSIC_A", "COMMAND_CLASSIC_B"), ("COMMAND_CLASSIC_A",)),
    "fd": (("COMMAND_FD",), ("COMMAND_FD_SHORT",)),
    "ideal": (("COMMAND_IDEAL",), ("COMMAND_IDEAL",)),
}
"""Command messages of each layout; the second tuple is for a bus with SHORT legs or fewer."""
SHORT = 3
RATED_N = 0.001, 4294967.295
"""Smallest and largest rated force that the checksum of a set-up can carry, N."""
_MESSAGE = re.compile(r"^BO_ (\d+) (\w+): (\d+) \w+\n((?: SG_ .*\n)+)", re.MULTILINE)
_SIGNAL = re.compile(r' SG_ (\w+) : (\d+)\|(\d+)@1[+-] \((.+),0\) \[(.+)\|(.+)\] "(.*)"')
_KIND = re.compile(r'^BA_ "(VFrameFormat|CANFD_BRS)" BO_ (\d+) (\d+);', re.MULTILINE)
_FD_FORMAT = 14
"""VFrameFormat of a CAN FD frame with an identifier of 11 bits."""
_SHARE = re.compile(r'\(([\d.]+),0\) \[(-[\d.]+)\|([\d.]+)\] "%"')


class Layout(NamedTuple):
    """One message of a DBC file: little-endian fields that do not overlap, in order of position."""

    id: int
    length: int
    flags: int
    signals: tuple[str, ...]
    places: tuple[tuple[int, int], ...]
    """(first bit, number of bits) of each field; a field of 64 bits is a float64."""
    scale: tuple[float, ...]
    low: tuple[float, ...]
    """Ranges of the fields, SI units."""
    high: tuple[float, ...]

    def place(self, signal: str) -> tuple[int, int]:
        """(first bit, number of bits) of a signal."""
        return self.places[self.signals.index(signal)]

    def pack(self, *values: int) -> bytes:
        """Data bytes of the message; two's-complement integers fill the first fields, 0 the others."""
        fields = zip(values, self.places, strict=False)
        whole = sum((value & (1 << bits) - 1) << start for value, (start, bits) in fields)
        return whole.to_bytes(self.length, "little")

    def unpack(self, data: bytes) -> list[int]:
        """Raw values of all fields, as unsigned integers."""
        whole = int.from_bytes(data, "little")
        return [whole >> start & (1 << bits) - 1 for start, bits in self.places]

    def frame(self, identifier: int, *values: int) -> Frame:
        """Frame of the message; integers fill all fields but the last one, which gets the CRC-8."""
        data = self.pack(*values)[:-1]
        return Frame(identifier, data + bytes([check(identifier, data, 1)]), self.flags)


def read_dbc(package: str, name: str) -> str:
    """Text of a DBC file of this project, for the log and for other tools."""
    return resources.files(package).joinpath(name).read_text(encoding="ascii")


@cache
def layouts(dbc: str, rated_N: float = 100.0) -> dict[str, Layout]:
    """Messages, by name, of a DBC file of this project; rated_N: force, N, of 100 per cent.

    cantools could read it, too, but its import takes a third of a second.
    """
    kinds = {(name, int(identifier)): int(value) for name, identifier, value in _KIND.findall(dbc)}
    found = {}
    for identifier, name, length, fields in _MESSAGE.findall(dbc):
        signals = sorted(_SIGNAL.findall(fields), key=lambda signal: int(signal[1]))
        names, starts, bits, *numbers, units = zip(*signals, strict=True)
        factors = [rated_N / 100.0 if unit == "%" else 1.0 for unit in units]
        scale, low, high = (
            tuple(float(number) * factor for number, factor in zip(each, factors, strict=True))
            for each in numbers
        )
        fd = FD * (kinds.get(("VFrameFormat", int(identifier))) == _FD_FORMAT)
        flags = fd | BRS * kinds.get(("CANFD_BRS", int(identifier)), 0)
        places = tuple(zip(map(int, starts), map(int, bits), strict=True))
        found[name] = Layout(int(identifier), int(length), flags, names, places, scale, low, high)
    return found


def read_messages(rated_force_N: float) -> tuple[str, int, dict[str, Layout]]:
    """(text of legs.dbc with forces in N, protocol version, messages by name) for a rated force, N.

    Raises ConfigurationError for a force that the set-up checksum cannot include: see RATED_N.
    """
    if not RATED_N[0] <= rated_force_N <= RATED_N[1]:
        raise ConfigurationError(
            f"drives.force_limit_N: out of range for protocol legs, allowed: {RATED_N[0]:g} to "
            f"{RATED_N[1]:.12g}, given: {rated_force_N:g}"
        )
    text = read_dbc("drivers.legs", "legs.dbc")

    def newtons(found: re.Match[str]) -> str:
        scale, low, high = (float(number) * (rated_force_N / 100.0) for number in found.groups())
        return f'({scale!r},0) [{low!r}|{high!r}] "N"'

    version = int(text.removeprefix('VERSION "').partition(".")[0])
    return _SHARE.sub(newtons, text), version, layouts(text, rated_force_N)


def set_up_checksum(identifier: int, config: bytes, rated_force_N: float) -> int:
    """CRC-16 that a drive's status reports of its set-up: CONFIG data without CRC, and rated force in mN."""
    return check(identifier, config + round(rated_force_N * 1e3).to_bytes(4, "little"), 2)
