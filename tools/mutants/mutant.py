"""The mutants of a source: one change of its text each, with its place named by text."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

from tools.mutants.operators import changes

_ATOMS = (ast.Constant, ast.Name, ast.Call, ast.Attribute, ast.Subscript, ast.stmt)


@dataclass(frozen=True)
class Mutant:
    """One change: ``text[start:end]``, which is `before`, becomes `after`.

    `where` is the qualified name of the function or class around it, `statement` the first line of its
    statement. Lines count from 1; `first_line` is that of the function, 0 at a module's level.
    """

    file: str
    where: str
    statement: str
    operator: str
    before: str
    after: str
    line: int
    first_line: int
    start: int
    end: int

    def applied(self, text: str) -> str:
        """Return the source with the change."""
        return text[: self.start] + self.after + text[self.end :]

    @property
    def place(self) -> tuple[str, str, str, str, str]:
        """What names the change where lines move."""
        return self.file, self.where, self.statement, self.before, self.after

    def key(self, text: str) -> str:
        """Return what differs between two changes, or between two versions of the source."""
        content = f"{self.file}\0{self.start}\0{self.end}\0{self.after}\0{text}"
        return hashlib.sha256(content.encode()).hexdigest()[:16]


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """Yield every mutant of a source that parses: not of docstrings, messages, annotations, decorators."""
    return _Walk(file, text).body(ast.parse(text))


class _Walk:
    """A walk through one source that knows function and statement around a node."""

    def __init__(self, file: str, text: str) -> None:
        self.file, self.text = file, text
        self.lines = text.splitlines(keepends=True)
        self.starts = [0]
        for line in self.lines:
            self.starts.append(self.starts[-1] + len(line))
        self.names: list[str] = []
        self.first_line = 0
        self.statement: ast.stmt | None = None

    def body(self, node: ast.AST) -> Iterator[Mutant]:
        """Yield the mutants below a node, whose children are visited in the order of the source."""
        for child in ast.iter_child_nodes(node):
            yield from self.visit(child)

    def visit(self, node: ast.AST) -> Iterator[Mutant]:
        match node:
            case ast.JoinedStr() | ast.Import() | ast.ImportFrom() | ast.arg() | ast.Assert():
                return
            case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.Expr(value=ast.Constant()):
                return
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield from self.scope(node)
                return
            case ast.AnnAssign(value=None):
                return
        outer = self.statement
        if isinstance(node, ast.stmt):
            self.statement = node
        if isinstance(node, ast.expr | ast.stmt) and not _declares(node):
            yield from self.changed(node)
        if isinstance(node, ast.AnnAssign):
            assert node.value is not None
            yield from self.visit(node.value)
        elif not isinstance(node, ast.Raise):  # what it carries is a message
            yield from self.body(node)
        self.statement = outer

    def scope(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> Iterator[Mutant]:
        kept = self.first_line, self.statement
        self.names.append(node.name)
        self.statement = node
        if not isinstance(node, ast.ClassDef):
            self.first_line = node.lineno
            for default in [*node.args.defaults, *node.args.kw_defaults]:
                if default is not None:
                    yield from self.visit(default)
        for child in node.body:
            yield from self.visit(child)
        self.names.pop()
        self.first_line, self.statement = kept

    def changed(self, node: ast.expr | ast.stmt) -> Iterator[Mutant]:
        start, end = self.span(node)
        before = self.text[start:end]
        assert self.statement is not None
        for operator, changed in changes(node):
            after = ast.unparse(ast.fix_missing_locations(changed))
            if isinstance(node, ast.expr) and not isinstance(changed, _ATOMS):
                after = f"({after})"
            yield Mutant(
                file=self.file,
                where=".".join(self.names),
                statement=self.lines[self.statement.lineno - 1].strip(),
                operator=operator,
                before=before,
                after=after,
                line=node.lineno,
                first_line=self.first_line,
                start=start,
                end=end,
            )

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        """Return where a node begins and ends; the tree counts columns in bytes of UTF-8."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.offset(node.lineno, node.col_offset), self.offset(node.end_lineno, node.end_col_offset)

    def offset(self, line: int, column: int) -> int:
        return self.starts[line - 1] + len(self.lines[line - 1].encode()[:column].decode())


def _declares(node: ast.AST) -> bool:
    """Tell whether a statement only makes a name for types."""
    return isinstance(node, ast.Assign) and any(
        isinstance(t, ast.Name) and t.id in {"__all__", "__slots__"} for t in node.targets
    )
