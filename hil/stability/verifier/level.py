"""The sublevel set of V inside the box: what starts in it stays in it.

Rule of the room: if V >= c on the whole boundary and dV/dt <= 0 in the box, no trajectory that starts in
the box with V < c reaches the boundary.
"""

from __future__ import annotations

from itertools import product

import sympy as sp

from hil.stability.verifier.interval import number
from hil.stability.verifier.signs import Signs

_SHARES = (sp.Integer(1), sp.Rational(999, 1000), sp.Rational(99, 100), sp.Rational(9, 10), sp.Rational(1, 2))


def largest_level(V: sp.Expr, signs: Signs) -> sp.Expr | None:
    """Return a c with V >= c on the boundary of the domain: the largest that is shown, or None."""
    system = signs.system
    if not system.bounded or system.ranges or not signs.enclosable(V):
        return None
    faces = [(x, end) for x in system.states for end in system.domain[x]]
    values = [V.subs(point) for x, end in faces for point in _samples(signs, x, end)]
    lowest = min(
        (v for v in values if v.is_number and number(v).is_finite()),
        key=lambda v: float(number(v)),
        default=None,
    )
    if lowest is None or not number(lowest) > 0:
        return None
    for share in _SHARES:
        c = lowest if share == 1 else sp.Rational(float(number(lowest))).limit_denominator(1000) * share
        if all(_at_least(sp.expand(V.subs(x, end) - c), signs) for x, end in faces):
            return c
    return None


def _samples(signs: Signs, x: sp.Symbol, end: sp.Expr) -> list[dict[sp.Symbol, sp.Expr]]:
    others = [y for y in signs.system.states if y != x]
    shares = [sp.Rational(k, 4) for k in range(-4, 5)] if len(others) <= 2 else [-1, 0, 1]
    ends = signs.system.domain
    return [
        {x: end} | {y: abs(s) * ends[y][1 if s > 0 else 0] for y, s in zip(others, some, strict=True)}
        for some in product(shares, repeat=len(others))
    ]


def _at_least(g: sp.Expr, signs: Signs) -> bool:
    if not signs.own(g):
        return bool(g.is_nonnegative) or bool(number(g) > 0)
    return signs.nonnegative(g) is not None or signs.positive(g)
