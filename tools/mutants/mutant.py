"""Mutants of a source file: each is one change of its text, a plausible programming mistake."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

from tools.mutants.operators import changes

PLACE = ("file", "where", "statement", "before", "after")
"""Fields that identify a change even after lines have moved."""
_ATOMS = (ast.Constant, ast.Name, ast.Call, ast.Attribute, ast.Subscript, ast.stmt)


@dataclass(frozen=True)
class Mutant:
    """One change: ``text[start:end]``, which is `before`, becomes `after`.

    `where` is the qualified name of the function or class around it, `statement` the first line of its
    statement. Lines count from 1.
    """

    file: str
    where: str
    statement: str
    operator: str
    before: str
    after: str
    line: int
    start: int
    end: int

    def __str__(self) -> str:
        change = f"{self.before[:70]!r} -> {self.after[:70]!r} ({self.operator})"
        return f"{self.file}:{self.line} {self.where}: {change}"

    def applied(self, text: str) -> str:
        """Source text with this change."""
        return text[: self.start] + self.after + text[self.end :]

    @property
    def place(self) -> tuple[str, ...]:
        """Values of the fields in PLACE, which identify this change in other versions of the source."""
        return tuple(vars(self)[name] for name in PLACE)


def equivalents() -> set[tuple[str, ...]]:
    """Places of changes that no test can detect; equivalent.json gives the reason for each."""
    listed = json.loads(Path(__file__).with_name("equivalent.json").read_text(encoding="utf-8"))
    return {tuple(each[name] for name in PLACE) for each in listed}


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """Yield every mutant of a source text; docstrings, messages, annotations and decorators stay."""
    lines = text.splitlines(keepends=True)
    starts = [0, *accumulate(map(len, lines))]

    def offset(line: int, column: int) -> int:
        """Character index of a place in the text; `ast` counts columns in bytes of UTF-8."""
        return starts[line - 1] + len(lines[line - 1].encode()[:column].decode())

    def visit(node: ast.AST, names: tuple[str, ...], statement: str) -> Iterator[Mutant]:
        if _stays(node):
            return
        if isinstance(node, ast.stmt):
            statement = lines[node.lineno - 1].strip()
        children: Iterable[ast.AST | None] = ast.iter_child_nodes(node)
        match node:
            case ast.FunctionDef(args=given):
                names, children = (*names, node.name), (*given.defaults, *given.kw_defaults, *node.body)
            case ast.ClassDef():
                names, children = (*names, node.name), node.body
            case ast.expr() | ast.stmt():
                start = offset(node.lineno, node.col_offset)
                end = offset(node.end_lineno or 0, node.end_col_offset or 0)
                for operator, changed in changes(node):
                    after = ast.unparse(ast.fix_missing_locations(changed))
                    if isinstance(node, ast.expr) and not isinstance(changed, _ATOMS):
                        after = f"({after})"
                    place = file, ".".join(names), statement
                    yield Mutant(*place, operator, text[start:end], after, node.lineno, start, end)
                if isinstance(node, ast.AnnAssign):
                    children = (node.value,)
                elif isinstance(node, ast.Raise):  # what it carries is a message
                    children = ()
        for child in filter(None, children):
            yield from visit(child, names, statement)

    for node in ast.parse(text).body:
        yield from visit(node, (), "")


def _stays(node: ast.AST) -> bool:
    match node:
        case ast.JoinedStr() | ast.Import() | ast.ImportFrom() | ast.arg() | ast.Assert():
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.Expr(value=ast.Constant()):
            return True
        case ast.AnnAssign(value=None) | ast.Assign(targets=[ast.Name(id="__all__" | "__slots__")]):
            return True
    return False
