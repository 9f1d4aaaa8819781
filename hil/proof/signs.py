"""Signs of functions on a domain: definite, semidefinite with its zeros, positive.

Exact structure first (squares, moduli, factors, sums of nonnegative terms), then enclosures. True means
proven; False means that no proof was found.
"""

import math
from collections.abc import Iterable, Iterator, Mapping

import sympy as sp

from hil.proof import origin, quadratic, tail
from hil.proof.branch_and_bound import Budget, positive, without
from hil.proof.cancellation import factors, half_angles
from hil.proof.interval import Cell, Enclosure, Ranges, outward, unsupported
from hil.proof.system import System

Zeros = tuple[tuple[sp.Expr, ...], ...]
"""Where a nonnegative function may be zero: on one of the branches, where all expressions of the branch are
zero. No branch: nowhere. A branch without expressions: anywhere."""
NOWHERE: Zeros = ()
_ODD = (sp.tanh, sp.atan, sp.sinh)
"""Functions with the sign and the zero of their argument."""
BRANCHES = 12
"""Largest number of branches."""


class Signs:
    """Proves signs of functions on the domain of a system. Mutable: uses up `budget`, caches its results."""

    def __init__(self, system: System, budget: Budget) -> None:
        self.system = system
        self.budget = budget
        self.sides = {x: outward(*side) for x, side in (system.domain | system.ranges).items()}
        self._definite: dict[sp.Expr, bool] = {}
        self._zeros: dict[sp.Expr, Zeros | None] = {}

    def own(self, g: sp.Expr) -> tuple[sp.Symbol, ...]:
        """States of the system that occur in g."""
        return tuple(x for x in self.system.states if x in g.free_symbols)

    def enclosable(self, g: sp.Expr) -> bool:
        """True if interval arithmetic can enclose g: known functions only, and a range for each parameter."""
        return g.free_symbols.isdisjoint(self.system.positive) and not unsupported(g)

    def positive(self, g: sp.Expr) -> bool:
        """Prove that g > 0 on the whole domain, including the equilibrium."""
        if g.is_positive or self._structure(g) == NOWHERE:
            return True
        if not self.enclosable(g):
            return not self.own(g) and self._for_all_positive(g)
        states, ranges = self.own(g), self._ranges(g)
        whole = {v: self.sides[v] for v in (*states, *ranges)}
        if Enclosure(g, tuple(whole)).on(tuple(whole.values())) > 0:
            return True
        outer = self._outer(g, states, ranges)
        return outer is not None and self._covered(g, states, [outer], 3000)

    def sign(self, c: sp.Expr) -> int:
        """Sign of a function c of the parameters for all their values: 1 or -1 if proven, else 0."""
        if c.is_Rational:
            return int(sp.sign(c))
        top, bottom = sp.fraction(sp.factor(c) if c.is_rational_function() else c)
        result = 1
        for base, p in [*factors(top), *factors(bottom)]:
            one = 1 if self.positive(base) else -1 if self.positive(sp.expand(-base)) else 0
            result *= one if p.is_odd else abs(one) if p.is_even else max(one, 0)
        return result

    def _for_all_positive(self, c: sp.Expr) -> bool:
        """Prove by its coefficients that a function of parameters, some without a range, is positive."""
        free = tuple(p for p in self.system.positive if p in c.free_symbols)
        try:
            parts = [p for e in sp.fraction(sp.together(c)) for p in sp.Poly(e, *free).coeffs()]
        except sp.PolynomialError:
            return False
        return all(self.positive(part) for part in parts)

    def definite(self, g: sp.Expr, *, open_ends: bool = False) -> bool:
        """Prove that g = 0 where all states that it depends on are zero, and g > 0 elsewhere.

        `open_ends` excludes the ends of the domain of a single state.
        """
        key = sp.Tuple(g, sp.Integer(open_ends))
        if key not in self._definite:
            self._definite[key] = self._is_definite(g, open_ends)
        return self._definite[key]

    def nonnegative(self, g: sp.Expr) -> Zeros | None:
        """Possible zeros of g if g >= 0 is proven on the whole domain, else None."""
        if g not in self._zeros:
            self._zeros[g] = None
            self._zeros[g] = self._nonnegative(g)
        return self._zeros[g]

    def _is_definite(self, g: sp.Expr, open_ends: bool) -> bool:
        states = self.own(g)
        if not states or sp.expand(g.xreplace(dict.fromkeys(states, sp.S.Zero))) != 0:
            return False
        if (S := quadratic.coefficients(g, states)) is not None:
            if self._definite_form(S, g):
                return True
            if all(c.is_Rational for row in S for c in row):
                return False
        if not self.enclosable(g):
            freed = self.freed(g)
            return freed is not None and self.own(freed) == states and self.definite(freed)
        zeros = self._structure(g)
        if zeros is not None and all(set(states) <= {_root(e) for e in branch} for branch in zeros):
            return True
        ranges = self._ranges(g)
        sides = tuple(self.sides[x] for x in states)
        if all(math.isfinite(end) for side in sides for end in side) and quadratic.convex_definite(
            g, states, sides, ranges, self.budget
        ):
            return True
        near = origin.definite_near(g, states, ranges, self.budget)
        if near is None or (outer := self._outer(g, states, ranges)) is None:
            return False
        if open_ends and len(states) == 1:
            if (trimmed := self._open(g, states[0], outer[0])) is None:
                return False
            outer = (trimmed,)
        return self._covered(g, states, without(outer, near[0]), 10_000)

    def _definite_form(self, S: list[list[sp.Expr]], g: sp.Expr) -> bool:
        """Prove a quadratic form definite: exactly, over ranges, or by leading minors for all parameters."""
        if all(c.is_Rational for row in S for c in row):
            return quadratic.definite(S)
        if self.enclosable(g):
            return quadratic.definite_form(S, self._ranges(g), self.budget)
        return all(self.sign(minor) == 1 for minor in quadratic.leading_minors(S))

    def _ranges(self, g: sp.Expr) -> Ranges:
        return {p: self.sides[p] for p in self.system.ranges if p in g.free_symbols}

    def _outer(self, g: sp.Expr, states: tuple[sp.Symbol, ...], ranges: Ranges) -> Cell | None:
        """Domain, cut to the cell outside of which `tail` proves g > 0; None without such a proof."""
        far = tuple(x for x in states if not all(map(math.isfinite, self.sides[x])))
        sides = {x: self.sides[x] for x in states}
        if far:
            others = {x: sides[x] for x in states if x not in far} | dict(ranges)
            radii = tail.definite_far(g, far, others, self.budget)
            if radii is None:
                return None
            for x, r in zip(far, radii, strict=True):
                low, high = sides[x]
                sides[x] = (max(low, -r), min(high, r))
        return tuple(sides[x] for x in states)

    def _open(self, g: sp.Expr, x: sp.Symbol, side: tuple[float, float]) -> tuple[float, float] | None:
        """Side of x without neighbourhoods of ends where g = 0 and next to which g > 0 is proven; or None."""
        trimmed = list(side)
        for k, end in enumerate(self.system.domain[x]):
            if end.is_infinite or sp.expand(g.subs(x, end)) != 0:
                continue
            inward, moved = 1 - 2 * k, sp.expand_trig(g.subs(x, x + end))
            near = origin.definite_near(moved, (x,), self._ranges(g), self.budget, inward)
            if near is None:
                return None
            kept = end + inward * sp.Rational(near[0][0][1])
            trimmed[k] = outward(kept, kept)[k]
        return trimmed[0], trimmed[1]

    def _covered(self, g: sp.Expr, states: tuple[sp.Symbol, ...], cells: list[Cell], limit: int) -> bool:
        """Prove that g > 0 on cells of its states, for all values of its parameters."""
        ranges = self._ranges(g)
        there = [(*cell, *ranges.values()) for cell in cells]
        return positive([Enclosure(g, (*states, *ranges))], there, self.budget, limit)

    def _nonnegative(self, g: sp.Expr) -> Zeros | None:
        if g == 0:
            return ((),)
        states = self.own(g)
        if states and (S := quadratic.form(g, states)) is not None:
            lines = quadratic.lines(S, states)
            return None if lines is None else (tuple(lines),)
        for judge in (self._structure, self._by_factors):
            for form in (g, *half_angles(g)):
                if (zeros := judge(form)) is not None:
                    return zeros
        if not self.enclosable(g) and (freed := self.freed(g)) is not None:
            return self.nonnegative(freed)
        if states and not g.free_symbols.isdisjoint(self.system.positive) and self.definite(g):
            return (states,)
        return None

    def _structure(self, g: sp.Expr) -> Zeros | None:
        """Zeros of g if its form (even powers, moduli, positive factors, sums) proves g >= 0, else None."""
        if g.is_number or g.is_positive:
            return NOWHERE if g.is_positive else ((),) if g.is_zero else None
        if isinstance(g, sp.Abs):
            return ((g.args[0],),)
        if isinstance(g, sp.exp | sp.cosh):
            return NOWHERE
        if isinstance(g, sp.Pow):
            return self._power(g)
        if isinstance(g, sp.Mul):
            zeros = _union(self._structure(e) for e in g.args)
            signed = sp.Mul(*(e.args[0] if isinstance(e, _ODD) else e for e in g.args))
            return self._structure(signed) if zeros is None and signed != g else zeros
        if isinstance(g, sp.Add):
            return _meet(self._structure(e) for e in g.args)
        return None

    def _power(self, g: sp.Pow) -> Zeros | None:
        base, p = g.args
        if base == sp.E:
            return NOWHERE
        if p.is_Integer and p % 2 == 0:
            return ((base,),) if p > 0 else NOWHERE
        zeros = self._structure(base)
        return zeros if p.is_positive or zeros is None else NOWHERE

    def _by_factors(self, g: sp.Expr) -> Zeros | None:
        """Zeros of a product whose factors, grouped by common states, are definite, positive or squares."""
        groups: list[tuple[set[sp.Symbol], sp.Expr]] = []
        number = sp.S.One
        for base, p in factors(g):
            if base.is_number:
                number *= base**p
                continue
            names, factor = set(self.own(base)), base**p
            if p.is_Integer and p % 2 == 0:
                groups.append((set(), factor))
                continue
            for group in [h for h in groups if h[0] & names]:
                groups.remove(group)
                names, factor = names | group[0], factor * group[1]
            groups.append((names, factor))
        if not number.is_positive:
            first = next((k for k, (names, _) in enumerate(groups) if names), None)
            if first is None or not number.is_negative:
                return None
            names, h = groups[first]
            groups[first] = (names, sp.expand(-h) if h.is_Add else -h)
        return _union(self._factor(h) for _, h in groups)

    def _factor(self, h: sp.Expr) -> Zeros | None:
        if (zeros := self._structure(h)) is not None:
            return zeros
        if sp.expand(h.subs(dict.fromkeys(self.own(h), 0))) == 0:
            if self.definite(h):
                return (self.own(h),)
        elif self.positive(h):
            return NOWHERE
        terms = sp.Add.make_args(sp.expand(h))
        return _meet(self._structure(t) or self._by_factors(t) for t in terms) if len(terms) > 1 else None

    def freed(self, g: sp.Expr) -> sp.Expr | None:
        """Parameter-free function that has the zeros of g >= 0; None if g may be < 0.

        g = sum of p_j T_j(x) with products p_j > 0 of parameters: if all T_j >= 0, g is zero where their sum
        is zero, and unbounded where their sum is.
        """
        top, bottom = sp.fraction(sp.together(g))
        if bottom.free_symbols and self._structure(sp.factor(bottom)) != NOWHERE:
            return None
        parts: dict[sp.Expr, sp.Expr] = {}
        for term in sp.Add.make_args(sp.expand(top)):
            T, p = term.as_independent(*self.system.positive, as_Add=False)
            parts[p] = parts.get(p, sp.S.Zero) + T
        if any(not p.is_positive or self.own(p) or not self.enclosable(T) for p, T in parts.items()):
            return None
        if any(self.nonnegative(T) is None for T in parts.values()):
            return None
        return sp.expand(sum(parts.values(), sp.S.Zero))


