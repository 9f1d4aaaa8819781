"""Polynomials in parameters that may be any positive numbers, and whether one is positive for all of them.

A polynomial without a negative coefficient is. Otherwise the orthant is halved where two parameters are
equal: x >= y is x = y + x', and in the new variables fewer coefficients are negative (successive
differences; L. Yang, Solving harder problems with lesser mathematics, 2005). All of it is exact.
"""

from __future__ import annotations

from typing import Any

import sympy as sp
from flint import fmpq, fmpq_mpoly_ctx

from hil.proof.branch_and_bound import Budget

DEPTH = 10
LONGEST = 3000
"""Terms beyond which a polynomial is not looked at."""
Polynomial = Any
"""flint.fmpq_mpoly."""


def sign(e: sp.Expr, symbols: tuple[sp.Symbol, ...], budget: Budget, cells: int = 400) -> int:
    """Return 1 if e > 0 wherever all symbols are positive, -1 if e < 0 there, 0 if neither is shown."""
    top, bottom = sp.fraction(sp.together(e))
    signs = [_polynomial(part, symbols, budget, cells) for part in (top, bottom)]
    return signs[0] * signs[1]


def _polynomial(e: sp.Expr, symbols: tuple[sp.Symbol, ...], budget: Budget, cells: int) -> int:
    try:
        terms = sp.Poly(e, *symbols, domain="QQ").terms()
    except (sp.PolynomialError, sp.CoercionFailed):
        return 0
    if not any(c for _, c in terms) or len(terms) > LONGEST:
        return 0
    context = fmpq_mpoly_ctx.get(tuple(f"x{k}" for k in range(len(symbols) + 1)), "lex")
    p = context.from_dict({(*m, 0): fmpq(int(c.p), int(c.q)) for m, c in terms})
    constant, parts = p.factor() if len(terms) > 1 else (fmpq(1), [(p, 1)])
    result = 1 if constant > 0 else -1 if constant < 0 else 0
    for part, power in parts:
        one = _factor(part, context, budget, cells)
        result *= one if power % 2 else abs(one)
    return result


def _factor(p: Polynomial, context: Any, budget: Budget, cells: int) -> int:
    if p.total_degree() == 0:
        c = p.leading_coefficient()
        return 1 if c > 0 else -1 if c < 0 else 0
    degrees = {sum(m) for m in p.monoms()}
    top = max(degrees)
    if len(degrees) > 1:  # the number 1 is one more positive number
        p = context.from_dict(
            {(*m[:-1], top - sum(m)): c for m, c in zip(p.monoms(), p.coeffs(), strict=True)}
        )
    left = [cells]
    there = sum(p.coeffs(), fmpq(0))
    if there == 0:
        return 0
    s = 1 if there > 0 else -1
    return s if _positive(s * p, context, DEPTH, left, budget) else 0


def _positive(p: Polynomial, context: Any, depth: int, left: list[int], budget: Budget) -> bool:
    coefficients = p.coeffs()
    if not coefficients:
        return False
    if all(c > 0 for c in coefficients):
        return True
    if sum(coefficients, fmpq(0)) <= 0 or depth == 0 or len(coefficients) > LONGEST:
        return False
    left[0] -= 1
    if left[0] < 0 or not budget.take():
        return False
    gens = context.gens()
    used = [k for k in range(len(gens)) if any(m[k] for m in p.monoms())]
    best: tuple[fmpq, list[Polynomial]] | None = None
    for n, i in enumerate(used):
        for j in used[n + 1 :]:
            halves = [_put(p, gens, context, a, gens[i] + gens[j]) for a in (i, j)]
            negative = sum((c for h in halves for c in h.coeffs() if c < 0), fmpq(0))
            if best is None or negative > best[0]:
                best = (negative, [*halves, _put(p, gens, context, i, gens[j])])
    return best is not None and all(_positive(h, context, depth - 1, left, budget) for h in best[1])


def _put(p: Polynomial, gens: Any, context: Any, k: int, value: Polynomial) -> Polynomial:
    return p.compose(*(value if n == k else g for n, g in enumerate(gens)), ctx=context)
