"""`hil export`: writes frames and columns of a log to files; the file ending selects the format.

An existing file is overwritten only on request, and no file is left half written.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from drivers.can.frame_files import WRITERS
from drivers.errors import LogError
from drivers.files import real_path
from drivers.protocol import BUS, Frame
from hil.app.files import made_whole, new_file
from hil.record.log import Log
from hil.record.selection import Component, components, name_of
from hil.study.arrow import Column, arrow, schema
from hil.study.log_columns import row_groups, titled
from hil.study.view.recording import write_rrd

TIME = Column("t_s", "float64", "s", "time from the first row")
LINES, GROUP = 1024, 16_384
"""Rows written at a time: to a CSV file, to a Parquet file."""


def write_csv(log: Log, path: Path, names: Sequence[str]) -> int:
    """Write columns or components of a log (no names: all) to a CSV file; return the number of rows.

    The header has each name with its unit, `tau.leg_3 [N]`; enumerations and flags are written by name.

    Raises LogError: unknown column, or damaged log.
    """
    parts = components(log.columns, names, str(log.path))
    count = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([titled(TIME.name, TIME.unit), *(titled(part.label, part.unit) for part in parts)])
        for columns in _columns(log, parts, LINES):
            writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
            count += len(columns[0])
    return count


def write_parquet(log: Log, path: Path, names: Sequence[str]) -> int:
    """Write columns or components of a log (no names: all) to a Parquet file; return the number of rows.

    Each field carries `unit` and `meaning`; a DataFrame read from the file has them in `attrs`, like
    `Log.frame`. Enumerations and flags are written by name.

    Raises LogError: pyarrow is not installed, unknown column, or damaged log.
    """
    pa, parquet = arrow("Parquet")
    parts = components(log.columns, names, str(log.path))
    described = [TIME]
    for part in parts:
        kind = "name" if part.column.names else "float64" if part.column.type is float else "int64"
        described.append(Column(part.label, kind, part.unit, part.column.meaning))
    own = schema(pa, described, epoch_ns=log.epoch_ns, log=str(log.path))
    count = 0
    with parquet.ParquetWriter(path, own, compression="zstd") as writer:
        for columns in _columns(log, parts, GROUP):
            arrays = [pa.array(column).cast(field.type) for field, column in zip(own, columns, strict=True)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=own))
            count += len(columns[0])
    return count


def _columns(log: Log, parts: Sequence[Component], size: int) -> Iterator[list[np.ndarray[Any, Any]]]:
    """Yield times, s, and components as arrays (n,), n about `size`; enumerations and flags by name."""
    for rows in row_groups(log, parts, size):
        columns: list[np.ndarray[Any, Any]] = [(rows["t_ns"] - log.origin_ns) * 1e-9]
        for part in parts:
            values: np.ndarray[Any, Any] = part.of(rows)
            if part.column.names:
                found, places = np.unique(values, return_inverse=True)
                names = [name_of(part.column, number) for number in found.tolist()]
                values = np.array(names, object)[places]
            columns.append(values)
        yield columns


FRAMES = {".log": "candump", ".candump": "candump", ".asc": "asc", ".blf": "blf"}
SIGNALS: dict[str, Callable[[Log, Path, Sequence[str]], int]] = {
    ".csv": write_csv,
    ".parquet": write_parquet,
    ".rrd": write_rrd,
}
"""File ending -> function that writes columns in that format."""


def utc_ns(text: str) -> int:
    """UTC, ns since 1970, of an ISO 8601 instant, UTC without offset. Raises LogError: not an instant."""
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise LogError(
            f"--start {text}: not an instant; allowed: ISO 8601, 2026-01-31T12:00:00 (UTC) or with offset, "
            "2026-01-31T13:00:00+01:00"
        ) from None
    span = (instant if instant.tzinfo else instant.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    return span // timedelta(microseconds=1) * 1000


def export_log(
    path: Path,
    outs: Sequence[Path],
    *,
    start: str | None = None,
    columns: Sequence[str] = (),
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write frames or columns of a log into files; return the summary. Each file ending selects the format.

    `start` is the UTC instant of the first tick, for frames; default: from the log. `columns` are columns or
    components for CSV, Parquet and Rerun; default: all. A truncated log is written up to its last readable
    message, and `success` is False.

    Raises LogError: not a log; an unknown ending, an existing file without `overwrite` or an option that fits
    none of the files (before anything is written); an unknown column. OSError: a file cannot be
    written.
    """
    log = Log(path)
    _check(outs, start=start, columns=columns, overwrite=overwrite)
    own_ns = log.epoch_ns + log.origin_ns
    start_ns = own_ns if start is None else utc_ns(start)
    written: dict[str, Any] = {}
    for out in outs:
        ending = out.suffix.lower()
        with made_whole(out, overwrite=overwrite) as temporary:
            if ending in SIGNALS:
                written[str(out)] = {"rows": SIGNALS[ending](log, temporary, columns)}
            else:
                frames = _write_frames(log, temporary, FRAMES[ending], start_ns - own_ns)
                written[str(out)] = {"format": FRAMES[ending], "frames": frames}
    result: dict[str, Any] = {
        "success": not log.cut,
        "kind": "export",
        "trouble": f"{path}: {log.cut}; exported up to there" if log.cut else None,
        "log": str(path),
        "written": written,
    }
    if any(out.suffix.lower() in FRAMES for out in outs):
        instant = datetime.fromtimestamp(start_ns // 1_000_000_000, UTC)
        result["first_tick_utc"] = f"{instant:%Y-%m-%dT%H:%M:%S}.{start_ns % 1_000_000_000 // 1000:06d}Z"
        if log.lockstep and start is None:
            result["remark"] = (
                "simulated time, which begins in 2000; --start sets the instant of the first tick"
            )
    return result


def _check(outs: Sequence[Path], *, start: str | None, columns: Sequence[str], overwrite: bool) -> None:
    """Check endings, paths and options before anything is written. Raises LogError."""
    endings = {out.suffix.lower() for out in outs}
    for out in outs:
        if out.suffix.lower() not in FRAMES | SIGNALS:
            allowed = ", ".join([*FRAMES, *SIGNALS])
            raise LogError(f"{out}: the file ending selects the format; allowed: {allowed}")
        new_file(out, force=overwrite, option="")
    if len({real_path(out) for out in outs}) < len(outs):
        raise LogError("two output files are the same; give each file once")
    if start is not None and endings.isdisjoint(FRAMES):
        raise LogError("--start: sets the time of frames, but no output file contains frames; leave it out")
    if columns and endings.isdisjoint(SIGNALS):
        raise LogError(f"--column: selects columns for {', '.join(SIGNALS)}, but no output is such a file")


def _write_frames(log: Log, path: Path, form: str, shift_ns: int) -> int:
    """Write all CAN frames of a log; return their number. Raises LogError if the log is damaged.

    shift_ns: added to UTC. A frame logged more than a second late comes later, with its own time.
    """
    writer = WRITERS[form](path, log.can_channels)
    offset, count = log.epoch_ns + shift_ns, 0
    try:
        for t_ns, _, sent, bus, can_id, data, flags in log.can_frames():
            writer.write(t_ns + offset, Frame(can_id, data, flags + bus * BUS), sent=sent)
            count += 1
    finally:
        writer.close()
    return count
