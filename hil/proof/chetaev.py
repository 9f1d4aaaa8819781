"""Instability by Chetaev's theorem: W grows wherever W > 0, arbitrarily near to the equilibrium.

W(0) = 0 and, in a cell about the origin, dW/dt > 0 at every point with W > 0. Both functions are blown up to
a lowest-order form (see origin). On each ray W < 0 or dW/dt > 0 is shown, and W > 0 on at least one ray.
"""

from collections.abc import Iterator
from itertools import combinations, product

import sympy as sp
from flint import arb

from drivers.errors import ModelError
from hil.proof.branch_and_bound import faces, positive
from hil.proof.cancellation import lie_derivative
from hil.proof.interval import ball, unsupported
from hil.proof.origin import RADII, blown_up
from hil.proof.signs import Signs, regular

LIMIT = 400
WEIGHTS = 3
"""Largest weight w_i of the rays x_i = t^w_i u_i."""


def _rays(n: int) -> Iterator[tuple[float, ...]]:
    """Directions of rays: points of a cube; for more than 4 states, at most two coordinates are nonzero."""
    if n <= 4:
        yield from product((-1.0, -0.5, 0.0, 0.5, 1.0), repeat=n)
        return
    for (i, j), (s, t) in product(combinations(range(n), 2), product((-1.0, 0.0, 1.0), repeat=2)):
        yield tuple(s if k == i else t if k == j else 0.0 for k in range(n))


def function(V: sp.Expr | None, signs: Signs) -> sp.Expr | None:
    """W for which Chetaev's theorem proves instability: V, -V or a state; None if it proves nothing."""
    states = signs.system.states
    tried = [] if V is None else [V, -V]
    tried += [s * x for x in states for s in (1, -1)]
    return next((W for W in tried if grows(W, signs)), None)


def grows(W: sp.Expr, signs: Signs) -> bool:
    """True if W is proven to satisfy the conditions of Chetaev's theorem at the origin."""
    states = signs.system.states
    if not set(states) & W.free_symbols or sp.expand(W.subs(dict.fromkeys(states, 0))) != 0:
        return False
    if unsupported(W) or not regular({states[0]: W}, signs):
        return False
    try:
        W_dot = lie_derivative(W, signs.system.f, states)
    except ModelError:
        return False
    if W_dot == 0 or not (signs.enclosable(W) and signs.enclosable(W_dot)):
        return False
    n = len(states)
    weights = product(range(1, WEIGHTS + 1), repeat=n) if n <= 3 else [(1,) * n]
    return any(_along(W, W_dot, w, signs) for w in sorted(weights, key=sum) if 1 in w)


def _along(W: sp.Expr, W_dot: sp.Expr, weights: tuple[int, ...], signs: Signs) -> bool:
    states, budget, names = signs.system.states, signs.budget, tuple(signs.system.ranges)
    ranges = tuple(signs.sides[p] for p in names)
    down, up = blown_up(-W, states, weights, names), blown_up(W_dot, states, weights, names)
    cells = [(*c, *ranges) for c in faces(((-1.0, 1.0),) * len(states), range(len(states)))]
    if down is None or up is None or not positive([down[0], up[0]], cells, budget, LIMIT):
        return False
    for radius in RADII:
        reach = ball(0.0, radius)
        # t is not divided: the two remainders hold for different t' between 0 and t
        there = [lambda x, g=g, t=reach: g([*x, t]) for g in (down[1], up[1])]
        if positive(there, cells, budget, LIMIT):  # W > 0 along a whole ray up to the origin?
            rays = [
                (*((e, e) for e in u), *ranges, (0.0, radius))
                for u in _rays(len(states))
                if 1.0 in map(abs, u)
            ]
            return any(budget.take() and down[1].on(ray) < arb(0) for ray in rays)
    return False
