"""Eigenvalues of the linearisation at the equilibrium.

The matrix is first divided into strongly connected blocks of states. A block of fractions is decided exactly:
the part of its characteristic polynomial that is symmetric about the imaginary axis is divided out, and
Routh's table over the rationals decides the rest. Over ranges of parameters the theorem of Ostrowski and
Schneider applies: if A^T P + P A < 0, A has as many eigenvalues in the right half plane as P has negative
ones. For parameters without a range polynomials in them decide. A root on the imaginary axis decides nothing.

For a system without a V the module proposes x^T P x with A^T P + P A = -1. This V is a guess, to be proven
for the full f. Ranges of parameters are represented by their middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any

import numpy as np
import sympy as sp
from flint import arb_mat, fmpq, fmpq_mat, fmpq_poly
from scipy.linalg import solve_sylvester

from drivers.errors import ModelError
from hil.proof import quadratic
from hil.proof.branch_and_bound import Budget, covered
from hil.proof.cancellation import continuous
from hil.proof.interval import Ball, Ranges, unsupported
from hil.proof.signs import Signs, regular
from hil.proof.system import System

CELLS = 300


class Eigenvalues(Enum):
    """Proven location of the eigenvalues of the linearisation."""

    LEFT = "every eigenvalue has a negative real part"
    RIGHT = "an eigenvalue has a positive real part"
    UNKNOWN = "nothing is shown"


def of_rationals(A: sp.Matrix) -> Eigenvalues:
    """Location of a rational matrix' eigenvalues; UNKNOWN: some on the imaginary axis, none right of it."""
    p = fmpq_mat([[fmpq(int(a.p), int(a.q)) for a in A.row(i)] for i in range(A.rows)]).charpoly()
    mirrored = fmpq_poly([c if k % 2 == 0 else -c for k, c in enumerate(p.coeffs())])
    symmetric = p.gcd(mirrored)
    squares = fmpq_poly(symmetric.coeffs()[symmetric.degree() % 2 :: 2])  # of s^2: on the axis s^2 <= 0
    roots: Any = squares.complex_roots()
    off = any(not s2.imag.is_zero() or s2.real > 0 for s2, _ in roots)
    if off or not _routh((p / symmetric).coeffs()):
        return Eigenvalues.RIGHT
    return Eigenvalues.UNKNOWN if symmetric.degree() > 0 else Eigenvalues.LEFT


def _routh(rising: Sequence[fmpq]) -> bool:
    """Prove by Routh's first column that all roots of a monic polynomial have a negative real part."""
    upper, lower = rising[::-1][0::2], rising[::-1][1::2]
    while lower:
        if lower[0] <= 0:
            return False
        pad, ratio = [*lower, fmpq(0)], upper[0] / lower[0]
        upper, lower = lower, [upper[k + 1] - ratio * pad[k + 1] for k in range(len(upper) - 1)]
    return True


def over_ranges(A: sp.Matrix, ranges: Ranges, budget: Budget) -> Eigenvalues:
    """Location of the eigenvalues of A for all values of its parameters; UNKNOWN if it is not one for all."""
    entries = quadratic.enclosures(A.tolist(), tuple(ranges))
    found: set[Eigenvalues] = set()

    def shown(p: Sequence[Ball]) -> bool:
        here = _of_balls(entries(p))
        found.update({here} - {Eigenvalues.UNKNOWN})
        return here is not Eigenvalues.UNKNOWN and len(found) == 1

    everywhere = covered([tuple(ranges.values())], shown, budget, CELLS, lambda _: len(found) > 1)
    return found.pop() if everywhere else Eigenvalues.UNKNOWN


def _of_balls(A: Sequence[Sequence[Ball]]) -> Eigenvalues:
    """Proven location of the eigenvalues of every matrix within A, whose entries are balls."""
    middle = quadratic.middle_of(A)
    if middle is None:
        return Eigenvalues.UNKNOWN
    right = float(np.linalg.eigvals(middle).real.max())
    for shift in (0.0,) if right <= 0 else (0.0, 0.5 * right, 0.7 * right, 0.3 * right):
        moved = shift * np.eye(len(A))
        P = lyapunov_matrix(middle - moved)
        if P is None or quadratic.definite([[sp.Rational(float(v)) for v in row] for row in P]) != (
            right < 0
        ):
            continue
        PB = arb_mat(P.tolist()) * (arb_mat(A) - arb_mat(moved.tolist()))
        if quadratic.positive_definite((-(PB + PB.transpose())).tolist()):
            return Eigenvalues.LEFT if right < 0 else Eigenvalues.RIGHT
    return Eigenvalues.UNKNOWN


