"""The question in exact form: dx/dt = f(x) about an equilibrium, V, where, and for which parameters.

Nothing is decided here but what has no meaning. States become real symbols, parameters without a range
positive ones, the equilibrium the origin (the change of variable of section 6.0.1, note 1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import sympy as sp

from drivers.errors import ModelError
from hil.proof.cancellation import continuous
from hil.proof.door import Rounded, around, exact, read
from hil.proof.interval import FUNCTIONS, number, unsupported

Interval = tuple[sp.Expr, sp.Expr]
Point = dict[sp.Symbol, sp.Expr]


@dataclass(frozen=True)
class System:
    """dx/dt = f(x) with f(0) = 0: the equilibrium is the origin."""

    states: tuple[sp.Symbol, ...]
    f: dict[sp.Symbol, sp.Expr]
    domain: dict[sp.Symbol, Interval]
    """About the equilibrium; -oo and oo where the whole space is meant."""
    ranges: dict[sp.Symbol, Interval]
    """Parameters of which a range was named, and decimal numbers that may have been rounded."""
    positive: tuple[sp.Symbol, ...]
    """Parameters of which all positive values are meant."""
    equilibrium: Point
    """In the user's coordinates."""
    renamed: dict[sp.Symbol, sp.Expr]
    """The user's symbols in these."""
    own: dict[sp.Symbol, sp.Symbol]
    """These symbols in the user's."""
    rounded: Rounded = field(default_factory=Rounded)
    """Decimal numbers of too many digits."""

    @property
    def bounded(self) -> bool:
        """Tell whether every side of the domain has an end."""
        return not any(end in {sp.oo, -sp.oo} for side in self.domain.values() for end in side)

    @property
    def parameters(self) -> dict[sp.Symbol, Interval]:
        """What the parameters may be, in the user's symbols; (0, oo) of those without a range."""
        sides = dict.fromkeys(self.positive, (sp.S.Zero, sp.oo)) | self.ranges
        return {self.own[p]: side for p, side in sides.items() if p not in self.rounded.numbers}

    def read(self, expression: Any) -> sp.Expr:
        """Return an expression of the user in these symbols.

        Raises ModelError where it holds something that has no enclosure, or an unknown symbol.
        """
        e = self.rounded.apart(read(expression, "V"))
        wrong = sorted(str(s) for s in e.free_symbols - set(self.renamed) - set(self.rounded.numbers))
        if wrong:
            raise ModelError(
                f"{expression} speaks of {', '.join(wrong)}, which is neither state nor parameter"
            )
        return e.xreplace(self.renamed)

    def in_own_symbols(self, point: Point) -> Point:
        """Return a point in the user's symbols and coordinates."""
        moved = {x: point[x] + self.equilibrium[self.own[x]] for x in self.states}
        return {self.own[s]: value for s, value in (point | moved).items() if s in self.own}

    def shown(self, expression: sp.Expr) -> sp.Expr:
        """Return an expression in the user's symbols and coordinates."""
        if not any(self.equilibrium.values()):
            return expression.xreplace(self.own | self.rounded.shown)
        there = {x: self.own[x] - self.equilibrium[self.own[x]] for x in self.states}
        return expression.subs(there, simultaneous=True).xreplace(self.own | self.rounded.shown)

    def within(self, domain: Mapping[sp.Symbol, Interval]) -> System:
        """Return the same system on another domain."""
        return replace(self, domain=dict(domain))


