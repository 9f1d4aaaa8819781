"""A log to look at: whole, or of one that is cut as far as it goes."""

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from drivers.arrays import Rows
from hil.record.log import Log
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


def readable(path: Path, columns: Collection[str] = ()) -> Readable:
    """Read a log.

    columns: those that are needed, as far as the log has them; none: all.

    Raises LogError: no such file, not a log of this product, or damaged.
    """
    log = Log(path)
    rows = log.rows(*(column.name for column in log.columns if column.name in columns))
    return Readable(log, rows, lacking(log))


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
