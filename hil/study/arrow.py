"""Arrow schemas whose columns carry units and meanings; needs the optional package pyarrow."""

import json
from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

from drivers.errors import LogError


class Column(NamedTuple):
    """A column of a table: its name, type, unit and meaning."""

    name: str
    kind: str
    """int64, float64, bool, text, or name (text with few distinct values)."""
    unit: str
    meaning: str


def arrow(what: str) -> tuple[Any, ModuleType]:
    """Import pyarrow and pyarrow.parquet. Raises LogError if not installed; `what` names the feature."""
    try:
        import pyarrow as pa  # noqa: PLC0415
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError as error:
        raise LogError(
            f'{what} needs pyarrow, which is not installed ({error}): pip install "hexapod-hil[analysis]"'
        ) from error
    return pa, parquet


def schema(pa: Any, columns: Sequence[Column], **attributes: Any) -> Any:
    """Arrow schema of columns; a pandas DataFrame read from such a file has units and meanings in `attrs`."""
    kinds = {"int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_(), "text": pa.string()}
    kinds["name"] = pa.dictionary(pa.int32(), pa.string())
    fields = [
        pa.field(each.name, kinds[each.kind], metadata={"unit": each.unit, "meaning": each.meaning})
        for each in columns
    ]
    attributes = {
        "units": {each.name: each.unit for each in columns},
        "meanings": {each.name: each.meaning for each in columns},
    } | attributes
    return pa.schema(fields, metadata={"PANDAS_ATTRS": json.dumps(attributes)})