def lyapunov_matrix(A: np.ndarray) -> np.ndarray | None:
    """Symmetric P with A^T P + P A = -1 in floating point, a guess to be proven; or None."""
    P = solve_sylvester(A.T, A, -np.eye(len(A)))
    return (P + P.T) / 2 if np.isfinite(P).all() else None


def jacobian(system: System) -> sp.Matrix | None:
    """Matrix A = df/dx at the equilibrium; None if f is not shown to be smooth there."""
    origin = dict.fromkeys(system.states, sp.S.Zero)
    try:
        entries = [
            [continuous(sp.diff(e, x)).xreplace(origin) for x in system.states] for e in system.f.values()
        ]
    except ModelError:
        return None
    A = sp.Matrix(entries).applyfunc(sp.expand)
    return None if any(unsupported(a) for a in A) else A


def eigenvalues(signs: Signs) -> Eigenvalues:
    """Location of the eigenvalues of the linearisation; UNKNOWN if f is not shown to be smooth."""
    A = jacobian(signs.system)
    if A is None or not regular(signs.system.f, signs):
        return Eigenvalues.UNKNOWN
    found = [_block(A.extract(block, block), signs) for block in A.strongly_connected_components()]
    if Eigenvalues.RIGHT in found:
        return Eigenvalues.RIGHT
    return Eigenvalues.UNKNOWN if Eigenvalues.UNKNOWN in found else Eigenvalues.LEFT


def _block(A: sp.Matrix, signs: Signs) -> Eigenvalues:
    if all(a.is_Rational for a in A):
        return of_rationals(A)
    if A.free_symbols.isdisjoint(signs.system.positive):
        ranges = {p: signs.sides[p] for p in signs.system.ranges if p in A.free_symbols}
        found = over_ranges(A, ranges, signs.budget)
        if found is not Eigenvalues.UNKNOWN:
            return found
    return _for_all(A, signs)


def _for_all(A: sp.Matrix, signs: Signs) -> Eigenvalues:
    """Location for all parameters, by the critical constraints.

    An eigenvalue crosses the axis only where a_0 or the last but one Hurwitz determinant is zero. If
    neither is ever zero, one choice of the parameters represents all.
    """
    n = A.rows
    a = [sp.together(c) for c in A.charpoly(sp.Dummy("eigenvalue")).all_coeffs()]
    shown = [signs.sign(c) for c in a]
    if -1 in shown:
        return Eigenvalues.RIGHT  # roots all with Re <= 0 have coefficients of one sign
    hurwitz = sp.Matrix(n - 1, n - 1, lambda i, j: a[2 * j - i + 1] if 0 <= 2 * j - i + 1 <= n else sp.S.Zero)
    if shown[-1] == 0 or signs.sign(sp.together(hurwitz.det(method="berkowitz"))) == 0:
        return Eigenvalues.UNKNOWN
    point = {p: (low + high) / 2 for p, (low, high) in signs.system.ranges.items()}
    there = A.subs(point | dict.fromkeys(signs.system.positive, sp.S.One)).applyfunc(sp.expand)
    return of_rationals(there) if all(c.is_Rational for c in there) else over_ranges(there, {}, signs.budget)


EXACT = 4
"""Largest number of states for an exact solution; above, the solution is rounded and verified."""
SYMBOLIC = 3
"""Largest number of states for a solution with parameters without a range."""


def lyapunov_function(system: System) -> sp.Expr | None:
    """Candidate V = x^T P x, A^T P + P A = -1 for the linearisation A; None if there is no such P."""
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
        if all(quadratic.definite(S.tolist()) for S in (R, -(A.T * R + R * A))):
            return R
    return None
