"""Newest tick of a run in a memory file, readable by any process of this user.

The recorder writes; readers copy and cannot delay it. The file lies in the runtime folder. It holds a
description, then one piece that the next piece overwrites; a CRC shows whether the piece is whole.
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
"""Size in bytes of the description that follows."""
_PIECE = struct.Struct("<QQQQ")
"""Number, end flag, bytes of the content that follows, and CRC."""
_LARGEST = 1 << 18
"""Bytes reserved for a piece."""

_FIGURES = "seen_ns ticks stale skipped late_ns compute_ns dropped waiting capacity log_bytes"
FIGURES = np.dtype([(name, "<i8") for name in _FIGURES.split()])
"""Figures of the recorder: time at which the newest tick was first seen (CLOCK_MONOTONIC, ns); ticks, stale
ticks and skipped periods so far; largest lateness and step time of the last one to two seconds; ticks
lost; ticks that wait in the ring, and its capacity; bytes in the log."""


def mirror_path(interface: str, channel: str) -> Path:
    """File in which the controller's recorder on a bus shows its newest tick."""
    return runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.mirror"


class Piece(NamedTuple):
    """Newest row, figures and events at one instant."""

    number: int
    """Number of pieces written so far."""
    ended: bool
    """True if no piece follows."""
    row: np.void
    """One element of the table's dtype."""
    figures: np.void
    """One element of FIGURES."""
    events: list[dict[str, Any]]
    """Last events: number, t_ns, level, text."""


class Mirror:
    """Writer's end of the mirror. Mutable state: the file, the number of pieces, the last piece.

    Raises OSError if the file cannot be created.
    """

    def __init__(self, path: Path, about: Mapping[str, object]) -> None:
        """Create the file; `about` describes the run, with `version` of hil and `columns` as JSON."""
        text = json.dumps(about).encode()
        self._path, self._at = path, _ABOUT.size + len(text)
        self._number, self._content = 0, b""
        new = path.with_name(f"{path.name}.{os.getpid()}")
        self._fd = os.open(new, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        os.pwrite(self._fd, _ABOUT.pack(len(text)) + text, 0)
        os.posix_fallocate(self._fd, self._at, _LARGEST)  # a full memory fails here, not later
        new.replace(path)  # readers of an earlier run keep its file

    def write(self, row: np.void | Rows, figures: Rows, events: bytes = b"[]") -> None:
        """Write a row of the table, figures () of FIGURES and events as a JSON list."""
        self._number, self._content = self._number + 1, row.tobytes() + figures.tobytes() + events
        self._put(ended=False)

    def close(self) -> None:
        """Mark the last piece as final and remove the file; open readers keep the last piece."""
        self._put(ended=True)
        with contextlib.suppress(OSError):
            if self._path.stat().st_ino == os.fstat(self._fd).st_ino:  # not the file of a later run
                self._path.unlink()
        os.close(self._fd)

    def _put(self, *, ended: bool) -> None:
        content = self._content
        head = _PIECE.pack(self._number, ended, len(content), _crc(self._number, ended, content))
        os.pwrite(self._fd, head + content, self._at)


def _crc(number: int, ended: int, content: bytes) -> int:
    """Checksum of a piece and its head: the head may be new while the rest is old."""
    return zlib.crc32(content, (2 * number + ended) & 0xFFFFFFFF)


class MirrorReader:
    """Read-only reader's end of the mirror. State: the mapping.

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
        self.dtype = Table("", columns_of(self.about["columns"])).dtype

    @property
    def newest(self) -> int:
        """Number of the newest piece; 0 before the first."""
        number, *_ = _PIECE.unpack_from(self._map, self._at)
        return int(number)

    def read(self) -> Piece | None:
        """Newest piece; None before the first, or while one is being written."""
        number, ended, size, crc = _PIECE.unpack_from(self._map, self._at)
        start = self._at + _PIECE.size
        content = self._map[start : start + size]
        if not number or _crc(number, ended, content) != crc:
            return None
        first, second = self.dtype.itemsize, self.dtype.itemsize + FIGURES.itemsize
        row = np.frombuffer(content[:first], self.dtype)[0]
        figures = np.frombuffer(content[first:second], FIGURES)[0]
        return Piece(number, bool(ended), row, figures, json.loads(content[second:]))
