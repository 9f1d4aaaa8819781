"""A log to look at: whole, or of one that is cut or damaged as far as it goes."""

import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from drivers.arrays import Rows
from drivers.errors import LogError
from hil.record.log import Log
from hil.record.salvage import salvage
from hil.record.schema import CLEAN, SALVAGE, SUMMARY

MOST_RATE_HZ = 1e5
"""Of what a log says of its run: windows of ticks grow with it."""


class Readable(NamedTuple):
    """A log that can be read to its end."""

    log: Log
    rows: Rows
    """In tick order, with the columns that were asked for."""
    remark: str
    """What is missing; empty for a log that its run has closed."""


@contextmanager
def readable(path: Path, columns: Collection[str] = ()) -> Iterator[Readable]:
    """Open a log; of one that is damaged, a copy of what is left, removed at the end.

    columns: those that are needed, as far as the log has them; none: all.

    Raises
    ------
    LogError
        No such file, not a log of this product, or nothing left of it.

    """
    with tempfile.TemporaryDirectory(prefix="hil-read-") as folder:
        try:
            log = Log(path)
            rows, remark = _rows(log, columns), lacking(log)
        except LogError as error:
            copy = Path(folder) / "salvaged.mcap"
            try:
                report = salvage(path, copy)
                log = Log.open(copy)
                rows = _rows(log, columns)
            except LogError:
                raise error from None
            remark = f"the log is damaged; {report.bytes_lost} of {report.bytes_read} bytes are lost"
        yield Readable(log, rows, remark)


def _rows(log: Log, columns: Collection[str]) -> Rows:
    return log.rows(*(column.name for column in log.columns if column.name in columns))


def lacking(log: Log) -> str:
    """Return what a log lacks, by its end or by what it says; empty for one that its run has closed."""
    if log.cut:
        return f"the log is {log.cut.partition(' (')[0]}"
    found = []
    salvaged = log.metadata.get(SALVAGE)
    if salvaged is not None:
        found.append(
            f"the log was salvaged, {salvaged.get('bytes_lost', '?')} bytes of the original are lost"
        )
    closed = log.metadata.get(SUMMARY, {}).get("closed", "unknown")
    if closed != CLEAN:
        found.append(f"the log was not closed by its run ({closed}): it may end before the run did")
    return "; ".join(found)
