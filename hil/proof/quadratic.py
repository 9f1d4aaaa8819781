"""Quadratic forms x^T S x: exact over the rationals by L D L^T, or with balls; and Hessians on a box.

Exact forms need no tolerance, and twelve states are as easy as two. Cells cannot cover a box of twelve
states. Instead Taylor's theorem gives g(x) = x^T H(c x) x / 2 with some c of [0, 1] if g and its gradient are
zero at the origin. Therefore g is positive definite on the box if its Hessian H is positive definite on the
whole box.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction

import numpy as np
import sympy as sp
from flint import arb, arb_mat
from sympy.polys.matrices import DomainMatrix

from hil.proof.branch_and_bound import Budget, covered
from hil.proof.interval import Ball, Cell, Enclosure, Ranges, ball, unsupported

Matrix = list[list[Fraction]]


def fractions(S: sp.Matrix) -> Matrix:
    """SymPy matrix of rational numbers as nested lists of Fraction."""
    return [[Fraction(int(c.p), int(c.q)) for c in S.row(k)] for k in range(S.rows)]


def rational(value: Fraction) -> sp.Rational:
    """Python Fraction as a SymPy Rational."""
    return sp.Rational(value.numerator, value.denominator)


def form(g: sp.Expr, states: Sequence[sp.Symbol]) -> Matrix | None:
    """Symmetric S with g = x^T S x; None if g is not such a form with rational coefficients."""
    S = coefficients(g, states)
    if S is None or any(not c.is_Rational for row in S for c in row):
        return None
    return fractions(sp.Matrix(S))


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


def decompose(S: Matrix) -> tuple[list[Fraction], Matrix] | list[Fraction]:
    """Weights d > 0 and rows l of L^T with x^T S x = sum d_i (l_i x)^2; or an x with x^T S x < 0.

    Rows with d = 0 are omitted: with fewer rows than states S is semidefinite.
    """
    n = len(S)
    rest = [row[:] for row in S]
    d: list[Fraction] = []
    lines: Matrix = []
    order: list[int] = []
    for k in range(n):
        pivot = rest[k][k]
        if pivot < 0:
            return _back(_unit(n, k), lines, order)
        if pivot == 0:
            if any(rest[k]):
                j = next(j for j in range(n) if rest[k][j])
                x = _unit(n, j)  # (t e_k + e_j): 2 t s + q, with s != 0
                x[k] = -(rest[j][j] + 1) / (2 * rest[k][j])
                return _back(x, lines, order)
            continue
        line = [v / pivot for v in rest[k]]
        for i in range(n):
            if factor := rest[i][k]:
                rest[i] = [a - factor * b for a, b in zip(rest[i], line, strict=True)]
        d.append(pivot)
        lines.append(line)
        order.append(k)
    return d, lines


def _unit(n: int, k: int) -> list[Fraction]:
    return [Fraction(int(i == k)) for i in range(n)]


def _back(x: list[Fraction], lines: Matrix, order: list[int]) -> list[Fraction]:
    """Set the eliminated states of x so that x^T S x reduces to the part not yet decomposed."""
    for line, k in zip(reversed(lines), reversed(order), strict=True):
        x[k] -= sum((a * b for a, b in zip(line, x, strict=True)), Fraction(0))
    return x


def definite(S: Matrix) -> bool:
    """True if the symmetric S is positive definite: x^T S x > 0 for all x except zero; exact."""
    parts = decompose(S)
    return isinstance(parts, tuple) and len(parts[0]) == len(S)


def lines(S: Matrix, states: Sequence[sp.Symbol]) -> list[sp.Expr] | None:
    """Linear forms of the states that are all zero exactly where x^T S x = 0; None if it may be negative."""
    parts = decompose(S)
    if not isinstance(parts, tuple):
        return None
    return [sp.Add(*(rational(c) * x for c, x in zip(line, states, strict=True) if c)) for line in parts[1]]


def falls(S: Matrix) -> list[Fraction] | None:
    """Vector x != 0 with x^T S x <= 0; None if S is positive definite."""
    parts = decompose(S)
    if not isinstance(parts, tuple):
        return parts
    n = len(S)
    if len(parts[0]) == n:
        return None
    order = [next(k for k, c in enumerate(line) if c) for line in parts[1]]
    free = next(k for k in range(n) if k not in order)
    return _back(_unit(n, free), parts[1], order)


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
    return covered(
        [tuple(ranges.values())], lambda p: positive_definite(entries([*box, *p])), budget, 200
    )  # fmt: skip
