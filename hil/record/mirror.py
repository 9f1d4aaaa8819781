"""The newest tick of a run in shared memory, for any process of this user that wants to look.

The recorder writes; others map the file read-only and copy from it: they cannot hold it up, and it does not
know of them. A file in the runtime folder, mode 0600: a head, a description that never changes, and SLOTS
places that are filled in turn. A place carries its number and the CRC of its content: what a reader returns
was written as one piece.
"""

import contextlib
import json
import mmap
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import LogError
from hil.record.ring import fence
from hil.record.row import Table, columns_of

MAGIC = int.from_bytes(b"HILMIR01", "little")
"""Format and its version."""
SLOTS = 4
SLOT_BYTES = 32768
"""Room for one piece, its three words included."""
HEAD_BYTES = 65536
"""Room for the four words of the head and the description."""
_MAGIC, _LENGTH, _NEWEST, _ENDED = range(4)
"""Words of the head."""
_NUMBER, _SIZE, _CRC = range(3)
"""Words of a place."""
_WORDS = 32
"""Bytes before the content, of head and place."""
_ATTEMPTS = 1000

FIGURES = np.dtype(
    [
        ("seen_ns", "<i8"),
        ("ticks", "<i8"),
        ("stale", "<i8"),
        ("skipped", "<i8"),
        ("late_ns", "<i8"),
        ("compute_ns", "<i8"),
        ("dropped", "<i8"),
        ("waiting", "<i8"),
        ("capacity", "<i8"),
        ("log_bytes", "<i8"),
    ]
)
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
    row: np.void
    """Of the table's dtype."""
    figures: np.void
    """Of FIGURES."""
    events: list[dict[str, Any]]
    """The last ones: number, t_ns, level, text."""


class Mirror:
    """The writer's end. Mutable state: the mapping and how many pieces were written.

    Raises OSError where the file cannot be made.
    """

    def __init__(self, path: Path, about: Mapping[str, object]) -> None:
        """Make the file; `about` is its description, with `columns` as `hil.record.row.describe` gives it."""
        text = json.dumps(about).encode()
        if len(text) > HEAD_BYTES - _WORDS:
            raise OSError(0, f"a description of {len(text)} bytes; allowed: {HEAD_BYTES - _WORDS}", str(path))
        self._path = path
        size = HEAD_BYTES + SLOTS * SLOT_BYTES
        new = path.with_name(f"{path.name}.{os.getpid()}")
        new.unlink(missing_ok=True)
        fd = os.open(new, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            os.posix_fallocate(fd, 0, size)  # a full memory is refused here, not by a signal later
            self._inode = os.fstat(fd).st_ino
            self._map = mmap.mmap(fd, size)
        except BaseException:
            new.unlink()
            raise
        finally:
            os.close(fd)
        self._words = memoryview(self._map).cast("q")
        self._words[_LENGTH] = len(text)
        self._map[_WORDS : _WORDS + len(text)] = text
        self._words[_MAGIC] = MAGIC
        self._number = 0
        new.replace(path)  # readers of an earlier run keep theirs

    def write(self, row: np.void | Rows, figures: Rows, events: bytes = b"[]") -> None:
        """Show a row of the table, figures () of FIGURES and events, a JSON list that fits a place."""
        data = row.tobytes() + figures.tobytes() + events
        if len(data) > SLOT_BYTES - _WORDS:
            raise ValueError(f"a piece of {len(data)} bytes; allowed: {SLOT_BYTES - _WORDS}")
        self._number += 1
        at = _place(self._number)
        words, word = self._words, at // 8
        words[word + _NUMBER] = -1
        fence()
        self._map[at + _WORDS : at + _WORDS + len(data)] = data
        words[word + _SIZE] = len(data)
        words[word + _CRC] = zlib.crc32(data)
        fence()
        words[word + _NUMBER] = self._number
        fence()
        words[_NEWEST] = self._number

    def close(self) -> None:
        """Say that nothing follows, and remove the file; who has mapped it keeps what was shown last."""
        self._words[_ENDED] = 1
        with contextlib.suppress(OSError):
            if self._path.stat().st_ino == self._inode:  # not that of a run that has followed
                self._path.unlink()


class MirrorReader:
    """The reader's end, read-only. Mutable state: the mapping."""

    def __init__(self, path: Path) -> None:
        """Map the file.

        Raises
        ------
        FileNotFoundError
            Nothing runs there.
        LogError
            It is no mirror, or that of another version of this program.

        """
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
        try:
            status = os.fstat(fd)
            self.inode = status.st_ino
            if status.st_size != HEAD_BYTES + SLOTS * SLOT_BYTES:
                raise foreign(path)
            self._map = mmap.mmap(fd, status.st_size, access=mmap.ACCESS_READ)
        finally:
            os.close(fd)
        self._words = memoryview(self._map).cast("q")
        if self._words[_MAGIC] != MAGIC:
            raise foreign(path)
        try:
            self.about: dict[str, Any] = json.loads(self._map[_WORDS : _WORDS + self._words[_LENGTH]])
            self.dtype = Table("", columns_of(self.about["columns"])).dtype
        except (ValueError, KeyError, TypeError) as error:
            raise foreign(path) from error

    @property
    def ended(self) -> bool:
        """Whether the writer has closed it."""
        return bool(self._words[_ENDED])

    @property
    def newest(self) -> int:
        """Number of the newest piece; 0 while there is none."""
        return int(self._words[_NEWEST])

    def read(self) -> Piece | None:
        """Return the newest piece; None while there is none, or the writer was too fast a thousand times.

        Raises ValueError or LookupError where the writer, of another version, has figures of another size.
        """
        for _ in range(_ATTEMPTS):
            number = self._words[_NEWEST]
            if number == 0:
                return None
            fence()
            at = _place(number)
            word = at // 8
            before, size, crc = (self._words[word + each] for each in (_NUMBER, _SIZE, _CRC))
            fence()
            data = self._map[at + _WORDS : at + _WORDS + max(0, min(size, SLOT_BYTES - _WORDS))]
            fence()
            if before == number == self._words[word + _NUMBER] and zlib.crc32(data) == crc:
                return self._piece(number, data)
        return None

    def _piece(self, number: int, data: bytes) -> Piece:
        first, second = self.dtype.itemsize, self.dtype.itemsize + FIGURES.itemsize
        row = np.frombuffer(data[:first], self.dtype)[0]
        figures = np.frombuffer(data[first:second], FIGURES)[0]
        return Piece(number, row, figures, json.loads(data[second:]))


def _place(number: int) -> int:
    return HEAD_BYTES + number % SLOTS * SLOT_BYTES


def foreign(path: Path) -> LogError:
    """Return the error for a file that is no mirror, or that of another version."""
    return LogError(f"{path} is not what this version of hil shows of a run: use the version that runs there")
