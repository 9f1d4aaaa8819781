"""Row of a log, built from its table of columns: NumPy type, wire layout, protobuf schema, description.

Viewers get names: elements become fields of a message, an enumeration becomes an enum, flags become a message
of bools. The number, which may have no name, precedes them in the field `<column>_number`. Of these, only the
number is read back.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum, IntFlag
from functools import lru_cache
from typing import Any, NamedTuple, Self, cast

import numpy as np
from google.protobuf.message import DecodeError

from drivers.arrays import Ints
from drivers.tick_columns import LATER, RECORDED, ROW, Column
from hil.record.layout import Builder
from hil.record.schema import PACKAGE, Schema, Type, add_field, comment, new_file, schema_of

NUMBER = "_number"
UNNAMED = 127
"""Enum value in the log for numbers without a name: from this value on, or below 0."""
WHOLE, NAMED = -1, -2
"""What a field holds: all eight bytes of a number, or the enum value of its name."""
MOST_ROW_BYTES = 1 << 16
"""Largest row that a log may have, bytes; rows of our recorder take a twentieth."""
_LONGEST_TEXT, _MOST_AXES = 500, 4
_MOST_BUSES, _LONGEST_BUS = 16, 4096
"""Most buses in a log, and most characters in a bus name; each name needs its own frame layout."""
_TABLES = 16
"""Number of cached tables: a process may read thousands of logs, most with the same table."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}")
"""Allowed names of enumeration values; Python itself refuses `mro`."""
_MOST_ELEMENTS = 63
"""Largest number of elements with names: the bits of a number; their tags take at most two bytes."""


class Table(NamedTuple):
    """Topic and columns of one kind of log row."""

    topic: str
    columns: tuple[Column, ...]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """NumPy type of a row: one object per table, so that a row enters the ring in one copy."""
        return _dtype(self.columns)

    def check(self) -> None:
        """Check that the table has a constant layout and that protobuf can name its enumerations.

        Raises ValueError: no scalar integer `tick` or `t_ns`; a column that is too large, or whose names do
        not fit.
        """
        for name in ("tick", "t_ns"):
            if not any(c.name == name and c.kind == "<i8" and not c.shape for c in self.columns):
                raise ValueError(f"the row needs a scalar integer column {name}")
        size = 0
        for c in self.columns:
            size += 8 * c.size
            names, count = list(c.names.values()), len(c.elements)
            flags = issubclass(c.type, IntFlag)
            named = not names or flags or (0 in names and max(names) < UNNAMED)
            scalar = not flags or (not c.shape and len(names) <= _MOST_ELEMENTS)
            rules = {
                f"rows of {MOST_ROW_BYTES} bytes": size <= MOST_ROW_BYTES,
                f"{_MOST_AXES} axes, none of length 0": len(c.shape) <= _MOST_AXES and 0 not in c.shape,
                f"{_MOST_ELEMENTS} elements, all or none with a name": count in {0, c.size}
                and count <= _MOST_ELEMENTS,
                f"scalar flags of {_MOST_ELEMENTS} bits": scalar,
                f"an enumeration with a 0, below {UNNAMED}": named,
            }
            broken = [allowed for allowed, kept in rules.items() if not kept]
            if broken:
                raise ValueError(f"column {c.name} of the row: allowed: {broken[0]}")


@lru_cache(_TABLES)
def _dtype(columns: tuple[Column, ...]) -> np.dtype[np.void]:
    return ROW if columns == RECORDED else np.dtype([(c.name, c.kind, c.shape) for c in columns])


TICKS = Table("/tick", RECORDED)
"""Table of the controller's rows."""


def completed(columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """Columns of a log, extended by those of LATER that it lacks if it is a log of ticks."""
    names, missing = [c.name for c in columns], sum(LATER, ())
    older = range(len(RECORDED) - len(missing), len(RECORDED))
    is_older = len(names) in older and names == [c.name for c in RECORDED[: len(names)]]
    return (*columns, *RECORDED[len(names) :]) if is_older else columns


def describe(columns: Sequence[Column]) -> str:
    """Columns as JSON text, which `columns_of` reads."""
    return json.dumps(
        [
            {
                "name": c.name,
                "type": c.type.__name__,
                "flags": issubclass(c.type, IntFlag),
                "names": c.names,
                "unit": c.unit,
                "meaning": c.meaning,
                "elements": c.elements,
                "shape": c.shape,
            }
            for c in columns
        ]
    )


@lru_cache(_TABLES)
def columns_of(description: str) -> tuple[Column, ...]:
    """Table of columns from the JSON of `describe`; all columns have part `output`.

    Raises AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError: the text is not a
    table of columns, or its rows are larger than any recorded row.
    """
    columns = []
    for entry in json.loads(description):
        name, unit, meaning = (_text(entry[key]) for key in ("name", "unit", "meaning"))
        kind = {"int": int, "float": float}.get(entry["type"])
        if kind is None:
            named = cast("Any", IntFlag if entry["flags"] else IntEnum)
            names = {_name(key): _number(value) for key, value in entry["names"].items()}
            kind = named(_text(entry["type"]), names)
        elements, shape = tuple(map(_text, entry["elements"])), tuple(map(_number, entry["shape"]))
        columns.append(Column("output", name, kind, unit, meaning, elements, shape))
    table = Table("", tuple(columns))
    table.check()
    return table.columns


REFUSED = (AttributeError, DecodeError, KeyError, OverflowError, RecursionError, TypeError, ValueError)
"""Exceptions of protobuf, NumPy and Python for tables and messages from untrusted input."""
OLD = "a log of version 0.1.0: read and replay it with that version"


def why(error: Exception) -> str:
    """Text of an exception in REFUSED, for a message about untrusted input."""
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]!r}" if error.args else "something is missing"
    return str(error) or type(error).__name__


