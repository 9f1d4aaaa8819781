"""Positive near the origin: a lowest-order form, with a bound on the remainder.

An enclosure of g is never positive on a cell that contains g's zero. So the zero is blown up:
x_i = t^w_i u_i with u on the faces of the unit cube. If all coefficients of t^j, j < k, are exactly zero,
Taylor's theorem gives g(t^w u) = t^k c_k(u, t') with some t' between 0 and t, and c_k is shown positive cell
by cell. c_k is the k-th derivative of the whole g over k!, so that there is one t'. Powers of t at t itself,
next to a derivative at t', would belong to two different points, and cells of t could not be halved.
"""

from collections.abc import Sequence
from contextlib import suppress
from math import lcm

import sympy as sp

from hil.proof.branch_and_bound import Budget, faces, positive
from hil.proof.interval import Cell, Enclosure, Ranges, unsupported

HIGHEST_ORDER = 12
LONGEST = 400
"""Largest number of operations in a derivative that is differentiated again."""
RADII = tuple(2.0**-k for k in range(0, 17, 2))
T = sp.Dummy("t", positive=True)
"""Parameter t > 0 along a ray."""

Weights = tuple[int, ...]


class Ray:
    """g along x_i = t^w_i u_i, as a function of t. Mutable: caches its derivatives."""

    def __init__(self, g: sp.Expr, states: Sequence[sp.Symbol], weights: Weights) -> None:
        self.u = tuple(sp.Dummy(f"u{k}", real=True) for k in range(len(states)))
        there = {x: T**w * u for x, u, w in zip(states, self.u, weights, strict=True)}
        along = _without_t(sp.expand(g.xreplace(there)))
        self.powers: dict[int, sp.Expr] | None = None
        """Coefficients of a polynomial in t, functions of u; None for any other function."""
        with suppress(sp.PolynomialError):
            self.powers = {j: c for (j,), c in sp.Poly(along, T).terms()}
        self._derivatives = [along]
        rough = along.atoms(sp.Abs) | _rough(along)
        self.smooth = self.powers is not None or not any(node.has(T) for node in rough)

    def at_zero(self, j: int) -> sp.Expr:
        """Taylor coefficient of t^j at t = 0, as a function of u."""
        if self.powers is not None:
            return sp.expand(self.powers.get(j, sp.S.Zero))
        return sp.expand(self._derivative(j).subs(T, 0) / sp.factorial(j))

    def order(self) -> int | None:
        """Lowest j with a nonzero coefficient of t^j; None above HIGHEST_ORDER, or if g is not smooth."""
        if not self.smooth:
            return None
        return next((j for j in range(HIGHEST_ORDER + 1) if self.at_zero(j) != 0), None)

    def remainder(self, k: int) -> sp.Expr:
        """c_k(u, t): g = t^k c_k at some t' of [0, t], if the lower coefficients are zero.

        If g is a polynomial in t, the equation holds at t itself.
        """
        if self.powers is not None:
            return sp.Add(*(c * T ** (j - k) for j, c in self.powers.items() if j >= k))
        return self._derivative(k) / sp.factorial(k)

    def _derivative(self, j: int) -> sp.Expr:
        """j-th derivative of g along the ray; nan, which proves nothing, if too long."""
        while len(self._derivatives) <= j:
            last = self._derivatives[-1]
            self._derivatives.append(sp.nan if last.count_ops() > LONGEST else sp.diff(last, T))
        return self._derivatives[j]


def _without_t(e: sp.Expr) -> sp.Expr:
    """Expression with |t^j h(u)| written as t^j |h(u)|, for t > 0."""

    def out(node: sp.Expr) -> sp.Expr:
        coefficient, power = sp.factor_terms(node.args[0]).as_independent(T, as_Add=False)
        positive_power = power.as_base_exp()[0] == T or power == 1
        return sp.Abs(coefficient) * power if positive_power else node

    return sp.expand(e.replace(lambda n: isinstance(n, sp.Abs), out))


def _rough(e: sp.Expr) -> set[sp.Expr]:
    """Roots in an expression that are not proven to be smooth at t = 0."""
    roots = {p for p in e.atoms(sp.Pow) if p.base.has(T) and not p.exp.is_Integer}
    return {p for p in roots if not p.base.subs(T, 0).is_positive}


def weights_of(g: sp.Expr, states: Sequence[sp.Symbol]) -> Weights | None:
    """Weights w_i for which the lowest pure powers of all states in g have the same order in t; or None."""
    orders = []
    for x in states:
        alone = g.subs(dict.fromkeys([y for y in states if y != x], 0))
        order = Ray(alone, (x,), (1,)).order()
        if order is None or order == 0:
            return None
        orders.append(order)
    D = lcm(*orders)
    return tuple(D // e for e in orders) if D <= HIGHEST_ORDER else None


def blown_up(
    g: sp.Expr, states: Sequence[sp.Symbol], weights: Weights, names: Sequence[sp.Symbol]
) -> tuple[Enclosure, Enclosure] | None:
    """Lowest-order form of g in u and `names`, and g divided by its power, in t as well.

    None if g is not shown to be smooth, or has no enclosure.
    """
    ray = Ray(g, states, weights)
    k = ray.order()
    if k is None or unsupported(ray.remainder(k)) or unsupported(ray.at_zero(k)):
        return None
    of_u = (*ray.u, *names)
    return Enclosure(ray.at_zero(k), of_u), Enclosure(ray.remainder(k), (*of_u, T))


def definite_near(
    g: sp.Expr, states: Sequence[sp.Symbol], parameters: Ranges, budget: Budget, side: int = 0
) -> tuple[Cell, Weights] | None:
    """Cell about the origin in which g > 0 except at the origin, or None.

    Parameters have ranges. `side` +1 or -1 restricts g to x > 0 or x < 0 (one state).
    """
    weights = weights_of(g, states)
    if weights is None or (forms := blown_up(g, states, weights, tuple(parameters))) is None:
        return None
    leading, c = forms
    ranges = tuple(parameters.values())
    sides: Cell = ((-1.0, 1.0),) * len(states)
    cells = faces(sides, range(len(states))) if side == 0 else [((float(side), float(side)),)]
    if not positive([leading], [(*u, *ranges) for u in cells], budget, 1500):
        return None
    for radius in RADII:
        if positive([c], [(*u, *ranges, (0.0, radius)) for u in cells], budget, 375):
            return tuple((-(radius**w), radius**w) for w in weights), weights
    return None