def make_system(
    f: Mapping[sp.Symbol, Any], V: Any, at: Mapping[sp.Symbol, Any] | None,
    box: Mapping[sp.Symbol, tuple[Any, Any]] | None, parameters: Mapping[sp.Symbol, tuple[Any, Any]] | None,
) -> System:  # fmt: skip
    """Return the system in exact form.

    Raises ModelError where `at` is no equilibrium or not inside the box, or where f jumps or holds what
    cannot be enclosed; where an option names what f does not know, or a symbol carries an assumption that
    the claim does not.
    """
    if not isinstance(f, Mapping) or not f:
        raise ModelError("f has no state: it maps each state to its time derivative")
    at, box, parameters = (_mapping(o, n) for o, n in ((at, "at"), (box, "box"), (parameters, "parameters")))
    _names(f, at, box, parameters)
    ranges = {p: _interval(p, side) for p, side in parameters.items()}
    if endless := [str(p) for p, side in ranges.items() if any(end.is_infinite for end in side)]:
        raise ModelError(f"the range of {endless[0]} has no end: leave it out to mean all positive numbers")
    rounded = Rounded()
    f = {x: rounded.apart(read(e, f"d{x}/dt")) for x, e in f.items()}
    of_V = rounded.apart(read(0 if V is None else V, "V")).free_symbols
    everything = set().union(*(e.free_symbols for e in f.values()), of_V) - set(rounded.numbers)
    free = _free(everything, set(f), ranges)
    _assumptions(f, free, ranges)
    renamed: dict[sp.Symbol, sp.Expr] = {x: sp.Symbol(str(x), real=True) for x in f}
    renamed |= {p: sp.Symbol(str(p), **_sign(side)) for p, side in ranges.items()}
    renamed |= {p: sp.Symbol(str(p), positive=True) for p in free}
    if len({str(s) for s in renamed}) != len(renamed):
        raise ModelError("two symbols have one name: give each state and parameter its own")
    own = {new: old for old, new in renamed.items()}
    states = tuple(renamed[x] for x in f)
    centre = {x: exact(read(at.get(x, 0), f"`at` of {x}")) for x in f}
    for x, value in centre.items():
        if wrong := sorted(map(str, value.free_symbols - {*free, *ranges})):
            raise ModelError(f"`at` puts {x} at {value}: {', '.join(wrong)} is no parameter; name a number")
    equilibrium = {x: value.xreplace(renamed) for x, value in centre.items()}
    shifted = renamed | {x: renamed[x] + equilibrium[x] for x in f}
    rates = {renamed[x]: _field(x, e, shifted) for x, e in f.items()}
    for x, e in rates.items():
        _vanishes(x, e, dict.fromkeys(states, sp.S.Zero), equilibrium)
    domain = {renamed[x]: _about(x, box.get(x), equilibrium[x]) for x in f}
    ranged = {renamed[p]: side for p, side in ranges.items()}
    ranged |= {p: around(c) for p, c in rounded.numbers.items()}
    positive = tuple(renamed[p] for p in free)
    return System(states, rates, domain, ranged, positive, equilibrium, shifted, own, rounded)


def _mapping(option: Any, name: str) -> dict[Any, Any]:
    if option is not None and not isinstance(option, Mapping):
        raise ModelError(f"`{name}` is {option!r}: it maps symbols to what is meant of them")
    return dict(option or {})


def _free(
    everything: set[sp.Symbol], states: set[sp.Symbol], ranges: Mapping[sp.Symbol, Interval]
) -> list[sp.Symbol]:
    """Return the parameters without a range."""
    free = sorted(everything - states - set(ranges), key=str)
    if any(str(s) == "t" for s in free):
        raise ModelError(
            "f and V depend on t: only systems dx/dt = f(x) without time can be verified; a constant of that "
            "name has its range in `parameters`"
        )
    if unused := sorted(map(str, set(ranges) - everything)):
        raise ModelError(f"`parameters` names {', '.join(unused)}, of which neither f nor V speaks")
    return free


def _sign(side: Interval) -> dict[str, bool]:
    """Return what sympy may know of a parameter with a range."""
    low, high = side
    return {"positive": True} if low > 0 else {"negative": True} if high < 0 else {"real": True}


