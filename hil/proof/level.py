"""Invariant sublevel set of V inside the box: a trajectory that starts in it stays in it.

If V >= c on the whole boundary and dV/dt <= 0 in the box, no trajectory that starts in the box with V < c
reaches the boundary.
"""

from itertools import product

import sympy as sp

from hil.proof import quadratic
from hil.proof.interval import number
from hil.proof.signs import Signs

_HALVINGS = 8
"""Halvings of the interval that contains the largest level."""


def largest_level(V: sp.Expr, signs: Signs) -> sp.Expr | None:
    """Largest c that is shown to satisfy V >= c on the boundary of the domain, or None."""
    system = signs.system
    if not system.bounded or system.ranges or not signs.enclosable(V):
        return None
    if (P := quadratic.form(V, system.states)) is not None and quadratic.definite(P):
        return _of_form(P, signs)
    faces = [(x, end) for x in system.states for end in system.domain[x]]
    values = [V.subs(point) for x, end in faces for point in _samples(signs, x, end)]
    finite = [v for v in values if v.is_number and number(v).is_finite()]
    lowest = min(finite, key=lambda v: float(number(v)), default=sp.S.Zero)
    if not number(lowest) > 0:
        return None
    if _holds(V, lowest, faces, signs):
        return lowest
    low, high = sp.S.Zero, sp.Rational(float(number(lowest))).limit_denominator(1000)
    for _ in range(_HALVINGS):
        c = (low + high) / 2
        low, high = (c, high) if _holds(V, c, faces, signs) else (low, c)
    return low if low > 0 else None


def _of_form(P: quadratic.Matrix, signs: Signs) -> sp.Expr | None:
    """Smallest value of a quadratic form on the faces of the domain; irrational ends are rounded inwards."""
    inverse = sp.Matrix(P).inv()
    levels = []
    for k, x in enumerate(signs.system.states):
        for end in map(abs, signs.system.domain[x]):
            within = end if end.is_Rational else sp.Rational(float(number(end).lower()) * (1 - 2.0**-40))
            levels.append(within**2 / inverse[k, k])
    return min(levels)


def _samples(signs: Signs, x: sp.Symbol, end: sp.Expr) -> list[dict[sp.Symbol, sp.Expr]]:
    others = [y for y in signs.system.states if y != x]
    shares, ends = [-1, 0, 1] if len(others) <= 4 else [0], signs.system.domain
    return [
        {x: end} | {y: abs(s) * ends[y][1 if s > 0 else 0] for y, s in zip(others, some, strict=True)}
        for some in product(shares, repeat=len(others))
    ]


def _holds(V: sp.Expr, c: sp.Expr, faces: list[tuple[sp.Symbol, sp.Expr]], signs: Signs) -> bool:
    """True if V >= c is proven on all faces (state, end) of the box."""
    for x, end in faces:
        g = sp.expand(V.subs(x, end) - c)
        constant = not signs.own(g) and (g.is_nonnegative or number(g) > 0)
        if not (constant or (signs.own(g) and (signs.nonnegative(g) is not None or signs.positive(g)))):
            return False
    return True
