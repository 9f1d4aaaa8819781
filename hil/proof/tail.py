"""Positive far away: x_i = u_i / s^w_i with u on the faces of the unit cube and 0 <= s <= 1/R.

A global claim concerns an unbounded set, which no number of cells covers. A polynomial in the unbounded
states, with sines and similar functions as unknown numbers of [-1, 1], becomes s^-D times a function that is
also defined at s = 0. If that function is positive on all (u, s), so is g, and it grows like R^D.
"""

from collections.abc import Mapping, Sequence
from math import lcm

import sympy as sp

from hil.proof.branch_and_bound import Budget, faces, positive
from hil.proof.interval import Cell, Enclosure

RADII = tuple(2.0**k for k in range(0, 13, 2))
HIGHEST_ORDER = 24
_BOUNDED = (sp.sin, sp.cos, sp.tanh)
"""Functions with values within [-1, 1]."""


def definite_far(
    g: sp.Expr, states: Sequence[sp.Symbol], others: Mapping[sp.Symbol, tuple[float, float]], budget: Budget
) -> tuple[float, ...] | None:
    """Radii r_i such that g > 0 if some |x_i| >= r_i, and g is radially unbounded; or None.

    `others` are bounded variables of g with their ranges. Each power of the radius is at least one.
    """
    nodes = sorted(g.atoms(*_BOUNDED), key=sp.count_ops, reverse=True)
    masks = {n: sp.Dummy("z", real=True) for n in nodes if not n.free_symbols.isdisjoint(states)}
    masked = sp.expand(g.xreplace(masks))
    signless = {sp.Abs(x): sp.Dummy(f"abs_{x}", positive=True) for x in states}
    try:
        form = sp.Poly(masked.xreplace(signless), *states, *signless.values())
    except sp.PolynomialError:
        return None
    if any(not c.free_symbols.isdisjoint(states) for c in form.coeffs()):
        return None
    n = len(states)
    degrees = [tuple(a + b for a, b in zip(m[:n], m[n:], strict=True)) for m in form.monoms()]
    tops = [max((d[i] for d in degrees if sum(d) == d[i]), default=0) for i in range(n)]
    if 0 in tops:
        return None
    D = lcm(*tops)
    weights = [D // e for e in tops]
    highest = max(sum(w * d for w, d in zip(weights, degree, strict=True)) for degree in degrees)
    if D > HIGHEST_ORDER or highest > D:
        return None
    s = sp.Dummy("s", positive=True)
    u = tuple(sp.Dummy(f"u_{x}", real=True) for x in states)
    there = {x: v / s**w for x, v, w in zip(states, u, weights, strict=True)}
    scaled = sp.expand(s**D * sp.expand(masked.xreplace(there)))
    variables = (*u, *masks.values(), *others, s)
    sides: Cell = (*(((-1.0, 1.0),) * n), *(((-1.0, 1.0),) * len(masks)), *others.values())
    h = Enclosure(scaled, variables)
    for radius in RADII:
        if positive([h], [(*c, (0.0, 1 / radius)) for c in faces(sides, range(n))], budget, 375):
            return tuple(radius**w for w in weights)
    return None
