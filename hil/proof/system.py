"""The problem of the verifier in exact form: dx/dt = f(x) about an equilibrium, V, domain, parameters.

This module only rejects invalid input. States become real symbols, parameters without a range
positive ones, and the equilibrium the origin (the change of variable of section 6.0.1, note 1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import sympy as sp

from drivers.errors import ModelError
from hil.proof.cancellation import continuous
from hil.proof.expressions import Rounded, around, exact, read
from hil.proof.interval import ALLOWED, FUNCTIONS, number, unsupported

Interval = tuple[sp.Expr, sp.Expr]
Point = dict[sp.Symbol, sp.Expr]


@dataclass(frozen=True)
class System:
    """dx/dt = f(x) with f(0) = 0: the equilibrium is the origin."""

    states: tuple[sp.Symbol, ...]
    f: dict[sp.Symbol, sp.Expr]
    domain: dict[sp.Symbol, Interval]
    """Range of each state relative to the equilibrium; -oo and oo for the whole space."""
    ranges: dict[sp.Symbol, Interval]
    """Parameters with a given range, and decimal numbers that may have been rounded."""
    positive: tuple[sp.Symbol, ...]
    """Parameters that stand for all positive values."""
    equilibrium: Point
    """Equilibrium in the user's coordinates."""
    renamed: dict[sp.Symbol, sp.Expr]
    """User's symbol -> expression in the symbols of this system."""
    own: dict[sp.Symbol, sp.Symbol]
    """Symbol of this system -> user's symbol."""
    rounded: Rounded = field(default_factory=Rounded)
    """Decimal numbers with so many digits that they count as rounded."""

    @property
    def bounded(self) -> bool:
        """True if every side of the domain is finite."""
        return not any(end in {sp.oo, -sp.oo} for side in self.domain.values() for end in side)

    @property
    def parameters(self) -> dict[sp.Symbol, Interval]:
        """Ranges of the parameters, in the user's symbols; (0, oo) without a range."""
        sides = dict.fromkeys(self.positive, (sp.S.Zero, sp.oo)) | self.ranges
        return {self.own[p]: side for p, side in sides.items() if p not in self.rounded.numbers}

    def read(self, expression: Any) -> sp.Expr:
        """Convert a user's expression to the symbols of this system.

        Raises ModelError for a part without an enclosure, or an unknown symbol.
        """
        e = self.rounded.apart(read(expression, "V"))
        wrong = sorted(str(s) for s in e.free_symbols - set(self.renamed) - set(self.rounded.numbers))
        if wrong:
            raise ModelError(
                f"{expression} contains {', '.join(wrong)}, which is neither a state nor a parameter"
            )
        return e.xreplace(self.renamed)

    def in_own_symbols(self, point: Point) -> Point:
        """Point of this system in the user's symbols and coordinates."""
        moved = {x: point[x] + self.equilibrium[self.own[x]] for x in self.states}
        return {self.own[s]: value for s, value in (point | moved).items() if s in self.own}

    def shown(self, expression: sp.Expr) -> sp.Expr:
        """Expression of this system in the user's symbols and coordinates."""
        if not any(self.equilibrium.values()):
            return expression.xreplace(self.own | self.rounded.shown)
        there = {x: self.own[x] - self.equilibrium[self.own[x]] for x in self.states}
        return expression.subs(there, simultaneous=True).xreplace(self.own | self.rounded.shown)

    def scaled(self, share: float) -> System:
        """Same system on a smaller domain: each side times `share`; an infinite end becomes `share`."""
        s = sp.Rational(share)
        sides = {
            x: (-s if low == -sp.oo else low * s, s if high == sp.oo else high * s)
            for x, (low, high) in self.domain.items()
        }
        return replace(self, domain=sides)


