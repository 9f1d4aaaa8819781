"""The folder of a campaign's results: rows as they come, whole after a crash at any instant; then one table.

campaign.json        what the campaign is made of: others are refused
parts/*.parquet      rows in the order in which they were ready, a file for some of them
table.parquet        all rows by number, once all are there; the parts are gone then
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import RLock, Timer
from types import TracebackType
from typing import IO, Self

from drivers.errors import LogError
from drivers.files import made_folder, whole_file
from hil.study.campaign import parquet
from hil.study.campaign.parquet import Column, Row

TABLE = "table.parquet"
MANIFEST = "campaign.json"
_FORMAT = 1
_HALF, _OWN = "tmp" + 8 * "[a-z0-9_]", ("json", "parquet", "html")
"""Names of files that were never finished, and of which kinds they are in the campaign's folder."""
_ROWS, _SECONDS = 1000, 2.0
"""A part is written after so many rows, or so long after its first one."""


class Store:
    """Rows of one campaign on the disk, one process at a time.

    Mutable state: the lock, the rows that are on no disk yet and the timer that writes them, which failed or
    not, the number of the next part.
    """

    def __init__(
        self, folder: Path, columns: list[Column], identity: dict[str, str], *, fresh: bool = False
    ) -> None:
        """Open or make the folder; `fresh` discards the rows that are there, whatever campaign's they are.

        Raises LogError: it is no folder of a campaign, of another one, or in use; or cannot be written.
        """
        self.folder, self._columns, self._identity = folder, columns, identity
        self._waiting: list[Row] = []
        self._access = RLock()
        self._timer: Timer | None = None
        self._failed: LogError | None = None
        try:
            self._refuse_strange()
            made_folder(folder / "parts")
            self._lock = self._locked()
            try:
                self._clear(fresh=fresh)
                self._check()
            except BaseException:
                self._lock.close()
                raise
        except OSError as error:
            raise LogError(f"{folder}: cannot be used: {error.strerror or error}") from None
        self._next = 1 + max((int(p.stem.removeprefix("part-")) for p in _parts(self.folder)), default=-1)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.flush()
        finally:
            self._lock.close()

    def rows(self) -> dict[int, Row]:
        """Return the rows that are there, by number. Raises LogError: a file is damaged or another's."""
        return _rows(self.folder, self._identity)

    def add(self, row: Row) -> None:
        """Take a row in; now and then write what has come. Raises LogError, also of an earlier row."""
        with self._access:
            self._waiting.append(row)
            if self._failed is not None or len(self._waiting) >= _ROWS:
                self.flush()
            elif self._timer is None:
                self._timer = Timer(_SECONDS, self._flush_in_time)
                self._timer.daemon = True
                self._timer.start()

    def flush(self) -> None:
        """Write the rows that have come since as a part, whole and on the disk. Raises LogError."""
        with self._access:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = self._failed = None
            if not self._waiting:
                return
            self._write(self.folder / "parts" / f"part-{self._next:06d}.parquet", self._waiting)
            self._next += 1
            self._waiting = []

    def _flush_in_time(self) -> None:
        """Write what waits, whenever the next row comes; of a failure its writer hears with that row."""
        with self._access:
            try:
                self.flush()
            except LogError as error:
                self._failed = error

    def finish(self, rows: dict[int, Row]) -> Path:
        """Write the table of all rows by number, and remove the parts. Raises LogError."""
        self.flush()
        table = self.folder / TABLE
        if _parts(self.folder) or not table.exists():
            self._write(table, [rows[number] for number in sorted(rows)])
            for part in _parts(self.folder):
                part.unlink()
        return table

    def _write(self, path: Path, rows: list[Row]) -> None:
        try:
            with _durable(path) as temporary:
                parquet.write(temporary, self._columns, rows, _marks(self._identity))
        except OSError as error:
            raise LogError(f"{path}: cannot be written: {error.strerror or error}") from None

    def _refuse_strange(self) -> None:
        """Refuse a folder that holds something, and no campaign: nothing of it is touched."""
        if self.folder.exists() and not self.folder.is_dir():
            raise LogError(f"{self.folder}: is a file; name a folder with --out")
        if not self.folder.is_dir():
            return
        there = {file.name for file in self.folder.iterdir()}
        # a crash may leave `parts` before there is a lock in it; others have folders of that name, too
        begun = there == {"parts"} and not any((self.folder / "parts").iterdir())
        if there and not begun and not (self.folder / "parts" / "lock").is_file():
            raise LogError(
                f"{self.folder}: holds no results of a campaign; name an empty or new folder with --out"
            )

    def _locked(self) -> IO[bytes]:
        file = (self.folder / "parts" / "lock").open("ab")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise LogError(
                f"{self.folder}: another process works on this campaign; wait for it, or name another folder "
                "with --out"
            ) from None
        return file

    def _clear(self, *, fresh: bool) -> None:
        """Remove what a crash has left half written; `fresh`: the rows, too."""
        parts = self.folder / "parts"
        halves = [
            *parts.glob(f"{_HALF}.parquet"),
            *(f for k in _OWN for f in self.folder.glob(f"{_HALF}.{k}")),
        ]
        rows = [*_parts(self.folder), self.folder / TABLE, self.folder / MANIFEST] if fresh else []
        for file in (*halves, *rows):
            file.unlink(missing_ok=True)

    def _check(self) -> None:
        """Take the manifest over, or refuse to mix the rows of two campaigns."""
        manifest = self.folder / MANIFEST
        mine = {"kind": "campaign", "format": _FORMAT, "made_of": self._identity}
        if not manifest.exists():
            with _durable(manifest) as temporary:
                temporary.write_text(json.dumps(mine, indent=1) + "\n", "utf-8")
            return
        _refuse_other(self.folder, self._identity)