def _names(
    f: Mapping[Any, Any], at: Mapping[Any, Any], box: Mapping[Any, Any], parameters: Mapping[Any, Any]
) -> None:
    """Refuse a name that is not understood: it would change the question unseen."""
    states = ", ".join(map(str, f))
    for x in (*f, *parameters):
        if type(x) not in (sp.Symbol, sp.Dummy):
            raise ModelError(f"{x!r} is no symbol: states and parameters are made by sympy.Symbol")
    for option, names in (("at", at), ("box", box)):
        if wrong := [str(x) for x in names if x not in f]:
            raise ModelError(
                f"`{option}` names {', '.join(wrong)}, which is no state: the states are {states}"
            )
    if wrong := [str(p) for p in parameters if p in f]:
        raise ModelError(
            f"`parameters` names {', '.join(wrong)}, which is a state: its range goes into `box`"
        )


def _assumptions(
    states: Iterable[sp.Symbol], free: Iterable[sp.Symbol], ranges: Mapping[sp.Symbol, Interval]
) -> None:
    """Refuse an assumption that is not part of the claim: sympy has simplified f and V by it."""
    positive = [*free, *(p for p, (low, _) in ranges.items() if low > 0)]
    real = [*states, *(p for p in ranges if p not in positive)]
    for symbols, meant in ((real, "real"), (positive, "positive")):
        known = sp.Symbol("s", **{meant: True}).assumptions0.items()
        for s in symbols:
            if not s.assumptions0.items() <= known:
                raise ModelError(
                    f"{s} was declared with an assumption that not every {meant} number meets, and sympy "
                    f'simplifies by it; every one is meant here: declare it as sympy.Symbol("{s}")'
                )


def _field(x: sp.Symbol, e: sp.Expr, shifted: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    jumps = {str(a) for a in e.atoms(sp.Function) if a.func not in FUNCTIONS | {sp.sign}}
    if jumps:
        raise ModelError(f"d{x}/dt holds {', '.join(sorted(jumps))}: only {_allowed()} can be enclosed")
    try:
        smooth = continuous(sp.expand(e.xreplace(shifted)) if e.has(sp.sign) else e.xreplace(shifted))
    except ModelError as error:
        raise ModelError(f"d{x}/dt must be continuous: {error}") from None
    if wrong := unsupported(smooth):
        raise ModelError(f"d{x}/dt holds {', '.join(sorted(wrong))}: only {_allowed()} can be enclosed")
    return smooth


def _allowed() -> str:
    names = ", ".join(sorted(f.__name__ for f in FUNCTIONS))
    return f"sums, products, rational powers, {names}"


def _vanishes(x: sp.Symbol, e: sp.Expr, origin: Point, equilibrium: Point) -> None:
    value = sp.simplify(e.xreplace(origin))
    if value != 0:
        where = ", ".join(f"{s} = {v}" for s, v in equilibrium.items())
        raise ModelError(
            f"{where} is not shown to be an equilibrium: d{x}/dt = {value} there; name in `at` where f is 0"
        )


def _interval(x: sp.Symbol, side: tuple[Any, Any]) -> Interval:
    if not isinstance(side, tuple | list) or len(side) != 2:
        raise ModelError(f"the range of {x} is {side!r}: two numbers, the lower first")
    low, high = (exact(read(end, f"an end of the range of {x}", infinite=True)) for end in side)
    ordered = all(end.is_number and end.is_extended_real for end in (low, high))
    if not ordered or not (low < high):
        raise ModelError(f"the range of {x} is [{low}, {high}]: two numbers, the lower first")
    return low, high


def _about(x: sp.Symbol, side: tuple[Any, Any] | None, centre: sp.Expr) -> Interval:
    if side is None:
        return -sp.oo, sp.oo
    low, high = _interval(x, side)
    if centre.free_symbols:
        raise ModelError(f"the equilibrium {x} = {centre} depends on a parameter: a box needs a number")
    around = tuple(end if end.is_infinite else sp.expand(end - centre) for end in (low, high))
    inside = all(e.is_infinite or (number(e) < 0 if k == 0 else number(e) > 0) for k, e in enumerate(around))
    if not inside:
        raise ModelError(
            f"the equilibrium {x} = {centre} is not inside its box [{low}, {high}]: name a wider one"
        )
    return around
