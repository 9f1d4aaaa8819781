"""The linearisation at the equilibrium: eigenvalues located, not computed.

States that do not act on each other in a circle are taken apart first. A matrix of fractions is decided
exactly, one with ranges of parameters cell by cell, one with parameters that may be any positive number by
polynomials of them. A root on the imaginary axis says nothing.
"""

import sympy as sp

from drivers.errors import ModelError
from hil.proof.cancellation import continuous
from hil.proof.eigenvalues import Eigenvalues, of_rationals, over_ranges
from hil.proof.interval import unsupported
from hil.proof.signs import Signs
from hil.proof.system import System

__all__ = ["Eigenvalues", "eigenvalues", "jacobian"]


def jacobian(system: System) -> sp.Matrix | None:
    """Return A = df/dx at the equilibrium; None where f is not shown to be smooth there."""
    origin = dict.fromkeys(system.states, sp.S.Zero)
    try:
        entries = [
            [continuous(sp.diff(e, x)).xreplace(origin) for x in system.states] for e in system.f.values()
        ]
    except ModelError:
        return None
    A = sp.Matrix(entries).applyfunc(sp.expand)
    return None if any(unsupported(a) for a in A) else A


def eigenvalues(A: sp.Matrix, signs: Signs) -> Eigenvalues:
    """Return where the eigenvalues of A are."""
    found = [_block(A.extract(block, block), signs) for block in _circles(A)]
    if Eigenvalues.RIGHT in found:
        return Eigenvalues.RIGHT
    return Eigenvalues.UNKNOWN if Eigenvalues.UNKNOWN in found else Eigenvalues.LEFT


def _circles(A: sp.Matrix) -> list[list[int]]:
    """Return the sets of states that act on each other: A is block triangular in them."""
    n = A.rows
    acts = [[i == j or A[i, j] != 0 for j in range(n)] for i in range(n)]
    for k in range(n):
        for i in range(n):
            for j in range(n):
                acts[i][j] = acts[i][j] or (acts[i][k] and acts[k][j])
    blocks = {tuple(j for j in range(n) if acts[i][j] and acts[j][i]) for i in range(n)}
    return [list(b) for b in sorted(blocks)]


def _block(A: sp.Matrix, signs: Signs) -> Eigenvalues:
    if all(a.is_Rational for a in A):
        return of_rationals(A)
    if A.free_symbols.isdisjoint(signs.system.positive):
        ranges = [(p, signs.sides[p]) for p in signs.system.ranges if p in A.free_symbols]
        found = over_ranges(A, ranges, signs.budget)
        if found is not Eigenvalues.UNKNOWN:
            return found
    return _for_all(A, signs)


def _for_all(A: sp.Matrix, signs: Signs) -> Eigenvalues:
    """Judge by the critical constraints.

    An eigenvalue crosses the axis only where a_0 or the last but one of Hurwitz's determinants is zero. Where
    neither ever is, one choice of the parameters stands for all.
    """
    n = A.rows
    variable = sp.Dummy("eigenvalue")
    coefficients = [sp.together(c) for c in A.charpoly(variable).all_coeffs()]
    shown = [signs.sign(c) for c in coefficients]
    if -1 in shown:
        return Eigenvalues.RIGHT  # roots all with Re <= 0 have coefficients of one sign
    if shown[-1] == 0 or (n > 1 and signs.sign(_hurwitz(coefficients, n - 1)) == 0):
        return Eigenvalues.UNKNOWN
    return _at_one_point(A, signs)


def _hurwitz(coefficients: list[sp.Expr], k: int) -> sp.Expr:
    """Return the k-th of Hurwitz's determinants."""
    n = len(coefficients) - 1
    entry = [
        [coefficients[2 * j - i + 1] if 0 <= 2 * j - i + 1 <= n else sp.S.Zero for j in range(k)]
        for i in range(k)
    ]
    return sp.together(sp.Matrix(entry).det(method="berkowitz"))


def _at_one_point(A: sp.Matrix, signs: Signs) -> Eigenvalues:
    point = {p: (low + high) / 2 for p, (low, high) in signs.system.ranges.items()}
    there = A.subs(point | dict.fromkeys(signs.system.positive, sp.S.One)).applyfunc(sp.expand)
    return of_rationals(there) if all(a.is_Rational for a in there) else over_ranges(there, [], signs.budget)