def _root(e: sp.Expr) -> sp.Expr:
    """State x of an expression such as x^3 or |x|, which is zero exactly where x is."""
    while isinstance(e, sp.Abs) or (isinstance(e, sp.Pow) and e.exp.is_positive):
        e = e.args[0]
    return e


def _union(parts: Iterable[Zeros | None]) -> Zeros | None:
    """Zeros of a product from the zeros of its factors: one factor is zero."""
    result: Zeros = ()
    for p in parts:
        if p is None:
            return None
        result += p
    return result


def _meet(parts: Iterable[Zeros | None]) -> Zeros | None:
    """Zeros of a sum of nonnegative terms from theirs: all terms are zero."""
    result: Zeros = ((),)
    for p in parts:
        if p is None:
            return None
        result = tuple((*a, *b) for a in result for b in p)
        if len(result) > BRANCHES:
            return None
    return result


def regular(expressions: Mapping[sp.Symbol, sp.Expr], signs: Signs) -> bool:
    """Prove that the expressions are finite and locally Lipschitz on the whole domain.

    Sufficient: no zero in a base with a negative power or a fractional power below one, in the argument of a
    logarithm, or in the cosine under a tangent.
    """
    return all(
        signs.positive(h) or (either and signs.positive(-h)) for h, either in set(_critical(expressions))
    )


def _critical(expressions: Mapping[sp.Symbol, sp.Expr]) -> Iterator[tuple[sp.Expr, bool]]:
    """Yield the expressions that must not be zero, each with True if it may be negative."""
    for e in expressions.values():
        for node in sp.preorder_traversal(e):
            if isinstance(node, sp.log):
                yield node.args[0], False
            elif isinstance(node, sp.tan):
                yield sp.cos(node.args[0]), True
            elif isinstance(node, sp.Pow) and node.free_symbols and node.base != sp.E:
                p = node.exp
                if p.is_Integer:
                    if p.is_negative:
                        yield node.base, True
                elif not (p > 1 and isinstance(node.base, sp.Abs)):
                    yield node.base, False
