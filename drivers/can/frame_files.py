"""Writers of files of CAN frames for other tools, one frame at a time: candump, ASC, BLF.

Times are UTC in ns. candump and ASC store microseconds. BLF stores nanoseconds from a start in whole
milliseconds. The writers of python-can take seconds as a float, which resolves a quarter of a microsecond.
ASC states its start in local time, without a zone, as its readers expect.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from can.io.asc import ASCWriter
from can.io.blf import BLFWriter

from drivers.can.link import OWN
from drivers.can.messages import to_message
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame

ERROR_FLAG = 0x2000_0000
"""Flag of an error frame in a candump identifier."""


class CandumpWriter:
    """Writer of the format of `candump -L`, for canplayer and Wireshark. The format has no direction."""

    def __init__(self, path: Path, channels: Sequence[str]) -> None:
        self._file = path.open("w", encoding="ascii")
        self._channels = [re.sub(r"[^A-Za-z0-9_.-]", "_", each) or "can0" for each in channels]

    def write(self, utc_ns: int, frame: Frame, *, sent: bool) -> None:
        """Append a frame at Unix time `utc_ns`, ns; `sent` is ignored, as the format has no direction."""
        del sent
        identifier, data, flags = frame
        if flags & ERROR:
            identifier |= ERROR_FLAG
        head = f"{identifier:08X}" if flags & (EXTENDED | ERROR) else f"{identifier:03X}"
        if flags & FD:
            body = f"##{(flags & BRS > 0) | (flags & ESI > 0) << 1:X}{data.hex().upper()}"
        else:
            body = "#R" if flags & REMOTE else f"#{data.hex().upper()}"
        us = (utc_ns + 500) // 1000
        named = frame.bus < len(self._channels)
        channel = self._channels[frame.bus] if named else f"{self._channels[0]}_{frame.bus}"
        self._file.write(f"({us // 1_000_000}.{us % 1_000_000:06d}) {channel} {head}{body}\n")

    def close(self) -> None:
        """Close the file, with all frames written."""
        self._file.close()


class BlfWriter:
    """Writer of Vector's binary log (BLF), by python-can."""

    def __init__(self, path: Path, _channels: Sequence[str]) -> None:
        self._file: IO[Any] = path.open("wb")
        self._writer: Any = BLFWriter(self._file)

    def write(self, utc_ns: int, frame: Frame, *, sent: bool) -> None:
        """Append a frame at Unix time `utc_ns`, ns, not earlier than the first; sent: True marks it as Tx."""
        identifier, data, flags = frame
        own = OWN if sent else 0
        given = utc_ns, identifier, 0, len(data), flags | own, data
        self._writer.on_message_received(to_message(given, channel=frame.bus))

    def close(self) -> None:
        """Write the last container and the header, and close the file."""
        with self._file:  # the writer leaves it open if the disk is full
            self._writer.stop()


class AscWriter(BlfWriter):
    """Writer of Vector's ASCII log, by python-can. Times count from the second of the first frame."""

    def __init__(self, path: Path, _channels: Sequence[str]) -> None:
        self._file = path.open("w", encoding="ascii")
        self._writer = ASCWriter(self._file)

    def write(self, utc_ns: int, frame: Frame, *, sent: bool) -> None:
        """Append a frame at Unix time `utc_ns`, ns; sent: True marks it as Tx, else Rx."""
        if not self._writer.header_written:
            self._writer.log_event("First frame", utc_ns // 1_000_000_000)
        super().write(utc_ns, frame, sent=sent)


WRITERS: dict[str, type[CandumpWriter | BlfWriter]] = {
    "candump": CandumpWriter,
    "asc": AscWriter,
    "blf": BlfWriter,
}
"""Format -> its writer."""
