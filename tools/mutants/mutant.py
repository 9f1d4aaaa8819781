"""Mutants of a source file: each is one change of its text, a plausible programming mistake."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from dataclasses import dataclass
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
    return _Walk(file, text).body(ast.parse(text))


class _Walk:
    """A walk through one source that tracks the function and the statement around a node."""

    def __init__(self, file: str, text: str) -> None:
        self.file, self.text = file, text
        self.lines = text.splitlines(keepends=True)
        self.names: list[str] = []
        self.statement = ""

    def body(self, node: ast.AST) -> Iterator[Mutant]:
        """Yield the mutants of all syntax nodes below a node, in the order of the source."""
        for child in ast.iter_child_nodes(node):
            yield from self.visit(child)

    def visit(self, node: ast.AST) -> Iterator[Mutant]:
        match node:
            case ast.JoinedStr() | ast.Import() | ast.ImportFrom() | ast.arg() | ast.Assert():
                return
            case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.Expr(value=ast.Constant()):
                return
            case ast.AnnAssign(value=None) | ast.Assign(targets=[ast.Name(id="__all__" | "__slots__")]):
                return
        outer = self.statement
        if isinstance(node, ast.stmt):
            self.statement = self.lines[node.lineno - 1].strip()
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                self.names.append(node.name)
                defaults = (
                    [] if isinstance(node, ast.ClassDef) else [*node.args.defaults, *node.args.kw_defaults]
                )
                for child in filter(None, [*defaults, *node.body]):
                    yield from self.visit(child)
                self.names.pop()
            case ast.expr() | ast.stmt():
                yield from self.changed(node)
                if isinstance(node, ast.AnnAssign):
                    assert node.value is not None
                    yield from self.visit(node.value)
                elif not isinstance(node, ast.Raise):  # what it carries is a message
                    yield from self.body(node)
            case _:
                yield from self.body(node)
        self.statement = outer

    def changed(self, node: ast.expr | ast.stmt) -> Iterator[Mutant]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        start = self.offset(node.lineno, node.col_offset)
        end = self.offset(node.end_lineno, node.end_col_offset)
        for operator, changed in changes(node):
            after = ast.unparse(ast.fix_missing_locations(changed))
            if isinstance(node, ast.expr) and not isinstance(changed, _ATOMS):
                after = f"({after})"
            yield Mutant(
                self.file,
                ".".join(self.names),
                self.statement,
                operator,
                self.text[start:end],
                after,
                node.lineno,
                start,
                end,
            )

    def offset(self, line: int, column: int) -> int:
        """Character index of a place in the text; `ast` counts columns in bytes of UTF-8."""
        before = sum(map(len, self.lines[: line - 1]))
        return before + len(self.lines[line - 1].encode()[:column].decode())