def make_system(
    f: Mapping[sp.Symbol, Any], V: Any, at: Mapping[sp.Symbol, Any] | None,
    box: Mapping[sp.Symbol, tuple[Any, Any]] | None, parameters: Mapping[sp.Symbol, tuple[Any, Any]] | None,
) -> System:  # fmt: skip
    """System in exact form, from a user's input to `verify`.

    Raises ModelError if `at` is no equilibrium or outside the box; if f is discontinuous or has a part
    without an enclosure; if an option contains an unknown symbol; or if a symbol has a stronger assumption
    than the claim.
    """
    try:
        f, at, box, parameters = (dict(each or {}) for each in (f, at, box, parameters))
    except (TypeError, ValueError):
        raise ModelError("f, at, box and parameters must be mappings from symbols to values") from None
    if not f:
        raise ModelError("f has no state: it must map each state to its time derivative")
    states_named = f"which is not a state: the states are {', '.join(map(str, f))}"
    _refuse(  # a name that is not understood would change the question unseen
        ([x for x in (*f, *parameters) if type(x) not in (sp.Symbol, sp.Dummy)], "{} is not a SymPy symbol"),
        (at.keys() - f.keys(), f"`at` contains {{}}, {states_named}"),
        (box.keys() - f.keys(), f"`box` contains {{}}, {states_named}"),
        (parameters.keys() & f.keys(), "`parameters` contains {}, which is a state: give its range in `box`"),
    )
    ranges = {p: _interval(p, side) for p, side in parameters.items()}
    rounded = Rounded()
    f = {x: rounded.apart(read(e, f"d{x}/dt")) for x, e in f.items()}
    of_V = rounded.apart(read(0 if V is None else V, "V")).free_symbols
    everything = set().union(*(e.free_symbols for e in f.values()), of_V) - set(rounded.numbers)
    free = sorted(everything - set(f) - set(ranges), key=str)
    positive = [*free, *(p for p, (low, _) in ranges.items() if low > 0)]
    named = [str(s) for s in (*f, *ranges, *free)]
    _refuse(
        (
            [p for p, (low, high) in ranges.items() if low.is_infinite or high.is_infinite],
            "the range of {} has no end: omit it to mean all positive numbers",
        ),
        (
            [s for s in free if str(s) == "t"],
            "f or V depends on {}, the time: a constant needs a range in `parameters`",
        ),
        (set(ranges) - everything, "`parameters` contains {}, which neither f nor V contains"),
        (
            [s for s in (*f, *ranges, *free) if not _assumed(s, "positive" if s in positive else "real")],
            "{} has a SymPy assumption stronger than the claim: declare the symbol without it",
        ),
        ({n for n in named if named.count(n) > 1}, "two symbols have the name {}: use different names"),
    )
    renamed: dict[sp.Symbol, sp.Expr] = {x: sp.Symbol(str(x), real=True) for x in f}
    for p, (low, high) in (ranges | dict.fromkeys(free, (1, 1))).items():
        renamed[p] = sp.Symbol(
            str(p), **{"positive" if low > 0 else "negative" if high < 0 else "real": True}
        )
    own = {new: old for old, new in renamed.items()}
    states = tuple(renamed[x] for x in f)
    centre = {x: exact(read(at.get(x, 0), f"`at` of {x}")) for x in f}
    for x, value in centre.items():
        _refuse((value.free_symbols - {*free, *ranges}, f"`at` sets {x} = {value}: {{}} is not a parameter"))
    equilibrium = {x: value.xreplace(renamed) for x, value in centre.items()}
    shifted = renamed | {x: renamed[x] + equilibrium[x] for x in f}
    rates = {renamed[x]: _field(x, e, shifted) for x, e in f.items()}
    where = ", ".join(f"{s} = {v}" for s, v in equilibrium.items())
    for x, e in rates.items():
        if (value := sp.simplify(e.xreplace(dict.fromkeys(states, sp.S.Zero)))) != 0:
            raise ModelError(
                f"{where} is not shown to be an equilibrium: d{x}/dt = {value}; give a zero of f in `at`"
            )
    domain = {renamed[x]: _about(x, box.get(x), equilibrium[x]) for x in f}
    ranged = {renamed[p]: side for p, side in ranges.items()}
    ranged |= {p: around(c) for p, c in rounded.numbers.items()}
    free_renamed = tuple(renamed[p] for p in free)
    return System(states, rates, domain, ranged, free_renamed, equilibrium, shifted, own, rounded)


def _refuse(*checks: tuple[Iterable[Any], str]) -> None:
    """Raise ModelError with the first message whose iterable is not empty, and the names in it."""
    for wrong, message in checks:
        if names := sorted(map(str, wrong)):
            raise ModelError(message.replace("{}", ", ".join(names), 1))


def _assumed(s: sp.Symbol, meant: str) -> bool:
    """True if SymPy assumes no more about a symbol than `meant`, such as `real`."""
    return bool(s.assumptions0.items() <= sp.Symbol("s", **{meant: True}).assumptions0.items())


def _field(x: sp.Symbol, e: sp.Expr, shifted: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    """Rate dx/dt about the equilibrium; ModelError if it is not continuous or has no enclosure."""
    enclosed = f"d{x}/dt contains {{}}, allowed: {ALLOWED}"
    _refuse(({a for a in e.atoms(sp.Function) if a.func not in FUNCTIONS | {sp.sign}}, enclosed))
    try:
        smooth = continuous(sp.expand(e.xreplace(shifted)) if e.has(sp.sign) else e.xreplace(shifted))
    except ModelError as error:
        raise ModelError(f"d{x}/dt must be continuous: {error}") from None
    _refuse((unsupported(smooth), enclosed))
    return smooth


def _interval(x: sp.Symbol, side: tuple[Any, Any]) -> Interval:
    if not isinstance(side, tuple | list) or len(side) != 2:
        raise ModelError(f"the range of {x} is {side!r}: give two numbers, the lower first")
    low, high = (exact(read(end, f"an end of the range of {x}", infinite=True)) for end in side)
    ordered = all(end.is_number and end.is_extended_real for end in (low, high))
    if not ordered or not (low < high):
        raise ModelError(f"the range of {x} is [{low}, {high}]: give two numbers, the lower first")
    return low, high


def _about(x: sp.Symbol, side: tuple[Any, Any] | None, centre: sp.Expr) -> Interval:
    if side is None:
        return -sp.oo, sp.oo
    low, high = _interval(x, side)
    if centre.free_symbols:
        raise ModelError(
            f"the equilibrium {x} = {centre} depends on a parameter: with a range of {x} in `box`, it must "
            "be a number"
        )
    around = tuple(end if end.is_infinite else sp.expand(end - centre) for end in (low, high))
    if not all(e.is_infinite or sign * number(e) > 0 for sign, e in zip((-1, 1), around, strict=True)):
        raise ModelError(
            f"the equilibrium {x} = {centre} is not inside its box [{low}, {high}]: give a wider one"
        )
    return around
