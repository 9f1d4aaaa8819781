"""Files of CAN frames that other tools read: candump, ASC, BLF. Frames are written one by one.

Times are UTC in ns. candump and ASC carry them in microseconds. BLF has nanoseconds from a start in whole
milliseconds; its writer takes seconds as a float, which is good to a quarter of a microsecond. ASC states its
start in local time, without a zone, as its readers expect.
"""

import re
from bisect import bisect_left
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Protocol

import can
from can.io.blf import BLFWriter

from drivers.can.bus_time import FD_LENGTHS
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame

ERROR_FLAG = 0x2000_0000
"""Of an identifier in candump's form: an error frame."""
_NS = 1_000_000_000
_DAYS = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


class FrameWriter(Protocol):
    """A file of frames being written."""

    def write(self, utc_ns: int, frame: Frame, *, sent: bool) -> None:
        """Add a frame. Its time is not before that of the first."""

    def close(self) -> None:
        """Write what is left and close the file."""


class CandumpWriter:
    """What `candump -L` writes: canplayer and Wireshark read it. It has no room for the direction."""

    def __init__(self, path: Path, channels: Sequence[str]) -> None:
        self._file = path.open("w", encoding="ascii")
        self._channels = [re.sub(r"[^A-Za-z0-9_.-]", "_", each) or "can0" for each in channels]

    def write(self, utc_ns: int, frame: Frame, *, sent: bool) -> None:
        """Add a frame."""
        del sent
        identifier, data, flags = frame
        if flags & ERROR:
            identifier |= ERROR_FLAG
        head = f"{identifier:08X}" if flags & (EXTENDED | ERROR) else f"{identifier:03X}"
        if flags & FD:
            body = f"##{(flags & BRS > 0) | (flags & ESI > 0) << 1:X}{data.hex().upper()}"
        else:
            body = "#R" if flags & REMOTE else f"#{data.hex().upper()}"
        us = _microseconds(utc_ns)
        named = frame.bus < len(self._channels)
        channel = self._channels[frame.bus] if named else f"{self._channels[0]}_{frame.bus}"
        self._file.write(f"({us // 1_000_000}.{us % 1_000_000:06d}) {channel} {head}{body}\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class AscWriter:
    """Vector's ASCII log. Mutable state: the second at which its times begin, of the first frame."""

    def __init__(self, path: Path, channels: Sequence[str]) -> None:
        del channels
        self._file = path.open("w", encoding="ascii")
        self._start_us = -1

    def write(self, utc_ns: int, frame: Frame, *, sent: bool) -> None:
        """Add a frame."""
        us = _microseconds(utc_ns)
        if self._start_us < 0:
            self._begin(us // 1_000_000)
        t = us - self._start_us
        self._file.write(f"{t // 1_000_000:3d}.{t % 1_000_000:06d} {_asc(frame, 'Tx' if sent else 'Rx')}\n")

    def _begin(self, start_s: int) -> None:
        self._start_us = start_s * 1_000_000
        local = datetime.fromtimestamp(start_s).astimezone()
        date = (
            f"{_DAYS[local.weekday()]} {_MONTHS[local.month - 1]} {local.day:02d} "
            f"{local:%H:%M:%S}.000 {local.year}"
        )
        self._file.write(
            f"date {date}\nbase hex  timestamps absolute\ninternal events logged\nBegin Triggerblock {date}\n"
        )

    def close(self) -> None:
        """Write the end and close the file."""
        if self._start_us >= 0:
            self._file.write("End TriggerBlock\n")
        self._file.close()


def _asc(frame: Frame, direction: str) -> str:
    """Return a frame as ASC has it behind the time."""
    identifier, data, flags = frame
    channel = frame.bus + 1
    if flags & ERROR:
        return f"{channel}  ErrorFrame"
    name = f"{identifier:X}{'x' if flags & EXTENDED else ''}"
    content = data.hex(" ").upper()
    if not flags & FD:
        kind = "r 0" if flags & REMOTE else f"d {len(data):x} {content}"
        return f"{channel}  {name:<15} {direction:<4} {kind}".rstrip()
    brs, esi = int(flags & BRS > 0), int(flags & ESI > 0)
    bits = 1 << 12 | brs << 13 | esi << 14
    code = bisect_left(FD_LENGTHS, len(data))
    return (
        f"CANFD {channel:>3} {direction:<4} {name:>8}  {'':>32} {brs} {esi} {code:x} "
        f"{len(data):>2} {content} {0:>8} {0:>4} {bits:>8X} {0:>8} {0:>8} {0:>8} {0:>8} {0:>8}"
    )


class BlfWriter:
    """Vector's binary log, by python-can."""

    def __init__(self, path: Path, channels: Sequence[str]) -> None:
        del channels
        self._file = path.open("wb")
        self._writer = BLFWriter(self._file)

    def write(self, utc_ns: int, frame: Frame, *, sent: bool) -> None:
        """Add a frame."""
        flags = frame.flags
        self._writer.on_message_received(
            can.Message(
                timestamp=utc_ns / _NS,
                arbitration_id=frame.id,
                is_extended_id=bool(flags & EXTENDED),
                is_remote_frame=bool(flags & REMOTE),
                is_error_frame=bool(flags & ERROR),
                is_fd=bool(flags & FD),
                is_rx=not sent,
                bitrate_switch=bool(flags & BRS),
                error_state_indicator=bool(flags & ESI),
                channel=frame.bus,
                data=frame.data,
            )
        )

    def close(self) -> None:
        """Write the last container and the header, and close the file."""
        with self._file:  # the writer leaves it open where the disk is full
            self._writer.stop()


def _microseconds(utc_ns: int) -> int:
    return (utc_ns + 500) // 1000


WRITERS: dict[str, type[CandumpWriter | AscWriter | BlfWriter]] = {
    "candump": CandumpWriter,
    "asc": AscWriter,
    "blf": BlfWriter,
}
"""Format -> its writer."""
