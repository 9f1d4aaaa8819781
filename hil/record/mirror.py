"""Newest tick of a run in a memory file, readable by any process of this user.

The recorder writes; readers copy and cannot delay it. The file lies in the runtime folder. The
file holds a description of the run, then the newest content; a CRC shows whether the content is whole.
"""

import contextlib
import json
import mmap
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import LogError
from hil.record.environment import product_version
from hil.record.row import Table, columns_of

_ABOUT = struct.Struct("<Q")
"""Size in bytes of the description of the run, which follows."""
_PIECE = struct.Struct("<QQQQ")
"""Head of the content: number, end flag, size of the content in bytes, CRC."""
_LARGEST = 1 << 18
"""Bytes reserved for the content."""
PAST_ROWS, PAST_STEP = 1000, 3
"""Earlier rows kept after the content, one of every third piece: a minute of them at 50 pieces a second."""

_FIGURES = "seen_ns ticks stale skipped late_ns compute_ns dropped waiting capacity log_bytes"
FIGURES = np.dtype([(name, "<i8") for name in _FIGURES.split()])
"""Figures of the recorder: time at which the newest tick was first seen (CLOCK_MONOTONIC, ns); ticks, stale
ticks and skipped periods so far; largest lateness and step time of the last one to two seconds; ticks
lost; ticks that wait in the ring, and its capacity; bytes in the log."""


def mirror_path(interface: str, channel: str) -> Path:
    """Path of the mirror file with the newest tick of the controller on a CAN bus."""
    return runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.mirror"


class Piece(NamedTuple):
    """Content of the mirror file at one instant: newest row, figures, last events."""

    number: int
    """Number of times the content was written so far."""
    ended: bool
    """True if the run has ended: the content is final."""
    row: np.void
    """Newest row of the run's table."""
    figures: np.void
    """Figures of the recorder, an element of FIGURES."""
    events: list[dict[str, Any]]
    """Last events: number, t_ns, level, text."""


class Mirror:
    """Writer of the mirror file. Mutable state: the file, the number of pieces, the last piece.

    Raises OSError if the file cannot be created.
    """

    def __init__(self, path: Path, about: Mapping[str, object]) -> None:
        """Create the file; `about` describes the run: `version` of hil, `columns` as JSON text, and more."""
        text = json.dumps(about).encode()
        self._path, self._at = path, _ABOUT.size + len(text)
        self._number, self._content = 0, b""
        self._past = _past_dtype(about["columns"])
        new = path.with_name(f"{path.name}.{os.getpid()}")
        self._fd = os.open(new, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        os.pwrite(self._fd, _ABOUT.pack(len(text)) + text, 0)
        os.posix_fallocate(
            self._fd, self._at, _LARGEST + PAST_ROWS * self._past.itemsize
        )  # a full memory fails here, not later
        new.replace(path)  # readers of an earlier run keep its file

    def write(self, row: np.void | Rows, figures: Rows, events: bytes = b"[]") -> None:
        """Replace the content: a row of the run's table, figures () of FIGURES, events as a JSON list."""
        data = row.tobytes()
        if self._number % PAST_STEP == 0:
            slot = self._number // PAST_STEP % PAST_ROWS
            kept = zlib.crc32(data).to_bytes(4, "little") + data
            os.pwrite(self._fd, kept, self._at + _LARGEST + slot * self._past.itemsize)
        self._number, self._content = self._number + 1, data + figures.tobytes() + events
        self._put(ended=False)

    def close(self) -> None:
        """Mark the run as ended and remove the file; open readers keep its last content."""
        self._put(ended=True)
        with contextlib.suppress(OSError):
            if self._path.stat().st_ino == os.fstat(self._fd).st_ino:  # not the file of a later run
                self._path.unlink()
        os.close(self._fd)

    def _put(self, *, ended: bool) -> None:
        content = self._content
        head = _PIECE.pack(self._number, ended, len(content), _crc(self._number, ended, content))
        os.pwrite(self._fd, head + content, self._at)


def _past_dtype(columns: object) -> np.dtype[np.void]:
    """A kept row and its CRC, which shows a reader that the row is whole."""
    return np.dtype([("crc", "<u4"), ("row", Table("", columns_of(str(columns))).dtype)])


def _crc(number: int, ended: int, content: bytes) -> int:
    """Checksum over head and content, which shows a reader that a write between them is not finished."""
    return zlib.crc32(content, (2 * number + ended) & 0xFFFFFFFF)


class MirrorReader:
    """Reader of a mirror file, which cannot delay its writer. State: the memory mapping.

    Raises FileNotFoundError if nothing runs, LogError if another version of this program runs.
    """

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self.inode = os.fstat(file.fileno()).st_ino
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        try:
            (size,) = _ABOUT.unpack_from(self._map)
            self._at = _ABOUT.size + size
            self.about: dict[str, Any] = json.loads(self._map[_ABOUT.size : self._at])
            known = self.about["version"] == product_version()
        except (struct.error, ValueError, KeyError, TypeError):
            known = False
        if not known:
            raise LogError(
                f"{path} was written by another version of hil: use the version of the running controller"
            )
        self._past = _past_dtype(self.about["columns"])
        self.dtype = self._past["row"]

    @property
    def newest(self) -> int:
        """Number of times the mirror was written; 0 before the first row."""
        number, *_ = _PIECE.unpack_from(self._map, self._at)
        return int(number)

    def read(self) -> Piece | None:
        """Newest content of the mirror; None before the first row, or while the writer replaces it."""
        number, ended, size, crc = _PIECE.unpack_from(self._map, self._at)
        start = self._at + _PIECE.size
        content = self._map[start : start + size]
        if not number or _crc(number, ended, content) != crc:
            return None
        first, second = self.dtype.itemsize, self.dtype.itemsize + FIGURES.itemsize
        row = np.frombuffer(content[:first], self.dtype)[0]
        figures = np.frombuffer(content[first:second], FIGURES)[0]
        return Piece(number, bool(ended), row, figures, json.loads(content[second:]))

    def past(self) -> Rows:
        """Kept rows (n,) of the last minute, every tick once, in their order."""
        region = self._map[self._at + _LARGEST :][: PAST_ROWS * self._past.itemsize]
        kept = np.frombuffer(region, self._past)
        whole = [k for k, each in enumerate(kept["row"]) if zlib.crc32(each.tobytes()) == kept["crc"][k]]
        rows: Rows = kept["row"][whole]
        return rows[np.unique(rows["tick"], return_index=True)[1]]
