"""The form of the tables of results on the terminal."""

from collections.abc import Collection

from rich.table import Table


def results(*titles: str, left: Collection[str] = ()) -> Table:
    """Table without lines; the columns of `left` stand at the left, figures at the right."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in titles:
        table.add_column(title, justify="left" if title in left else "right")
    return table
