"""Exact algebra before interval arithmetic: cancellation in the derivative of V.

Every step is an identity of real functions wherever f and V are defined. Enclosures cannot show that
b v - v b is zero; algebra can.
"""

from collections.abc import Mapping, Sequence

import sympy as sp

from drivers.errors import ModelError


def cancelled(expression: sp.Expr) -> sp.Expr:
    """Simplified expression: common factors and opposite terms cancelled, cos^2 replaced by 1 - sin^2."""
    e = sp.expand(expression)
    try:
        e = sp.cancel(sp.together(e)) if not e.is_polynomial(*e.free_symbols) else e
    except sp.PolynomialError:
        return e
    top, bottom = sp.fraction(sp.together(e))
    top = sp.expand(_pythagoras(sp.expand(top)))
    return sp.expand(top / bottom) if bottom.is_number else top / bottom


def _pythagoras(e: sp.Expr) -> sp.Expr:
    """Expression with cos^2 u replaced by 1 - sin^2 u wherever it contains both functions of u."""
    both = {c.args[0] for c in e.atoms(sp.cos)} & {s.args[0] for s in e.atoms(sp.sin)}
    for u in both:
        s, c = sp.sin(u), sp.cos(u)
        e = e.replace(
            lambda p, c=c: isinstance(p, sp.Pow) and p.base == c and p.exp.is_Integer and p.exp > 1,
            lambda p, s=s, c=c: (1 - s**2) ** (p.exp // 2) * c ** (p.exp % 2),
        )
    return e


def continuous(expression: sp.Expr) -> sp.Expr:
    """Expression without sign(): u sign(u) = |u|, u sign(u)^2 = u.

    The derivative of |u| is valid away from u = 0. If the result is continuous, it is also valid at u = 0,
    and the function before differentiation is continuously differentiable.

    Raises ModelError if a discontinuity remains.
    """
    e = expression
    for _ in range(8):
        signs = sorted(e.atoms(sp.sign), key=sp.default_sort_key)
        if not signs:
            return e
        e = _without(signs[0], e)
    raise ModelError(f"{expression} is not shown to be continuous")


def _without(sign: sp.Expr, expression: sp.Expr) -> sp.Expr:
    u, s = sign.args[0], sp.Dummy("s", real=True)
    e = expression.xreplace({sign: s})
    inner = {p for p in e.atoms(sp.Pow) if not p.exp.is_Integer and p.has(sp.Abs(u))}
    if not inner:
        e = e.xreplace({sp.Abs(u): u * s})
    try:
        terms = sp.Poly(sp.expand(e), s)
    except sp.PolynomialError:
        raise ModelError(f"{expression} is not shown to be continuous at {u} = 0") from None
    odd, even = (sum((c for (n,), c in terms.terms() if n and n % 2 == k), sp.S.Zero) for k in (1, 0))
    quotients = [sp.cancel(sp.together(part) / u) for part in (odd, even)]
    if any(not sp.denom(sp.together(q)).free_symbols.isdisjoint(u.free_symbols) for q in quotients):
        raise ModelError(f"{expression} jumps at {u} = 0, or is not shown to be continuous there")
    return terms.nth(0) + even + quotients[0] * sp.Abs(u)


def lie_derivative(
    h: sp.Expr, field: Mapping[sp.Symbol, sp.Expr], states: Sequence[sp.Symbol] | None = None
) -> sp.Expr:
    """dh/dt = grad h . f along the trajectories, simplified (section 6.0.5).

    Raises ModelError if h is not shown to be continuously differentiable.
    """
    states = tuple(field) if states is None else states
    gradient = {x: continuous(sp.diff(h, x)) for x in states}
    return cancelled(continuous(sp.expand(sum((gradient[x] * field[x] for x in states), sp.S.Zero))))


def factors(expression: sp.Expr) -> list[tuple[sp.Expr, sp.Rational]]:
    """Factors of a product with their powers; factors of the denominator have negative powers."""
    try:
        e = sp.factor(sp.together(expression))
    except sp.PolynomialError:
        e = sp.together(expression)
    return [part.as_base_exp() for part in sp.Mul.make_args(e)]


def half_angles(expression: sp.Expr) -> list[sp.Expr]:
    """Rewrite cos u as 1 - 2 sin^2(u/2) and as 2 cos^2(u/2) - 1; empty without cosines.

    In these forms 1 - cos u and 1 + cos u become squares.
    """
    if not expression.has(sp.cos):
        return []
    down = sp.expand(expression.replace(sp.cos, lambda u: 1 - 2 * sp.sin(u / 2) ** 2))
    up = sp.expand(expression.replace(sp.cos, lambda u: 2 * sp.cos(u / 2) ** 2 - 1))
    return [down, up]
