"""The directive `columns`: a table of the columns of a log, from the table that defines the log."""

from __future__ import annotations

from pkgutil import resolve_name

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class Columns(SphinxDirective):
    """Directive whose argument is the name of a tuple of `drivers.tick_columns.Column`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Create the table, and the lists of named values."""
        columns = resolve_name(self.arguments[0])
        lines = ["| column | type | unit | elements | meaning |", "|---|---|---|---|---|"]
        lines += [
            f"| `{c.name}` | {c.type.__name__} | {c.unit} | {', '.join(c.elements)} | {c.meaning} |"
            for c in columns
        ]
        named = {c.type.__name__: c.names for c in columns if c.names}
        for name, values in named.items():
            lines += ["", f"{name}: " + ", ".join(f"{value} {text}" for text, value in values.items())]
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("columns", Columns)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
