"""Shows differences between two recordings by column: as plain values, a sentence or a table."""

from collections.abc import Callable, Sequence
from typing import Any

from hil.record.divergence import ColumnDivergence, Place
from hil.study.table import Column, figure, print_rows

Sides = tuple[str, str]
"""Names of the two sides, which are also the keys of their values."""


def fields(found: ColumnDivergence, sides: Sides) -> dict[str, Any]:
    """Difference in one column as plain values for a JSON summary; sides: names of the two recordings."""
    column = found.column
    return {
        "column": column.name,
        "unit": column.unit,
        "ticks": found.ticks,
        "largest": None if column.names else found.largest,
        "first": place(found, found.first, sides),
        "at": place(found, found.at, sides),
    }


def place(found: ColumnDivergence, at: Place | None, sides: Sides) -> dict[str, Any] | None:
    """First or largest difference as plain values: tick, time, s, element, and both values; None: none."""
    if at is None:
        return None
    where = {"tick": at.tick, "time_s": at.time_s, "element": at.label, "unit": at.unit}
    return where | dict(zip(sides, at.values(found.column), strict=True))


def sentence(at: dict[str, Any], sides: Sides) -> str:
    """First or largest difference as a sentence with tick, time and both values."""
    values = ", ".join(f"{side.replace('_', '-')} {at[side]}" for side in sides)
    return f"tick {at['tick']} ({at['time_s']:.3f} s): {at['element']}: {values} {at['unit']}".rstrip()


def show(
    columns: Sequence[dict[str, Any]],
    sides: Sides,
    more: Sequence[Column] = (),
    style: Callable[[dict[str, Any]], str] = lambda _: "",
) -> None:
    """Print a table of differing columns; the table columns `more` come before the unit."""

    def first(key: str) -> Callable[[dict[str, Any]], str]:
        return lambda each: "-" if each["first"] is None else _short(str(each["first"][key]))

    shown = (
        Column("column", lambda each: (each["first"] or each["at"])["element"], left=True),
        Column("first tick", first("tick")),
        Column("s", first("time_s")),
        *(Column(side.replace("_", "-"), first(side)) for side in sides),
        Column("in ticks", lambda each: each["ticks"]),
        Column("largest", lambda each: figure(each["largest"], ".4g")),
        Column("at tick", lambda each: each["at"]["tick"]),
        *more,
        Column("unit", lambda each: each["unit"], left=True),
    )
    print_rows(shown, columns, style)


def _short(value: str) -> str:
    try:
        return f"{float(value):.6g}" if "." in value or "e" in value else value
    except ValueError:
        return value
