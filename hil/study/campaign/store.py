"""The folder of a campaign's results: rows as they come, whole after a crash at any instant; then one table.

campaign.sqlite      what the campaign is made of, and each row as JSON, on the disk once it is added
table.parquet        all rows by number, once all are there
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
    """Rows of one campaign on the disk, one process at a time.

    Mutable state: the database, in a transaction from its opening to its end: the lock that keeps others out.
    """

    def __init__(
        self, folder: Path, columns: list[Column], identity: dict[str, str], *, fresh: bool = False
    ) -> None:
        """Open or make the folder; `fresh` discards the rows that are there, whatever campaign's they are.

        Raises LogError: not the folder of a campaign, of another one, or in use; or it cannot be written.
        """
        self.folder, self._columns = folder, columns
        with _explained(folder):
            made_folder(folder)
            if any(folder.iterdir()) and not (folder / DATABASE).is_file():
                raise LogError(
                    f"{folder}: holds no results of a campaign of this version; name an empty or new folder "
                    "with --out"
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
        """Let others in."""
        self._db.close()

    def rows(self) -> dict[int, Row]:
        """Rows on the disk by number. Raises LogError: the file is damaged."""
        with _explained(self.folder):
            return _rows(self._db)

    def add(self, row: Row) -> None:
        """Write a row: it is whole and on the disk when this returns. Raises LogError: it is not."""
        with _explained(self.folder):
            self._write("INSERT OR REPLACE INTO rows VALUES (?, ?)", (row["row"], json.dumps(row)))

    def finish(self, rows: dict[int, Row]) -> Path:
        """Write the table of all rows by number. Raises LogError: it cannot be written."""
        table = self.folder / TABLE
        with _explained(self.folder), made_whole(table, overwrite=True) as temporary:
            parquet.write(temporary, self._columns, [rows[number] for number in sorted(rows)])
        return table

    def _write(self, statement: str, *rows: tuple[object, object]) -> None:
        self._db.executemany(statement, rows)
        self._db.execute("COMMIT")
        self._db.execute("BEGIN IMMEDIATE")

    def _take_over(self, identity: dict[str, str], *, fresh: bool) -> None:
        """Refuse to mix the rows of two campaigns; a new database is this one's."""
        self._db.execute("CREATE TABLE IF NOT EXISTS made_of (name TEXT PRIMARY KEY, digest TEXT)")
        self._db.execute("CREATE TABLE IF NOT EXISTS rows (number INTEGER PRIMARY KEY, cells TEXT)")
        if fresh:
            self._db.execute("DELETE FROM made_of")
            self._db.execute("DELETE FROM rows")
            (self.folder / TABLE).unlink(missing_ok=True)
        _refuse_other(self.folder, self._db, identity)
        self._write("INSERT OR REPLACE INTO made_of VALUES (?, ?)", *identity.items())


def stored_rows(folder: Path, identity: dict[str, str]) -> dict[int, Row]:
    """Rows of a campaign that are on the disk, by number, while another process adds to them, too.

    Nothing is written: the folder may be read-only. Raises LogError: another campaign's, or damaged.
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
    """Refuse to take the rows of another campaign for those of this one."""
    made_of = dict(db.execute("SELECT name, digest FROM made_of").fetchall()) or identity
    changed = [name for name in {**identity, **made_of} if identity.get(name) != made_of.get(name)]
    if changed:
        raise LogError(
            f"{folder}: its rows are of another campaign, changed since: {', '.join(changed)}; "
            "allowed: to go on with the same ones. Restore them, name another folder with --out, or "
            "discard these rows with `hil campaign --fresh`"
        )


def _rows(db: sqlite3.Connection) -> dict[int, Row]:
    return {number: json.loads(cells) for number, cells in db.execute("SELECT number, cells FROM rows")}


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    """Raise LogError for what the database or the folder cannot do."""
    try:
        yield
    except OSError as error:
        raise LogError(f"{error.filename or folder}: cannot be used: {error.strerror or error}") from None
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", None) in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            raise LogError(
                f"{folder}: another process works on this campaign; wait for it, or name another folder "
                "with --out"
            ) from None
        damaged = not isinstance(error, sqlite3.OperationalError)
        hint = "; remove it to run its rows again" if damaged else ""
        raise LogError(f"{folder / DATABASE}: cannot be used: {error}{hint}") from None
