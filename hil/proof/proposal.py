"""A V for a system that came without one: x^T P x with A^T P + P A = -Q, Q = 1, over the rationals.

It is a guess like any other: what it proves, and where, is shown by the theorems for the whole f. Ranges of
parameters are taken at their middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import sympy as sp
from flint import fmpq, fmpq_mat

from hil.proof import quadratic
from hil.proof.eigenvalues import lyapunov_matrix
from hil.proof.linearisation import jacobian
from hil.proof.system import System

EXACT = 4
"""States up to which the equation is solved exactly; of more the solution is rounded, and shown again."""
SYMBOLIC = 3
"""States up to which it is solved with parameters that may be any positive number."""


def lyapunov_function(system: System) -> sp.Expr | None:
    """Return x^T P x for the linearisation A, or None if the equation has no such solution."""
    A = jacobian(system)
    if A is None:
        return None
    middle = A.subs({p: (low + high) / 2 for p, (low, high) in system.ranges.items()}).applyfunc(sp.expand)
    if middle.free_symbols:
        return _with_parameters(middle, system.states) if A.rows <= SYMBOLIC else None
    if not all(a.is_Rational for a in middle):
        middle = middle.applyfunc(lambda a: sp.Rational(float(a)).limit_denominator(10**6))
    rows = [[quadratic.fraction(a) for a in middle.row(i)] for i in range(A.rows)]
    P = _solved(rows) if A.rows <= EXACT else _rounded(rows)
    if P is None:
        return None
    x = system.states
    return sp.expand(
        sum(
            (quadratic.rational(c) * x[i] * x[j] for i, r in enumerate(P) for j, c in enumerate(r)), sp.S.Zero
        )
    )


def _solved(A: quadratic.Matrix) -> quadratic.Matrix | None:
    n = len(A)
    places = [(i, j) for i in range(n) for j in range(i, n)]
    column = {p: k for k, p in enumerate(places)}
    rows = [[Fraction(0)] * len(places) for _ in places]
    for row, (i, j) in zip(rows, places, strict=True):  # (A^T P + P A)_ij
        for k in range(n):
            row[column[min(k, j), max(k, j)]] += A[k][i]
            row[column[min(i, k), max(i, k)]] += A[k][j]
    left = fmpq_mat([[fmpq(c.numerator, c.denominator) for c in row] for row in rows])
    right = fmpq_mat([[fmpq(-int(i == j))] for i, j in places])
    try:
        solution = [Fraction(int(v.p), int(v.q)) for v in left.solve(right).entries()]
    except ZeroDivisionError:
        return None
    return [[solution[column[min(i, j), max(i, j)]] for j in range(n)] for i in range(n)]


def _rounded(A: quadratic.Matrix) -> quadratic.Matrix | None:
    n = len(A)
    P = lyapunov_matrix(np.array([[float(c) for c in row] for row in A]), np.eye(n))
    if P is None:
        return None
    for digits in (3, 5, 7, 9, 12, 15):
        unit = Fraction(10) ** (int(np.floor(np.log10(abs(P).max()))) - digits)
        R = [[round(Fraction(float(v)) / unit) * unit for v in row] for row in P]
        fall = [
            [-sum((A[k][i] * R[k][j] + R[i][k] * A[k][j] for k in range(n)), Fraction(0)) for j in range(n)]
            for i in range(n)
        ]
        if quadratic.definite(R) and quadratic.definite(fall):
            return R
    return None


def _with_parameters(A: sp.Matrix, x: Sequence[sp.Symbol]) -> sp.Expr | None:
    n = A.rows
    unknown = {(i, j): sp.Dummy(f"p{i}{j}") for i in range(n) for j in range(i, n)}
    P = sp.Matrix(n, n, lambda i, j: unknown[min(i, j), max(i, j)])
    equations = [(A.T * P + P * A + sp.eye(n))[i, j] for i, j in unknown]
    found = list(sp.linsolve(equations, *unknown.values()))
    if not found or not {s for value in found[0] for s in value.free_symbols} <= A.free_symbols:
        return None
    X = sp.Matrix(x)
    solved = P.subs(dict(zip(unknown.values(), found[0], strict=True)))
    V = sp.together(sp.expand((X.T * solved * X)[0, 0]))
    top, bottom = sp.fraction(V)
    return sp.expand(top / bottom) if bottom.is_number else sp.expand(sp.factor(top)) / sp.factor(bottom)
