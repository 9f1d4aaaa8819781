"""Mutants of a source file: each is one change of its text, a plausible programming mistake."""

from __future__ import annotations

import ast
import copy
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

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


# changes to one node of a syntax tree, each one plausible mistake

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
"""Comparison -> the one with moved boundary, and the one with reversed direction."""
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
CALLS = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}
_SYMMETRIC = {"isinstance", "issubclass", "hypot", "dot", "array_equal", "isclose", *CALLS}
"""Functions whose first two arguments commute, or cannot be exchanged without a type error."""
_DELETED = (ast.AugAssign, ast.Raise, ast.Continue, ast.Break)

Change = tuple[str, ast.AST]
"""Name of the operator, and the node's replacement."""


def changes(node: ast.AST) -> Iterator[Change]:
    """Yield every change of one node; the node itself is not modified."""
    match node:
        case ast.Compare():
            for k, op in enumerate(node.ops):
                for other in COMPARISONS[type(op)]:
                    yield "comparison", _with(node, ops=[*node.ops[:k], other(), *node.ops[k + 1 :]])
        case ast.BinOp(op=op) | ast.AugAssign(op=op) if type(op) in OPERATORS and not _text(node):
            yield "arithmetic", _with(node, op=OPERATORS[type(op)]())
        case ast.BoolOp(op=op):
            yield "and/or", _with(node, op=ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "not dropped", operand
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield "sign", operand
        case ast.Constant(value=bool(value)):
            yield "truth", ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            yield from _numbers(value)
        case ast.Call():
            yield from _calls(node)
        case ast.Subscript(slice=ast.Name(), ctx=ast.Load()):
            yield "index", _with(node, slice=ast.Constant(0))
        case ast.IfExp(test=test, body=body, orelse=orelse):
            yield "branches", ast.IfExp(test, orelse, body)
    if isinstance(node, _DELETED) or _is_effect(node):
        yield "statement deleted", ast.Pass()


def _with(node: ast.AST, **fields: Any) -> ast.AST:
    """Copy of a syntax node in which the given fields have other values."""
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _text(node: ast.AST) -> bool:
    """True if an operator joins or formats text."""
    return any(
        isinstance(part, ast.JoinedStr) or (isinstance(part, ast.Constant) and isinstance(part.value, str))
        for part in ast.iter_child_nodes(node)
    )


def _numbers(value: float) -> Iterator[Change]:
    if isinstance(value, int):
        yield "one more", ast.Constant(value + 1)
        if value:
            yield "one less", ast.Constant(value - 1)
    if value:
        yield "doubled", ast.Constant(2 * value)
        yield "sign", ast.UnaryOp(ast.USub(), ast.Constant(value))
    if value and isinstance(value, float):
        yield "halved", ast.Constant(value / 2)


def _calls(node: ast.Call) -> Iterator[Change]:
    name = getattr(node.func, "attr", getattr(node.func, "id", ""))
    if name in CALLS:
        yield "min/max", _with(node, func=_with(node.func, **{_field(node.func): CALLS[name]}))
    if name == "abs" and len(node.args) == 1:
        yield "abs dropped", node.args[0]
    plain = not any(isinstance(a, ast.Starred) for a in node.args)
    for k in range(len(node.args) - 1 if plain and name not in _SYMMETRIC else 0):
        first, second = node.args[k], node.args[k + 1]
        if ast.dump(first) != ast.dump(second):
            args = [*node.args[:k], second, first, *node.args[k + 2 :]]
            yield "arguments exchanged", _with(node, args=args)


def _field(function: ast.expr) -> str:
    return "attr" if isinstance(function, ast.Attribute) else "id"


def _is_effect(node: ast.AST) -> bool:
    """True if a statement can be deleted without leaving a name undefined."""
    match node:
        case ast.Expr(value=ast.Call()):
            return True
        case ast.Assign(targets=targets):
            return all(isinstance(target, ast.Attribute | ast.Subscript) for target in targets)
        case _:
            return False
