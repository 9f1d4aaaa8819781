"""A V for a system that came without one: x^T P x with A^T P + P A = -Q, Q = 1, over the rationals.

It is a guess like any other: what it proves, and where, is shown by the theorems for the whole f. Ranges of
parameters are taken at their middle.
"""

from __future__ import annotations

import numpy as np
import sympy as sp

from hil.proof import quadratic
from hil.proof.linearisation import jacobian, lyapunov_matrix
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
    if not (middle.free_symbols or all(a.is_Rational for a in middle)):
        middle = middle.applyfunc(lambda a: sp.Rational(float(a)).limit_denominator(10**6))
    if A.rows <= (SYMBOLIC if middle.free_symbols else EXACT):
        P = _solved(middle)
    else:
        P = None if middle.free_symbols else _rounded(middle)
    if P is None:
        return None
    X = sp.Matrix(system.states)
    top, bottom = sp.fraction(sp.together(sp.expand((X.T * P * X)[0, 0])))
    return sp.expand(top / bottom) if bottom.is_number else sp.expand(sp.factor(top)) / sp.factor(bottom)


def _solved(A: sp.Matrix) -> sp.Matrix | None:
    n = A.rows
    unknown = {(i, j): sp.Dummy(f"p{i}{j}") for i in range(n) for j in range(i, n)}
    P = sp.Matrix(n, n, lambda i, j: unknown[min(i, j), max(i, j)])
    equations = [(A.T * P + P * A + sp.eye(n))[i, j] for i, j in unknown]
    found = list(sp.linsolve(equations, *unknown.values()))
    if not found or not {s for value in found[0] for s in value.free_symbols} <= A.free_symbols:
        return None
    return P.subs(dict(zip(unknown.values(), found[0], strict=True)))


def _rounded(A: sp.Matrix) -> sp.Matrix | None:
    P = lyapunov_matrix(np.array(A, float))
    if P is None:
        return None
    for digits in (3, 5, 7, 9, 12, 15):
        unit = sp.Rational(10) ** (int(np.floor(np.log10(abs(P).max()))) - digits)
        R = sp.Matrix(A.rows, A.rows, lambda i, j, unit=unit: round(sp.Rational(P[i, j]) / unit) * unit)
        if all(quadratic.definite(quadratic.fractions(S)) for S in (R, -(A.T * R + R * A))):
            return R
    return None
