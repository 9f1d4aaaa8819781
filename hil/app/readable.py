"""A log to look at: whole, or of one that is cut or damaged as far as it goes."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from drivers.arrays import Rows
from drivers.errors import LogError
from hil.record.log import Log
from hil.record.salvage import salvage
from hil.record.schema import SALVAGE, SUMMARY


class Readable(NamedTuple):
    """A log that can be read to its end."""

    log: Log
    rows: Rows
    """All of it, in tick order."""
    remark: str
    """What is missing; empty for a log that its run has closed."""


@contextmanager
def readable(path: Path) -> Iterator[Readable]:
    """Open a log; of one that is cut or damaged, a copy of what is left, removed at the end.

    Raises
    ------
    LogError
        No such file, not a log of this product, or nothing left of it.

    """
    with tempfile.TemporaryDirectory(prefix="hil-read-") as folder:
        remark = ""
        try:
            log = Log.open(path)
            rows = log.rows()
        except LogError as error:
            copy = Path(folder) / "salvaged.mcap"
            try:
                report = salvage(path, copy)
                log = Log.open(copy)
                rows = log.rows()
            except LogError:
                raise error from None
            remark = f"the log is cut or damaged; {report.bytes_lost} of {report.bytes_read} bytes are lost"
        yield Readable(log, rows, remark or _remark(log))


def _remark(log: Log) -> str:
    """Return what a log says itself of what it lacks."""
    salvaged = log.metadata.get(SALVAGE)
    if salvaged is not None:
        return f"the log was salvaged, {salvaged.get('bytes_lost', '?')} bytes of the original are lost"
    closed = log.metadata.get(SUMMARY, {}).get("closed", "unknown")
    return "" if closed == "clean" else f"the log was not closed by its run ({closed})"
