"""The table of a campaign as Parquet: one row a run, the same bytes whenever the rows are the same.

Nothing of when, where or by how many processes is in it; the writer's settings are fixed.
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
    """Return the columns of a campaign's table: the row's number and values, its outcome, its metrics."""
    return [
        Column("row", "int64", "", "number of the row, from 0"),
        Column("seed", "int64", "", "of all chance of the plant's end"),
        *(
            Column(
                name,
                kind(axis),
                "",
                ", ".join(axis.targets) or ("faults, by name" if axis.faults else "set of changes, by name"),
            )
            for name, axis in plan.settings.axes.items()
        ),
        Column("passed", "bool", "", "whether the run ended well and kept every limit of the campaign"),
        Column("ended", "text", "", "complete, fault, limit, stopped, plant, refused, error or died"),
        Column("ended_s", "float64", "s", "simulated time of the run"),
        Column("faults", "text", "", "names of the latched faults"),
        Column("trouble", "text", "", "what went wrong"),
        *(
            Column(name, "int64" if name in COUNTS else "float64", metric.unit, metric.meaning)
            for name, metric in METRICS.items()
        ),
    ]


def kind(axis: ListedAxis) -> str:
    """Return the type of an axis' column: numbers where all its values are, of 64 bits, else text."""
    if not all(type(x) is float or (type(x) is int and abs(x) < 2**63) for x in axis.ends):
        return "text"
    return "int64" if all(type(x) is int for x in axis.ends) else "float64"


def cell(kind: str, value: Any) -> Any:
    """Return a value as its column has it; lists, sections and true or false of an axis as JSON."""
    if value is None:
        return None
    if kind == "text":
        return value if isinstance(value, str) else json.dumps(value)
    return float(value) if kind == "float64" else value


def require() -> None:
    """Refuse an installation without pyarrow. Raises LogError."""
    arrow("a campaign")


def write(path: Path, columns: Sequence[Column], rows: Sequence[Row]) -> None:
    """Write rows into a file. Raises OSError."""
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