def stored_rows(folder: Path, identity: dict[str, str]) -> dict[int, Row]:
    """Return the rows of a campaign that are on the disk, while another process adds to them, too.

    Nothing is written: the folder may be read-only. Raises LogError: another campaign's, or damaged.
    """
    if not (folder / MANIFEST).is_file():
        return {}
    _refuse_other(folder, identity)
    return _rows(folder, identity)


def _refuse_other(folder: Path, identity: dict[str, str]) -> None:
    """Refuse to take the rows of another campaign for those of this one."""
    manifest = folder / MANIFEST
    try:
        there = json.loads(manifest.read_text("utf-8"))
        made_of = dict(there["made_of"]) | {"format": there["format"]}
    except OSError as error:
        raise LogError(f"{manifest}: cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, KeyError, RecursionError):
        raise LogError(
            f"{manifest}: is no manifest of a campaign, or damaged; remove it (files of rows say whose they "
            "are, too), or name another folder with --out"
        ) from None
    now = identity | {"format": _FORMAT}
    changed = [name for name in {**now, **made_of} if now.get(name) != made_of.get(name)]
    if changed:
        raise LogError(
            f"{folder}: its rows are of another campaign, changed since: {', '.join(changed)}; "
            "allowed: to go on with the same ones. Restore them, name another folder with --out, or "
            "discard these rows with `hil campaign --fresh`"
        )


def _rows(folder: Path, identity: dict[str, str]) -> dict[int, Row]:
    found: dict[int, Row] = {}
    for file in (*_parts(folder), folder / TABLE):  # parts go only when the table is there
        with contextlib.suppress(FileNotFoundError):
            found |= {row["row"]: row for row in parquet.read(file, _marks(identity))}
    return found


def _parts(folder: Path) -> list[Path]:
    return sorted((folder / "parts").glob("part-" + 6 * "[0-9]" + ".parquet"))


def _marks(identity: dict[str, str]) -> dict[str, str]:
    """Return what a file of rows says of the campaign that they are of."""
    return {"campaign": json.dumps(identity)}


@contextmanager
def _durable(path: Path) -> Iterator[Path]:
    """Yield a new file that gets its name when its content is on the disk. Raises OSError."""
    with whole_file(path) as temporary:
        yield temporary
        _sync(temporary)
    _sync(path.parent)


def _sync(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
