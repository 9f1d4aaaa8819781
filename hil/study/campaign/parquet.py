"""Writes the table of a campaign as a Parquet file, one row per run.

The same rows give the same bytes: no dates, machines or numbers of processes, and fixed settings.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.study.arrow import Column, arrow, schema
from hil.study.campaign.figures import COUNTS, METRICS
from hil.study.campaign.plan import Plan
from hil.study.campaign.settings import ListedAxis

Row = dict[str, Any]


def columns(plan: Plan) -> list[Column]:
    """Columns of a campaign's table: row number, seed, axis values, outcome, metrics."""
    return [
        Column("row", "int64", "", "number of the row, from 0"),
        Column("seed", "int64", "", "seed of all randomness at the plant's end"),
        *(
            Column(
                name,
                kind(axis),
                "",
                ", ".join(axis.targets) or ("faults, by name" if axis.faults else "set of changes, by name"),
            )
            for name, axis in plan.settings.axes.items()
        ),
        Column("passed", "bool", "", "true if the run ended as planned and kept every limit of the campaign"),
        Column("ended", "text", "", "complete, fault, limit, stopped, plant, refused, error or died"),
        Column("ended_s", "float64", "s", "simulated time of the run"),
        Column("faults", "text", "", "names of the latched faults"),
        Column("trouble", "text", "", "cause of the failure"),
        *(
            Column(name, "int64" if name in COUNTS else "float64", metric.unit, metric.meaning)
            for name, metric in METRICS.items()
        ),
    ]


def kind(axis: ListedAxis) -> str:
    """Column type of an axis: int64 or float64 if all its values are 64-bit numbers, else text."""
    if not all(type(x) is float or (type(x) is int and abs(x) < 2**63) for x in axis.ends):
        return "text"
    return "int64" if all(type(x) is int for x in axis.ends) else "float64"


def cell(kind: str, value: Any) -> Any:
    """Axis value or outcome converted to its column's type; lists, sections and booleans become JSON."""
    if value is None:
        return None
    if kind == "text":
        return value if isinstance(value, str) else json.dumps(value)
    return float(value) if kind == "float64" else value


def require() -> None:
    """Raise LogError if pyarrow is not installed."""
    arrow("a campaign")


def write(path: Path, columns: Sequence[Column], rows: Sequence[Row]) -> None:
    """Write campaign rows to a Parquet file. Raises OSError."""
    pa, parquet = arrow("a campaign")
    parquet.write_table(
        pa.Table.from_pylist(rows, schema(pa, columns)),
        path,
        compression="zstd",
        compression_level=3,
        version="2.6",
        data_page_version="1.0",
        row_group_size=65_536,
    )
