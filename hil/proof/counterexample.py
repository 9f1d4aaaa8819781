"""Counterexamples: points where a claim is false, verified by interval arithmetic or exactly.

The search is heuristic; each point found is proven. An unsuccessful search proves nothing.
"""

import heapq
from collections.abc import Callable, Iterator, Sequence
from itertools import chain, count, product

import sympy as sp

from hil.proof import quadratic
from hil.proof.branch_and_bound import halves, middle
from hil.proof.interval import Ball, Cell, Enclosure, ball, number, unsupported
from hil.proof.signs import Signs
from hil.proof.system import Point

_LENGTHS = tuple(map(sp.Rational, ("1", "1/10", "1/2", "2", "5", "1/100", "100", "1000", "9/10", "1/1000")))
_ANGLES = (sp.pi / 2, sp.pi, 2 * sp.pi)
_PARAMETERS = (sp.Integer(1), sp.Rational(1, 8), sp.Integer(8))
_WINDOW = 4.0
"""Half width of the search in an unbounded domain."""
_SEARCH = 250
"""Number of cells of the search."""


def find(g: sp.Expr, signs: Signs, *, or_zero: bool = False) -> Point | None:
    """Point other than the equilibrium with g > 0 (or = 0) for all values of the rounded numbers, or None.

    For a quadratic form its leading direction decides.
    """
    if unsupported(g):
        return None
    system = signs.system
    rounded = tuple(system.rounded.numbers)
    names = (*system.states, *(p for p in system.ranges if p not in rounded), *system.positive)
    h = Enclosure(g, (*names, *rounded))
    whole = [ball(*signs.sides[p]) for p in rounded]
    form = quadratic.form(g, system.states)
    for point in _downhill(g, signs) if form else chain(_downhill(g, signs), _points(g, signs)):
        value = h([*(number(point[v]) for v in names), *whole])
        if not (value > 0 or (or_zero and value.contains(0))) or not _inside(signs, point):
            continue
        if value > 0 or (value.rad() < 1e-9 and sp.simplify(g.subs(point)) == 0):
            return point
    return None if form else _searched(lambda x: h([*x, *whole]), names, signs)


def _downhill(g: sp.Expr, signs: Signs) -> Iterator[Point]:
    """Candidate points along a direction in which the quadratic part of g is positive or zero."""
    states = signs.system.states
    for parameters in _parameters(signs):
        S = quadratic.form(_leading(g.subs(parameters), states), states)
        direction = None if S is None else quadratic.falls([[-c for c in row] for row in S])
        if direction is None:
            continue
        d = [c / max(map(abs, direction)) for c in direction]
        if max(len(str(c)) for c in d) > 60:
            continue
        ends = [abs(end) for side in signs.system.domain.values() for end in side if not end.is_infinite]
        reach = min([sp.Rational(float(number(end).lower())) for end in ends], default=sp.S.One)
        for k in (0, 4, 10, 20, 30):
            yield {x: c * reach / 2**k for x, c in zip(states, d, strict=True)} | parameters


def _leading(g: sp.Expr, states: Sequence[sp.Symbol]) -> sp.Expr:
    """Quadratic part of a polynomial g without lower terms; g itself otherwise."""
    try:
        p = sp.Poly(g, *states)
    except sp.PolynomialError:
        return g
    if p.total_degree() > 40 or any(sum(m) < 2 for m in p.monoms()):
        return g
    return sp.Add(*(c * sp.Mul(*map(sp.Pow, states, m)) for m, c in p.terms() if sum(m) == 2))


def _points(g: sp.Expr, signs: Signs) -> Iterator[Point]:
    states = signs.system.states
    n = len(states)
    ends = [tuple(s if i == j else 0 for j in range(n)) for i in range(n) for s in (1, -1)]
    sparse = [*ends, (1,) * n, (-1,) * n]
    directions = [d for d in product((0, 1, -1), repeat=n) if any(d)] if n <= 4 else sparse
    angles = _ANGLES if g.has(sp.sin, sp.cos, sp.tan) and not signs.system.bounded else ()
    for parameters in _parameters(signs):
        for length, d in product((*_LENGTHS, *angles), directions):
            yield {x: _step(signs, x, k, length) for x, k in zip(states, d, strict=True)} | parameters


def _step(signs: Signs, x: sp.Symbol, k: int, length: sp.Expr) -> sp.Expr:
    """Coordinate at a length, at most 1, as a share of a finite side of the domain, else at the length."""
    end = signs.system.domain[x][k > 0]
    return k * length if k == 0 or end.is_infinite else end * min(length, sp.S.One)


def _parameters(signs: Signs) -> list[Point]:
    """Values of the parameters to try: all combinations of up to three parameters, else three sets."""
    rounded = signs.system.rounded.numbers
    choices = {
        p: ((low + high) / 2, low, high) for p, (low, high) in signs.system.ranges.items() if p not in rounded
    } | dict.fromkeys(signs.system.positive, _PARAMETERS)
    some = product(*choices.values()) if len(choices) <= 3 else zip(*choices.values(), strict=True)
    return [dict(zip(choices, values, strict=True)) for values in some]


def _searched(h: Callable[[Sequence[Ball]], Ball], names: Sequence[sp.Symbol], signs: Signs) -> Point | None:
    """Point with h > 0 by best-first search, which halves the cell with the highest upper bound; or None."""
    if signs.system.positive:
        return None
    sides: Cell = tuple(
        (max(low, -_WINDOW), min(high, _WINDOW)) for low, high in (signs.sides[v] for v in names)
    )
    order = count()
    heap = [(0.0, next(order), sides)]
    for _ in range(_SEARCH):
        if not heap or not signs.budget.take():
            return None
        cell = heapq.heappop(heap)[2]
        m = middle(cell)
        if h([ball(v, v) for v in m]) > 0:
            point = {x: sp.Rational(v) for x, v in zip(names, m, strict=True)}
            if _inside(signs, point):
                return point
        widest = max(range(len(cell)), key=lambda k: cell[k][1] - cell[k][0])
        for half in halves(cell, widest):
            value = h([ball(*side) for side in half])
            if not value <= 0:
                upper = float(value.upper()) if value.is_finite() else float("inf")
                heapq.heappush(heap, (-upper, next(order), half))
    return None


def _inside(signs: Signs, point: Point) -> bool:
    sides = signs.system.domain | signs.system.ranges
    return all(
        bool(low <= point[v]) and bool(point[v] <= high) for v, (low, high) in sides.items() if v in point
    )
