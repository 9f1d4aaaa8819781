"""LaSalle: no trajectory except the equilibrium stays where dV/dt = 0 (section 6.0, LaSalle's theorem).

A trajectory that stays in a set {h = 0} also has dh/dt = 0, and so on; an equation solved for a state is
substituted into the others. A trajectory may change between branches. The times on each branch are closed
sets that cover an interval, so it stays on one branch for an interval (Baire). There it is shown to be at the
equilibrium; because f is locally Lipschitz, it was there at all times.
"""

import sympy as sp

from drivers.errors import ModelError
from hil.proof.cancellation import cancelled, factors, lie_derivative
from hil.proof.signs import NOWHERE, Signs, Zeros

DERIVATIVES = 8
"""Largest number of equations on one branch."""
LONGEST = 400
"""Largest number of operations in an equation, because derivatives grow."""


def leaves(zeros: Zeros, signs: Signs) -> bool:
    """Prove that every trajectory except the equilibrium leaves the set where dV/dt = 0."""
    return all(_leaves_branch(list(branch), {}, [], signs, DERIVATIVES) for branch in zeros)


def _leaves_branch(
    todo: list[sp.Expr], solved: dict[sp.Symbol, sp.Expr], kept: list[sp.Expr], signs: Signs, left: int
) -> bool:
    """Prove `leaves` for a branch. `solved`: states as functions of the others; `kept`: zero, not solved."""
    if _only_equilibrium(solved, kept, signs):
        return True
    if not todo or left == 0:
        return False
    if (equation := todo[0].subs(solved, simultaneous=True)).count_ops() > LONGEST:
        return False
    h, rest = cancelled(equation), todo[1:]
    if h == 0:
        return _leaves_branch(rest, solved, kept, signs, left)
    for way in _ways(h, signs):
        try:
            now = [*rest, lie_derivative(way, signs.system.f).subs(solved, simultaneous=True)]
        except ModelError:
            return False
        known, zero = solved, [*kept, way]
        if (x := _solvable(way, signs)) is not None:
            value = sp.expand(x - way / sp.expand(way).coeff(x, 1))
            known, zero = {y: sp.expand(e.subs(x, value)) for y, e in solved.items()} | {x: value}, []
            now = [*(k.subs(x, value) for k in kept), *(t.subs(known, simultaneous=True) for t in now)]
        if not _leaves_branch(now, known, zero, signs, left - 1):
            return False
    return True


def _ways(h: sp.Expr, signs: Signs) -> list[sp.Expr]:
    """Expressions of which at least one is zero wherever h = 0; empty if h has no zero."""
    top = sp.fraction(sp.together(h))[0]
    ways = []
    for base, _ in factors(top):
        if base.is_number or signs.positive(base) or signs.positive(sp.expand(-base)):
            continue
        zeros = signs.nonnegative(base)
        if zeros is None:
            zeros = signs.nonnegative(sp.expand(-base))
        if zeros == NOWHERE:
            continue
        one = zeros is not None and len(zeros) == 1 and len(zeros[0]) == 1
        ways.append(zeros[0][0] if zeros is not None and one else base)
    return ways


def _solvable(h: sp.Expr, signs: Signs) -> sp.Symbol | None:
    """State in which h is linear, with a coefficient that is never zero, to eliminate this state; or None."""
    h = sp.expand(h)
    for x in signs.own(h):
        c = h.coeff(x, 1)
        constant = (c.is_positive or c.is_negative) and not signs.own(c)
        if constant and x not in sp.expand(h - c * x).free_symbols:
            return x
    return None


def _only_equilibrium(solved: dict[sp.Symbol, sp.Expr], kept: list[sp.Expr], signs: Signs) -> bool:
    free = [x for x in signs.system.states if x not in solved]
    if not free:
        return all(value == 0 for value in solved.values())
    if not set(free) <= set().union(*(h.free_symbols for h in kept)):
        return False
    at_origin = dict.fromkeys(signs.system.states, 0)
    if any(sp.expand(e.subs(at_origin)) != 0 for e in (*kept, *solved.values())):
        return False
    total = sp.expand(sum((h**2 for h in kept), sp.S.Zero))
    if signs.definite(total, open_ends=len(free) == 1):
        return True
    if len(kept) != 1 or len(free) != 1:
        return False
    return any(signs.definite(sp.expand(sign * free[0] * kept[0])) for sign in (1, -1))
