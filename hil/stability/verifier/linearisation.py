"""The linearisation at the equilibrium: eigenvalues located, not computed.

A characteristic polynomial of fractions has its roots enclosed by flint; one with parameters has Routh's
table, whose entries must have a proven sign. A root on the imaginary axis says nothing.
"""

from enum import Enum
from typing import Any

import sympy as sp
from flint import arb, fmpq, fmpq_poly

from drivers.errors import ModelError
from hil.stability.verifier.cancellation import continuous
from hil.stability.verifier.interval import number, unsupported
from hil.stability.verifier.signs import Signs
from hil.stability.verifier.system import System


class Eigenvalues(Enum):
    """Where the eigenvalues of the linearisation are shown to be."""

    LEFT = "every eigenvalue has a negative real part"
    RIGHT = "an eigenvalue has a positive real part"
    UNKNOWN = "nothing is shown"


def jacobian(system: System) -> sp.Matrix | None:
    """Return A = df/dx at the equilibrium; None where f is not shown to be smooth there."""
    origin = dict.fromkeys(system.states, 0)
    try:
        entries = [[continuous(sp.diff(e, x)).subs(origin) for x in system.states] for e in system.f.values()]
    except ModelError:
        return None
    A = sp.Matrix(entries).applyfunc(sp.expand)
    return None if any(unsupported(a) for a in A) else A


def eigenvalues(A: sp.Matrix, signs: Signs) -> Eigenvalues:
    """Return where the eigenvalues of A are."""
    s = sp.Symbol("s")
    polynomial = A.charpoly(s).as_expr()
    coefficients = [sp.expand(c) for c in sp.Poly(polynomial, s).all_coeffs()]
    if all(c.is_Rational for c in coefficients):
        return _roots(coefficients)
    return _routh(coefficients, signs)


def _roots(coefficients: list[sp.Expr]) -> Eigenvalues:
    p = fmpq_poly([fmpq(int(c.p), int(c.q)) for c in reversed(coefficients)])
    roots: list[tuple[Any, int]] = p.numer().complex_roots()  # type: ignore[assignment]  # (root, multiplicity)
    real_parts = [root.real for root, _ in roots]
    if any(re > 0 for re in real_parts):
        return Eigenvalues.RIGHT
    return Eigenvalues.LEFT if all(re < 0 for re in real_parts) else Eigenvalues.UNKNOWN


def _routh(coefficients: list[sp.Expr], signs: Signs) -> Eigenvalues:
    """First column of Routh's table: as many roots to the right as changes of sign."""
    if any(_sign(c, signs) == -1 for c in coefficients):
        return Eigenvalues.RIGHT  # roots all with Re <= 0 have coefficients of one sign
    upper, lower = coefficients[0::2], coefficients[1::2]
    column = [1]
    while lower:
        sign = _sign(lower[0], signs)
        if sign == 0:
            return Eigenvalues.UNKNOWN
        column.append(sign)
        pad = [*lower, sp.S.Zero]
        below = [
            sp.cancel((lower[0] * upper[k + 1] - upper[0] * pad[k + 1]) / lower[0])
            for k in range(len(upper) - 1)
        ]
        upper, lower = lower, below
    return Eigenvalues.RIGHT if -1 in column else Eigenvalues.LEFT


def _sign(c: sp.Expr, signs: Signs) -> int:
    """1, -1, or 0 where none is shown."""
    if c == 0:
        return 0
    if not c.free_symbols:
        value = number(c)
        return 1 if value > 0 else -1 if value < arb(0) else 0
    return 1 if _shown(c, signs) else -1 if _shown(sp.expand(-c), signs) else 0


def _shown(c: sp.Expr, signs: Signs) -> bool:
    return bool(c.is_positive) or signs.positive(c) or signs.positive(sp.factor(c))