class Run(NamedTuple):
    """Columns, buses and clock of a log, from its metadata record `hil`."""

    topic: str
    columns: tuple[Column, ...]
    epoch_ns: int
    """UTC of t_ns = 0, ns."""
    can_channels: tuple[str, ...]
    """Name of each bus."""
    lockstep: bool

    @classmethod
    def of(cls, identity: Mapping[str, str]) -> Self:
        """Parse the metadata record; refuse values that no recorder writes. Raises as `columns_of`."""
        names = json.loads(identity["can_channels"]) if "can_channels" in identity else []
        buses = tuple(map(str, names)) or (identity["can_channel"],)
        epoch_ns = int(identity["epoch_ns"])
        if not 0 <= epoch_ns < 1 << 63:
            raise ValueError(f"epoch_ns {epoch_ns}")
        fit = max(map(len, buses)) <= _LONGEST_BUS and "".join(buses).isprintable()
        if len(buses) > _MOST_BUSES or not fit:
            raise ValueError(
                f"can_channels: allowed: {_MOST_BUSES} printable names of {_LONGEST_BUS} characters"
            )
        lockstep = identity["mode"] == "lockstep"
        return cls(identity["topic"], columns_of(identity["columns"]), epoch_ns, buses, lockstep)


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value.isprintable() or len(value) > _LONGEST_TEXT:
        raise ValueError(f"{value!r:.60}: allowed: a printable text of at most {_LONGEST_TEXT} characters")
    return value


def _number(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 1 << 63:
        raise ValueError(f"{value!r:.60}: allowed: a whole number from 0 on, at most 63 bits")
    return value


def _name(value: Any) -> str:
    if not _NAME.fullmatch(value):
        raise ValueError(f"{value!r:.60}: allowed: a name of letters, digits and _")
    return str(value)


def _fields(columns: Sequence[Column]) -> Iterator[tuple[str, Column, bool]]:
    """Yield the fields of a row's protobuf message: name, column, and True if the field has names."""
    for c in columns:
        named = bool(c.names)
        yield (c.name + NUMBER if named else c.name), c, False
        if named:
            yield c.name, c, True


class RowCodec:
    """Layout of rows as protobuf messages: the byte at which each number of a row is written and read."""

    def __init__(self, columns: Sequence[Column], channel: int = 0) -> None:
        self.dtype = Table("", tuple(columns)).dtype
        builder, places = Builder(channel), []
        for number, (_, c, names) in enumerate(_fields(columns), start=1):
            word = self.dtype.fields[c.name][1] // 8  # type: ignore[index]
            flags = list(c.names.values()) if names and issubclass(c.type, IntFlag) else []
            count, size = len(flags or c.elements), 1 if names else 8
            if count:
                found = builder.message(number, size, count)
            elif c.shape:
                found = builder.packed(number, size, c.size)
            else:
                found = [builder.field(number, size)]
            for k, place in enumerate(found):
                what = flags[k] if flags else NAMED if names else WHOLE
                places.append((word if flags else word + k, place, what))
        self.layout = builder.layout()
        self.places = np.array(places, np.int64)
        """(n, 3) places of the words of a row: word, byte of the record, WHOLE, NAMED or a flag."""

    @property
    def read(self) -> Ints:
        """Offsets (n,), in a row's record, of the 8-byte words of the row, in their order."""
        _, places, what = self.places.T
        found: Ints = places[what == WHOLE]
        return found


def row_schema(table: Table) -> Schema:
    """Protobuf type of a row; the comment of a field has the column's meaning and unit."""
    full_name = f"{PACKAGE}.{table.topic.strip('/').title()}"
    file = new_file(full_name)
    message = file.message_type[0]
    for number, (name, c, names) in enumerate(_fields(table.columns), start=1):
        elements = c.elements
        kind, type_name = (Type.TYPE_DOUBLE if c.type is float else Type.TYPE_SFIXED64), ""
        if elements or names:
            nested = message.nested_type.add(name=f"{name}_type")
            if names and issubclass(c.type, IntFlag):
                elements, kind = tuple(c.names), Type.TYPE_BOOL
            elif names:
                enum = nested.enum_type.add(name="Name")
                for text, value in sorted({**c.names, "UNNAMED": UNNAMED}.items(), key=lambda item: item[1]):
                    enum.value.add(name=text, number=value)
                kind, type_name = Type.TYPE_ENUM, f".{full_name}.{name}_type.Name"
            for k, element in enumerate(elements, start=1):
                add_field(nested, element, k, kind, type_name=type_name)
            if elements:
                kind, type_name = Type.TYPE_MESSAGE, f".{full_name}.{name}_type"
        add_field(message, name, number, kind, type_name=type_name, repeated=bool(c.shape and not elements))
        comment(file, number - 1, f"{c.meaning} [{c.unit}]" if c.unit else c.meaning)
    return schema_of(full_name, [file])
