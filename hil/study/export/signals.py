"""The columns of a log as CSV and Parquet, a column for each component, block by block."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import LogError
from hil.record.log import Log
from hil.record.selection import Component, components, name_of
from hil.study.log_columns import row_groups, titled

TIME = ("t_s", "s", "time from the first row")
"""Label, unit and meaning of the first column."""
LINES, GROUP = 1024, 16_384
"""Rows that are written together: of a CSV file, of a Parquet file."""


def write_csv(log: Log, path: Path, names: Sequence[str]) -> int:
    """Write columns or components by name (none: all); return the number of rows.

    The header names each with its unit, `tau.leg_3 [N]`; enumerations and flags stand by name.

    Raises LogError: no such column, or the log is damaged.
    """
    parts = components(log.columns, names, str(log.path))
    count = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([titled(TIME[0], TIME[1]), *(titled(part.label, part.unit) for part in parts)])
        for columns in _columns(log, parts, LINES):
            writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
            count += len(columns[0])
    return count


def write_parquet(log: Log, path: Path, names: Sequence[str]) -> int:
    """Write columns or components by name (none: all); return the number of rows.

    Each field carries `unit` and `meaning`; a DataFrame read from the file has them in `attrs`, as that of
    `Log.frame` has. Enumerations and flags stand by name.

    Raises LogError: pyarrow is not installed, no such column, or the log is damaged.
    """
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError as error:
        raise LogError(
            f"Parquet needs pyarrow, which is not installed ({error}): "
            'pip install "hexapod-hil[analysis]"; a CSV file needs nothing'
        ) from error
    parts = components(log.columns, names, str(log.path))
    schema = _schema(pa, log, parts)
    count = 0
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for columns in _columns(log, parts, GROUP):
            pairs = zip(schema, columns, strict=True)
            arrays = [pa.array(column).cast(field.type) for field, column in pairs]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            count += len(columns[0])
    return count


def _schema(pa: Any, log: Log, parts: Sequence[Component]) -> Any:
    """Return the Arrow schema with units and meanings."""
    text = pa.dictionary(pa.int32(), pa.string())
    fields = [pa.field(TIME[0], pa.float64(), metadata={"unit": TIME[1], "meaning": TIME[2]})]
    for part in parts:
        kind = text if part.column.names else pa.float64() if part.column.type is float else pa.int64()
        metadata = {"unit": part.unit, "meaning": part.column.meaning}
        fields.append(pa.field(part.label, kind, metadata=metadata))
    attributes = {
        "units": {TIME[0]: TIME[1]} | {part.label: part.unit for part in parts},
        "meanings": {TIME[0]: TIME[2]} | {part.label: part.column.meaning for part in parts},
        "epoch_ns": log.epoch_ns,
        "log": str(log.path),
    }
    return pa.schema(fields, metadata={"PANDAS_ATTRS": json.dumps(attributes)})


def _columns(log: Log, parts: Sequence[Component], size: int) -> Iterator[list[np.ndarray[Any, Any]]]:
    """Yield time and components (n,), n about `size`; what has names by name."""
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
