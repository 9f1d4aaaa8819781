"""Changes to one node of a syntax tree: each is one plausible mistake."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from typing import Any

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
