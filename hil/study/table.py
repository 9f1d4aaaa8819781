"""Prints tables of results on the terminal."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hil.app.output import number
from hil.app.terminal import visible

TABLE_WIDTH = 180
"""Largest width, in characters, of a table in a file or a pipe."""


class Terminal(Console):
    """A console that prints all text literally, without markup."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)


class Column(NamedTuple):
    """One column of a table on the terminal: title, text of its cells, alignment and width."""

    title: str
    cell: Callable[[Any], object]
    """Text of a row's cell; a `Text` keeps its own style."""
    left: bool = False
    """True aligns left, for words; False right, for figures."""
    width: int | None = None
    """Largest width in characters."""


def figure_column(title: str, key: str, form: str = "") -> Column:
    """Column with one figure of rows (name, figures by key); the default format is that of summaries."""
    return Column(title, lambda row: figure(row[1].get(key), form))


def print_rows(
    columns: Sequence[Column],
    rows: Iterable[Any],
    style: Callable[[Any], str] = lambda _: "",
) -> None:
    """Print a table with titles; nothing if there are no rows. style : rich style of a row."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(column.title, justify="left" if column.left else "right", max_width=column.width)
    for row in rows:
        cells = (column.cell(row) for column in columns)
        table.add_row(
            *(cell if isinstance(cell, Text) else Text(visible(str(cell)), style(row)) for cell in cells)
        )
    if table.row_count:
        _print(table)


def _print(table: Table) -> None:
    """Print a table at its own width, or folded to the terminal's width; no word is cut off."""
    out = Terminal()
    for column in table.columns:
        column.overflow = "fold"
    needed = out.measure(table, options=out.options.update(width=10_000))
    most = out.width if out.is_terminal else TABLE_WIDTH
    wide = max(needed.minimum, min(needed.maximum, most))
    Terminal(width=wide).print(table, crop=False)


def figure(value: Any, form: str = "") -> str:
    """Number as text, by default formatted as in summaries; `-` for None and NaN."""
    if value is None or value != value:  # noqa: PLR0124 - nan
        return "-"
    return format(value, form) if form else number(value)
