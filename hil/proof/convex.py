"""Positive definite matrices of balls, and functions that are convex on a box: many states at once.

Cells cannot cover a box of twelve states. But by Taylor's theorem g(x) = x^T H(c x) x / 2 with some c of
[0, 1] if g and its gradient are zero at the origin, so a Hessian H that is positive definite all over the box
makes g positive definite there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp
from flint import arb

from hil.proof.branch_and_bound import Budget, covered
from hil.proof.interval import Ball, Cell, Enclosure, ball, unsupported

LONGEST = 2000
"""Operations in a function beyond which its Hessian is not formed."""


def positive_definite(H: Sequence[Sequence[Ball]]) -> bool:
    """Tell whether every symmetric matrix within H is positive definite.

    T^T H T is, T diagonalising the middle of H, if its diagonal dominates; then H is.
    """
    n = len(H)
    if not all(b.is_finite() for row in H for b in row):
        return False
    middle = np.array([[float(b.mid()) for b in row] for row in H])
    if not np.isfinite(middle).all():
        return False
    values, vectors = np.linalg.eigh((middle + middle.T) / 2)
    if not values.min() > 0:
        return False
    T = [[arb(float(v)) for v in row] for row in vectors / np.sqrt(values)]
    HT = [[sum((H[i][k] * T[k][j] for k in range(n)), arb(0)) for j in range(n)] for i in range(n)]
    D = [[sum((T[k][i] * HT[k][j] for k in range(n)), arb(0)) for j in range(n)] for i in range(n)]
    return all(D[i][i] > sum((D[i][j].abs_upper() for j in range(n) if j != i), arb(0)) for i in range(n))


def definite_form(
    S: Sequence[Sequence[sp.Expr]], ranges: Sequence[tuple[sp.Symbol, tuple[float, float]]], budget: Budget
) -> bool:
    """Tell whether x^T S x is positive definite for all values of the parameters in S."""
    names = tuple(p for p, _ in ranges)
    entries = [[Enclosure(c, names) for c in row] for row in S]
    return covered(
        [tuple(r for _, r in ranges)],
        lambda p: positive_definite([[c(p) for c in row] for row in entries]),
        budget,
        500,
    )


def convex_definite(
    g: sp.Expr, states: Sequence[sp.Symbol], sides: Cell,
    ranges: Sequence[tuple[sp.Symbol, tuple[float, float]]], budget: Budget,
) -> bool:  # fmt: skip
    """Tell whether g, zero at the origin, is shown to be positive elsewhere in the box by its Hessian."""
    if g.count_ops() > LONGEST:
        return False
    gradient = [sp.diff(g, x) for x in states]
    origin = dict.fromkeys(states, sp.S.Zero)
    if any(unsupported(d) for d in gradient) or any(sp.expand(d.subs(origin)) != 0 for d in gradient):
        return False
    hessian = [[sp.diff(d, x) for x in states[: k + 1]] for k, d in enumerate(gradient)]
    if any(unsupported(h) for row in hessian for h in row):
        return False
    names = (*states, *(p for p, _ in ranges))
    rows = [[Enclosure(h, names) for h in row] for row in hessian]
    box = [ball(*side) for side in sides]

    def holds(p: Sequence[Ball]) -> bool:
        half = [[h([*box, *p]) for h in row] for row in rows]
        n = len(half)
        return positive_definite([[half[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)])

    return covered([tuple(r for _, r in ranges)], holds, budget, 200)
