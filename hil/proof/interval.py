"""Interval arithmetic: an expression becomes a function from balls to a ball that encloses all its values.

Python-flint's arb rounds outward, so an enclosure contains every value. If an expression is undefined on a
ball (a pole, the logarithm of zero), the enclosure is not finite, and every comparison with it is false.
arb's own power gives no enclosure for a ball with negative numbers; here it is formed from the ends of the
ball.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from operator import methodcaller
from typing import Any

import sympy as sp
from flint import arb, fmpq

from drivers.errors import ModelError

Ball = Any
"""Interval as midpoint and radius, a `flint.arb`."""
Cell = tuple[tuple[float, float], ...]
"""One pair (lower, upper) for each variable; the floats are exact."""
Ranges = Mapping[sp.Symbol, tuple[float, float]]
"""Parameter -> its bounds (lower, upper)."""

_UNARY: dict[Any, Callable[[Ball], Ball]] = {
    sp.Abs: lambda x: x.abs_lower().union(x.abs_upper()),
    **{
        f: methodcaller(f.__name__)
        for f in (sp.sin, sp.cos, sp.tan, sp.exp, sp.log, sp.sinh, sp.cosh, sp.tanh, sp.atan)
    },
}
"""Functions allowed in f and V, in addition to sums, products and powers."""
FUNCTIONS = frozenset(_UNARY)
ALLOWED = f"sums, products, rational powers, {', '.join(sorted(f.__name__ for f in FUNCTIONS))}"
_NODES = (sp.Symbol, sp.Rational, sp.Add, sp.Mul)


class Enclosure:
    """Interval extension of an expression: a function from balls of its variables to a ball."""

    def __init__(self, expression: sp.Expr, variables: Sequence[sp.Symbol]) -> None:
        self._count = len(variables)
        self._steps: list[tuple[Callable[..., Ball], tuple[int, ...]]] = []
        self._known: dict[sp.Expr, int] = {v: k for k, v in enumerate(variables)}
        self._result = self._place(expression)

    def __call__(self, balls: Sequence[Ball]) -> Ball:
        """Ball that encloses every value of the expression for variables in `balls`, in their order."""
        values = list(balls)
        for action, places in self._steps:
            values.append(action(*[values[p] for p in places]))
        return values[self._result]

    def on(self, cell: Cell) -> Ball:
        """Ball that encloses every value of the expression on a cell."""
        return self([ball(*side) for side in cell])

    def _place(self, e: sp.Expr) -> int:
        if e not in self._known:
            action, parts = _action(e)
            places = tuple(self._place(p) for p in parts)
            self._steps.append((action, places))
            self._known[e] = self._count + len(self._steps) - 1
        return self._known[e]


def ball(lower: float, upper: float) -> Ball:
    """Ball that encloses [lower, upper]; for an infinite end a ball of all numbers."""
    if math.isinf(lower) or math.isinf(upper):
        return arb(0, math.inf)
    return arb(lower) if lower == upper else arb(lower).union(arb(upper))


def number(value: sp.Expr) -> Ball:
    """Ball that encloses the value of an expression without variables."""
    if isinstance(value, sp.Rational):
        return arb(fmpq(int(value.p), int(value.q)))
    return Enclosure(sp.sympify(value), ())(())


def outward(lower: sp.Expr, upper: sp.Expr) -> tuple[float, float]:
    """Floats (low, high) that enclose [lower, upper], rounded outward only where an end is not a float."""
    return _outside(lower, -math.inf), _outside(upper, math.inf)


def _outside(end: sp.Expr, towards: float) -> float:
    if end.is_infinite:
        return towards
    if end.is_Rational and sp.Rational(float(end)) == end:
        return float(end)
    there = number(end)
    return math.nextafter(float(there.lower() if towards < 0 else there.upper()), towards)


def unsupported(e: sp.Expr) -> set[str]:
    """Names of the functions and powers in an expression that have no enclosure."""
    wrong: set[str] = set()
    for node in sp.preorder_traversal(e):
        if isinstance(node, sp.Pow):
            if not (node.exp.is_Rational or node.base == sp.E):
                wrong.add(str(node))
        elif not isinstance(node, _NODES) and node.func not in FUNCTIONS and node not in (sp.pi, sp.E):
            wrong.add(str(node.func))
    return wrong


def _action(e: sp.Expr) -> tuple[Callable[..., Ball], tuple[sp.Expr, ...]]:
    if isinstance(e, sp.Rational):
        value = number(e)
        return (lambda: value), ()
    if e is sp.pi:
        return arb.pi, ()
    if e is sp.E:
        return arb.const_e, ()
    if isinstance(e, sp.Add):
        return lambda *terms: sum(terms[1:], terms[0]), e.args
    if isinstance(e, sp.Mul):
        return lambda *factors: math.prod(factors[1:], start=factors[0]), e.args
    if e.func in _UNARY:
        return _UNARY[e.func], e.args
    if isinstance(e, sp.Pow) and e.exp.is_Rational:
        base, p = e.args
        if p.is_Integer:
            return (lambda x: _integer_power(x, int(p))), (base,)
        if isinstance(base, sp.Abs):
            return (lambda x: _root_power(x.abs_lower(), x.abs_upper(), p)), base.args
        return (lambda x: _root_power(x.lower(), x.upper(), p)), (base,)
    raise ModelError(f"no enclosure of {e}: {ALLOWED} have one")


def _integer_power(x: Ball, n: int) -> Ball:
    if n < 0:
        return 1 / _integer_power(x, -n)
    low, high = (x.abs_lower(), x.abs_upper()) if n % 2 == 0 else (x.lower(), x.upper())
    return (low**n).union(high**n)


def _root_power(low: Ball, high: Ball, p: sp.Rational) -> Ball:
    """x^p is monotone for x >= 0; low and high are points."""
    if not (low > 0 or (low.is_zero() and p > 0)):
        return arb.nan()
    ends = [arb(0) if x.is_zero() else (x.log() * number(p)).exp() for x in (low, high)]
    return ends[0].union(ends[1])
