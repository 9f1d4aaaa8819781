"""Reading of a log: the whole, or a cut one as far as it goes."""

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from drivers.arrays import Rows
from hil.record.log import Log
from hil.record.schema import CLEAN, SALVAGE, SUMMARY

MOST_RATE_HZ = 1e5
"""Largest rate accepted from a log's metadata: windows of ticks grow with it."""


class Readable(NamedTuple):
    """Log that can be read to its end."""

    log: Log
    rows: Rows
    """In tick order, with the requested columns."""
    remark: str
    """Missing parts, as a sentence; empty for a log that its run has closed."""


def readable(path: Path, columns: Collection[str] = ()) -> Readable:
    """Read a log.

    columns: the needed ones, as far as the log has them; empty: all.

    Raises LogError: the file is missing, not a log of this product, or damaged.
    """
    log = Log(path)
    rows = log.rows(*(column.name for column in log.columns if column.name in columns))
    return Readable(log, rows, lacking(log))


def lacking(log: Log) -> str:
    """Missing parts of a log, as a sentence; empty for a log that its run has closed."""
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
