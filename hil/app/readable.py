"""Reads a log; a truncated log as far as it is readable."""

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from drivers.arrays import Rows
from hil.record.log import Log
from hil.record.schema import CLEAN, SALVAGE, SUMMARY

MOST_RATE_HZ = 1e5
"""Largest rate accepted from a log's metadata: windows of ticks grow with it."""


class Readable(NamedTuple):
    """A log with its readable rows, and a remark on missing parts."""

    log: Log
    rows: Rows
    """In tick order, with the requested columns."""
    remark: str
    """Missing parts, as a sentence; empty for a log that its run has closed."""


def readable(path: Path, columns: Collection[str] = ()) -> Readable:
    """Read a log, as far as it is readable.

    columns: names of the needed columns, as far as the log has them; empty: all. Raises LogError: the file is
    missing, not a log of this product, or damaged.
    """
    log = Log(path)
    rows = log.rows(*(column.name for column in log.columns if column.name in columns))
    return Readable(log, rows, lacking(log))


def lacking(log: Log) -> str:
    """Sentence about the missing parts of a log; empty for a log that its run has closed."""
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
