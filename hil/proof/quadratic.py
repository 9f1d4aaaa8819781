"""Quadratic forms x^T S x: exact over the rationals by L D L^T, or with balls; and Hessians on a box.

Exact forms need no tolerance, and twelve states are as easy as two. Cells cannot cover a box of twelve
states. Instead Taylor's theorem gives g(x) = x^T H(c x) x / 2 with some c of [0, 1] if g and its gradient are
zero at the origin. Therefore g is positive definite on the box if its Hessian H is positive definite on the
whole box.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import sympy as sp
from flint import arb, arb_mat
from sympy.polys.matrices import DomainMatrix

from hil.proof.branch_and_bound import Budget, covered
from hil.proof.interval import Ball, Cell, Enclosure, Ranges, ball, unsupported

Matrix = list[list[sp.Rational]]


def form(g: sp.Expr, states: Sequence[sp.Symbol]) -> Matrix | None:
    """Symmetric S with g = x^T S x; None if g is not such a form with rational coefficients."""
    S = coefficients(g, states)
    return None if S is None or any(not c.is_Rational for row in S for c in row) else S


def coefficients(g: sp.Expr, states: Sequence[sp.Symbol]) -> list[list[sp.Expr]] | None:
    """Symmetric S with g = x^T S x, whose entries may contain parameters; None if g is not such a form."""
    place = {x: k for k, x in enumerate(states)}
    S: list[list[sp.Expr]] = [[sp.S.Zero] * len(states) for _ in states]
    for term in sp.Add.make_args(sp.expand(g)):
        c, monomial = term.as_independent(*states, as_Add=False)
        powers = monomial.as_powers_dict()
        if sum(powers.values()) != 2 or any(x not in place or p not in (1, 2) for x, p in powers.items()):
            return None
        i, j = (place[x] for x, p in powers.items() for _ in range(int(p)))
        S[i][j] += c / 2
        S[j][i] += c / 2
    return S


def decompose(S: Matrix) -> tuple[dict[int, list[sp.Rational]], list[sp.Rational] | None]:
    """Rows l_k of L^T with x^T S x = sum d_k (l_k x)^2, d_k > 0; and an x with x^T S x < 0, or None.

    Rows with d = 0 are omitted: with fewer rows than states S is semidefinite.
    """
    n = len(S)
    rest = [row[:] for row in S]
    lines: dict[int, list[sp.Rational]] = {}
    for k in range(n):
        pivot = rest[k][k]
        if pivot < 0:
            return lines, _back(_unit(n, k), lines)
        if pivot == 0:
            if any(rest[k]):
                j = next(j for j in range(n) if rest[k][j])
                x = _unit(n, j)  # (t e_k + e_j): 2 t s + q, with s != 0
                x[k] = -(rest[j][j] + 1) / (2 * rest[k][j])
                return lines, _back(x, lines)
            continue
        line = lines[k] = [v / pivot for v in rest[k]]
        for i in range(n):
            if factor := rest[i][k]:
                rest[i] = [a - factor * b for a, b in zip(rest[i], line, strict=True)]
    return lines, None


def _unit(n: int, k: int) -> list[sp.Rational]:
    return [sp.Integer(i == k) for i in range(n)]


def _back(x: list[sp.Rational], lines: dict[int, list[sp.Rational]]) -> list[sp.Rational]:
    """Set the eliminated states of x so that x^T S x reduces to the part not yet decomposed."""
    for k, line in reversed(lines.items()):
        x[k] -= sum(a * b for a, b in zip(line, x, strict=True))
    return x


def definite(S: Matrix) -> bool:
    """True if the symmetric S is positive definite: x^T S x > 0 for all x except zero; exact."""
    return falls(S) is None


def lines(S: Matrix, states: Sequence[sp.Symbol]) -> list[sp.Expr] | None:
    """Linear forms of the states that are all zero exactly where x^T S x = 0; None if it may be negative."""
    rows, negative = decompose(S)
    if negative is not None:
        return None
    return [sp.Add(*(c * x for c, x in zip(line, states, strict=True))) for line in rows.values()]


def falls(S: Matrix) -> list[sp.Rational] | None:
    """Vector x != 0 with x^T S x <= 0; None if S is positive definite."""
    rows, x = decompose(S)
    free = next((k for k in range(len(S)) if k not in rows), None)
    return x if x is not None or free is None else _back(_unit(len(S), free), rows)


def leading_minors(S: Sequence[Sequence[sp.Expr]]) -> Iterator[sp.Expr]:
    """Yield the leading principal minors: a form is positive definite where all are positive."""
    for k in range(1, len(S) + 1):
        corner = DomainMatrix.from_Matrix(sp.Matrix([row[:k] for row in S[:k]])).to_field()
        yield corner.domain.to_sympy(corner.det())


LONGEST = 2000
"""Largest number of operations in a function whose Hessian is formed."""


def positive_definite(H: Sequence[Sequence[Ball]]) -> bool:
    """Prove that every symmetric matrix within H is positive definite.

    T diagonalises the middle of H. If the diagonal of T^T H T dominates, T^T H T is positive definite, and so
    is H.
    """
    middle = middle_of(H)
    if middle is None:
        return False
    values, vectors = np.linalg.eigh((middle + middle.T) / 2)
    if not values.min() > 0:
        return False
    T = arb_mat((vectors / np.sqrt(values)).tolist())
    D = (T.transpose() * arb_mat(H) * T).tolist()
    return all(
        row[i] > sum((b.abs_upper() for j, b in enumerate(row) if j != i), arb(0)) for i, row in enumerate(D)
    )


def middle_of(H: Sequence[Sequence[Ball]]) -> np.ndarray | None:
    """Matrix of the middles of balls; None if a ball is not finite."""
    middle = np.array([[float(b.mid()) if b.is_finite() else np.inf for b in row] for row in H])
    return middle if np.isfinite(middle).all() else None


def enclosures(
    rows: Sequence[Sequence[sp.Expr]], names: Sequence[sp.Symbol]
) -> Callable[[Sequence[Ball]], list[list[Ball]]]:
    """Function from balls of the variables `names` to balls of all entries of a matrix."""
    entries = [[Enclosure(c, names) for c in row] for row in rows]
    return lambda balls: [[e(balls) for e in row] for row in entries]


def definite_form(S: Sequence[Sequence[sp.Expr]], ranges: Ranges, budget: Budget) -> bool:
    """Prove that x^T S x is positive definite for all values, within `ranges`, of the parameters in S."""
    entries = enclosures(S, tuple(ranges))
    return covered([tuple(ranges.values())], lambda p: positive_definite(entries(p)), budget, 500)


def convex_definite(
    g: sp.Expr, states: Sequence[sp.Symbol], sides: Cell,
    ranges: Ranges, budget: Budget,
) -> bool:  # fmt: skip
    """Prove by its Hessian that g, zero at the origin, is positive elsewhere in the box."""
    if g.count_ops() > LONGEST:
        return False
    gradient = [sp.diff(g, x) for x in states]
    origin = dict.fromkeys(states, sp.S.Zero)
    if any(unsupported(d) for d in gradient) or any(sp.expand(d.subs(origin)) != 0 for d in gradient):
        return False
    hessian = [[sp.diff(d, x) for x in states] for d in gradient]
    if any(unsupported(h) for row in hessian for h in row):
        return False
    entries, box = enclosures(hessian, (*states, *ranges)), [ball(*side) for side in sides]
    return covered([tuple(ranges.values())], lambda p: positive_definite(entries([*box, *p])), budget, 200)
