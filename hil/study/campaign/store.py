"""Results folder of a campaign: finished rows, safe against a crash at any instant; then one table.

- campaign.sqlite: identity of the campaign, and each row as JSON, on the disk once it is added
- table.parquet: all rows by number, written at the end
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from drivers.errors import LogError
from drivers.files import made_folder
from hil.app.files import made_whole
from hil.study.arrow import Column
from hil.study.campaign import parquet
from hil.study.campaign.parquet import Row

TABLE = "table.parquet"
DATABASE = "campaign.sqlite"


class Store:
    """Stored rows of one campaign, open in one process at a time.

    Mutable state: the database. It is always in a transaction, which locks out other processes.
    """

    def __init__(
        self, folder: Path, columns: list[Column], identity: dict[str, str], *, fresh: bool = False
    ) -> None:
        """Open or create the results folder; fresh: discard its stored rows, even of another campaign.

        Raises LogError: the folder is not a campaign's, belongs to another campaign, is in use, or cannot be
        written.
        """
        self.folder, self._columns = folder, columns
        with _explained(folder):
            made_folder(folder)
            if any(folder.iterdir()) and not (folder / DATABASE).is_file():
                raise LogError(
                    f"{folder}: is not empty, and has no campaign of this version; give an empty or "
                    "new folder with --out"
                )
            self._db = sqlite3.connect(folder / DATABASE, timeout=0.0, isolation_level=None)
        try:
            with _explained(folder):
                self._db.execute("BEGIN IMMEDIATE")
                self._db.execute("PRAGMA busy_timeout = 10000")  # a commit waits for those who read
                self._take_over(identity, fresh=fresh)
        except BaseException:
            self._db.close()
            raise

    def close(self) -> None:
        """Close the database and release its lock."""
        self._db.close()

    def rows(self) -> dict[int, Row]:
        """Read the stored rows by number. Raises LogError if the database is damaged."""
        with _explained(self.folder):
            return _rows(self._db)

    def add(self, row: Row) -> None:
        """Write a row to the disk before returning. Raises LogError if the row cannot be written."""
        with _explained(self.folder):
            self._write("INSERT OR REPLACE INTO rows VALUES (?, ?)", (row["row"], json.dumps(row)))

    def finish(self, rows: dict[int, Row]) -> Path:
        """Write the table of all rows by number; return its path. Raises LogError if that fails."""
        table = self.folder / TABLE
        with _explained(self.folder), made_whole(table, overwrite=True) as temporary:
            parquet.write(temporary, self._columns, [rows[number] for number in sorted(rows)])
        return table

    def _write(self, statement: str, *rows: tuple[object, object]) -> None:
        self._db.executemany(statement, rows)
        self._db.execute("COMMIT")
        self._db.execute("BEGIN IMMEDIATE")

    def _take_over(self, identity: dict[str, str], *, fresh: bool) -> None:
        """Prepare the database for this campaign. Raises LogError if it has rows of another campaign."""
        self._db.execute("CREATE TABLE IF NOT EXISTS made_of (name TEXT PRIMARY KEY, digest TEXT)")
        self._db.execute("CREATE TABLE IF NOT EXISTS rows (number INTEGER PRIMARY KEY, cells TEXT)")
        if fresh:
            self._db.execute("DELETE FROM made_of")
            self._db.execute("DELETE FROM rows")
            (self.folder / TABLE).unlink(missing_ok=True)
        _refuse_other(self.folder, self._db, identity)
        self._write("INSERT OR REPLACE INTO made_of VALUES (?, ?)", *identity.items())


def stored_rows(folder: Path, identity: dict[str, str]) -> dict[int, Row]:
    """Read the stored rows of a campaign by number, even while another process adds rows.

    Nothing is written: the folder may be read-only. Raises LogError: rows of another campaign, or damaged.
    """
    file = folder / DATABASE
    if not file.is_file():
        return {}
    with (
        _explained(folder),
        closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as db,
    ):
        _refuse_other(folder, db, identity)
        return _rows(db)


def _refuse_other(folder: Path, db: sqlite3.Connection, identity: dict[str, str]) -> None:
    """Raise LogError if the stored rows belong to another campaign."""
    made_of = dict(db.execute("SELECT name, digest FROM made_of").fetchall()) or identity
    changed = [name for name in {**identity, **made_of} if identity.get(name) != made_of.get(name)]
    if changed:
        raise LogError(
            f"{folder}: its rows belong to another campaign; these parts differ: {', '.join(changed)}. "
            "Restore them, give another folder with --out, or discard the rows with `hil campaign --fresh`"
        )


def _rows(db: sqlite3.Connection) -> dict[int, Row]:
    return {number: json.loads(cells) for number, cells in db.execute("SELECT number, cells FROM rows")}


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    """Convert errors of the database or the folder to LogError."""
    try:
        yield
    except OSError as error:
        raise LogError(f"{error.filename or folder}: cannot be used: {error.strerror or error}") from None
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", None) in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            raise LogError(
                f"{folder}: another process runs this campaign; wait for it, or give another folder "
                "with --out"
            ) from None
        damaged = not isinstance(error, sqlite3.OperationalError)
        hint = "; remove it to run its rows again" if damaged else ""
        raise LogError(f"{folder / DATABASE}: cannot be used: {error}{hint}") from None
