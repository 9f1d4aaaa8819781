"""The newest tick of a run in a file of memory, for any process of this user that wants to look.

The recorder writes; others copy from it and cannot hold it up. The file lies in the runtime folder: a
description, and behind it one piece, which the next one overwrites; its CRC shows whether it is whole.
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
"""Bytes of the description, which follows."""
_PIECE = struct.Struct("<QQQQ")
"""Number, whether nothing follows, bytes of the content, which stands behind, and its CRC."""
_LARGEST = 1 << 18
"""Bytes of a piece, for which there is room."""

_FIGURES = "seen_ns ticks stale skipped late_ns compute_ns dropped waiting capacity log_bytes"
FIGURES = np.dtype([(name, "<i8") for name in _FIGURES.split()])
"""Of the recorder: when the newest tick was first seen (CLOCK_MONOTONIC, ns); ticks, stale ticks and skipped
periods so far; largest lateness and step time of the last one to two seconds; ticks lost, ticks that wait in
the ring, its room; bytes in the log."""


def mirror_path(interface: str, channel: str) -> Path:
    """Return where the controller's recorder on a bus shows its newest tick."""
    return runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.mirror"


class Piece(NamedTuple):
    """What was newest at one instant."""

    number: int
    """Counts what has been written."""
    ended: bool
    """Whether nothing follows."""
    row: np.void
    """Of the table's dtype."""
    figures: np.void
    """Of FIGURES."""
    events: list[dict[str, Any]]
    """The last ones: number, t_ns, level, text."""


class Mirror:
    """The writer's end. Mutable state: the file, how many pieces were written, and the last one.

    Raises OSError where the file cannot be made.
    """

    def __init__(self, path: Path, about: Mapping[str, object]) -> None:
        """Make the file; `about` describes the run, with `version` of hil and `columns` as JSON."""
        text = json.dumps(about).encode()
        self._path, self._at = path, _ABOUT.size + len(text)
        self._number, self._content = 0, b""
        new = path.with_name(f"{path.name}.{os.getpid()}")
        self._fd = os.open(new, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        os.pwrite(self._fd, _ABOUT.pack(len(text)) + text, 0)
        os.posix_fallocate(self._fd, self._at, _LARGEST)  # a full memory is refused here and not later
        new.replace(path)  # readers of an earlier run keep theirs

    def write(self, row: np.void | Rows, figures: Rows, events: bytes = b"[]") -> None:
        """Show a row of the table, figures () of FIGURES and events, a JSON list."""
        self._number, self._content = self._number + 1, row.tobytes() + figures.tobytes() + events
        self._put(ended=False)

    def close(self) -> None:
        """Mark the last piece as such and remove the file; who has opened it keeps what was shown last."""
        self._put(ended=True)
        with contextlib.suppress(OSError):
            if self._path.stat().st_ino == os.fstat(self._fd).st_ino:  # not that of a run that has followed
                self._path.unlink()
        os.close(self._fd)

    def _put(self, *, ended: bool) -> None:
        content = self._content
        head = _PIECE.pack(self._number, ended, len(content), _crc(self._number, ended, content))
        os.pwrite(self._fd, head + content, self._at)


def _crc(number: int, ended: int, content: bytes) -> int:
    """Return the checksum of a piece: of its head, too, which may be new where the rest is old."""
    return zlib.crc32(content, (2 * number + ended) & 0xFFFFFFFF)


class MirrorReader:
    """The reader's end, read-only. State: the mapping.

    Raises FileNotFoundError where nothing runs, LogError where another version of this program does.
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
            raise LogError(f"{path} is of another version of hil: use the version that runs there")
        self.dtype = Table("", columns_of(self.about["columns"])).dtype

    @property
    def newest(self) -> int:
        """Number of the newest piece; 0 while there is none."""
        number, *_ = _PIECE.unpack_from(self._map, self._at)
        return int(number)

    def read(self) -> Piece | None:
        """Return the newest piece; None while there is none, or where it is being written just now."""
        number, ended, size, crc = _PIECE.unpack_from(self._map, self._at)
        start = self._at + _PIECE.size
        content = self._map[start : start + size]
        if not number or _crc(number, ended, content) != crc:
            return None
        first, second = self.dtype.itemsize, self.dtype.itemsize + FIGURES.itemsize
        row = np.frombuffer(content[:first], self.dtype)[0]
        figures = np.frombuffer(content[first:second], FIGURES)[0]
        return Piece(number, bool(ended), row, figures, json.loads(content[second:]))
