"""What comes in: expressions and numbers of sympy, and what a decimal number in them can mean.

A decimal of few digits is the fraction that is written: 3.1 is 31/10. One of many digits is what some
arithmetic has left, as -4.428571428571429 of -(3.1*x)/0.7: what it was rounded from is not known here. It
stands for every number within its rounding, and only what is true of all of them is proven or refuted.
"""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction
from typing import Any

import sympy as sp

from drivers.errors import ModelError

WRITTEN = 12
"""Digits up to which a decimal number of 15 is taken for what was written."""
ROUNDING = sp.Rational(1, 10**12)
"""Of a longer one, as a share of itself or, since terms may have cancelled, of 1."""
DIGITS = 1000
"""Of numerators and denominators."""
EXPONENT = 10**4
TERMS = 10**5
"""Of an expression that is multiplied out."""
_HOW = "write it with sympy: numbers, and expressions in sympy.Symbol"


class TooLarge(Exception):  # noqa: N818 - nobody's mistake: the answer is "undecided"
    """A number or an exponent that exact arithmetic does not hold."""


def read(value: Any, what: str) -> sp.Expr:
    """Return a number or an expression, as it is.

    Raises ModelError for all else: strings (sympy would evaluate them), truth values, arrays, matrices,
    relations, complex and infinite numbers, and constants that have no enclosure.
    """
    if isinstance(value, bool) or not isinstance(value, sp.Basic | int | float | Fraction | Decimal):
        kind = f"{type(value).__module__}.{type(value).__name__}".removeprefix("builtins.")
        raise ModelError(f"{what} is {value!r}, a {kind}: {_HOW}")
    if isinstance(value, Fraction | Decimal):
        try:
            value = sp.Rational(str(value))
        except (TypeError, ValueError):
            raise ModelError(f"{what} is {value}, which is no finite number: {_HOW}") from None
    e = sp.sympify(value)
    if not isinstance(e, sp.Expr) or e.is_Matrix:
        raise ModelError(f"{what} is {e}, a {type(e).__name__}: {_HOW}")
    for node in sp.preorder_traversal(e):
        if isinstance(node, sp.Basic) and getattr(node, "is_Matrix", False):
            raise ModelError(f"{what} holds a matrix: {_HOW}")
        if node is sp.nan or node is sp.zoo or node is sp.I:
            raise ModelError(f"{what} holds {node}, which is no real number: {_HOW}")
        if isinstance(node, sp.NumberSymbol) and node not in (sp.pi, sp.E):
            raise ModelError(f"{what} holds {node}, of which no enclosure is known: only pi and E have one")
        if isinstance(node, sp.Symbol) and type(node) not in (sp.Symbol, sp.Dummy):
            raise ModelError(f"{what} holds {node}, a {type(node).__name__}: {_HOW}")
    return e


def bounded(e: sp.Expr) -> sp.Expr:
    """Return the expression if exact arithmetic can hold its numbers and exponents.

    Raises TooLarge where one has more digits, and ModelError where one is infinite.
    """
    for node in sp.preorder_traversal(e):
        if isinstance(node, sp.Float):
            _, mantissa, exponent, bits = node._mpf_
            if mantissa and abs(int(exponent) + int(bits)) > 3.3 * DIGITS:
                raise TooLarge(f"a decimal number near 2^{int(exponent) + int(bits)}")
        elif isinstance(node, sp.Rational):
            if max(abs(int(node.p)).bit_length(), int(node.q).bit_length()) > 3.4 * DIGITS:
                raise TooLarge(f"a number of more than {DIGITS} digits")
        elif (
            isinstance(node, sp.Pow) and node.exp.is_Rational and max(abs(node.exp.p), node.exp.q) > EXPONENT
        ):
            raise TooLarge(f"an exponent beyond {EXPONENT}")
        elif node in (sp.oo, -sp.oo):
            raise ModelError("an infinite number stands in an expression")
    if _terms(e) > TERMS:
        raise TooLarge(f"an expression of more than {TERMS} terms")
    return e


def _terms(e: sp.Basic) -> float:
    """Return about how many terms an expression has when it is multiplied out."""
    inner = [_terms(a) for a in e.args]
    if isinstance(e, sp.Add):
        return sum(inner)
    if isinstance(e, sp.Mul):
        return min(math.prod(inner), math.inf)
    if isinstance(e, sp.Pow) and e.exp.is_Integer and inner[0] > 1:
        n, m = abs(int(e.exp)), inner[0]
        return math.inf if m > 1e15 or n > EXPONENT else _choose(n, m)
    return max([1.0, *(i if i > TERMS else 1.0 for i in inner)])


def _choose(n: int, m: float) -> float:
    """Return how many products of n out of m factors there are."""
    log = math.lgamma(n + m) - math.lgamma(n + 1) - math.lgamma(m)
    return math.exp(log) if log < 34 else math.inf


def exact(expression: sp.Expr) -> sp.Expr:
    """Return the expression with each decimal number as the fraction that its shortest decimal is."""
    e = sp.sympify(expression)
    return e.xreplace({c: _shortest(c) for c in e.atoms(sp.Float)})


def _shortest(c: sp.Float) -> sp.Expr:
    if not c.is_finite:
        return sp.nan if c.is_finite is None else c
    as_float = float(c) if abs(int(c._mpf_[2]) + int(c._mpf_[3])) < 1000 else 0.0
    return sp.Rational(repr(as_float)) if as_float and sp.Float(as_float) == c else sp.Rational(str(c))


class Rounded:
    """The decimal numbers of a question that may have been rounded: one symbol for each.

    Mutable: `numbers` has one more with each that is met.
    """

    def __init__(self) -> None:
        self.numbers: dict[sp.Dummy, sp.Float] = {}
        self._symbols: dict[sp.Float, sp.Dummy] = {}

    @property
    def shown(self) -> dict[sp.Dummy, sp.Expr]:
        """The numbers as they are printed; they do not cancel."""
        return {symbol: sp.UnevaluatedExpr(c) for symbol, c in self.numbers.items()}

    def apart(self, e: sp.Expr) -> sp.Expr:
        """Return the expression with written decimals as fractions, and symbols for rounded ones."""
        return e.xreplace({c: self._meant(c) for c in e.atoms(sp.Float)})

    def _meant(self, c: sp.Float) -> sp.Expr:
        if (fraction := written(c)) is not None:
            return fraction
        size = abs(c)
        if size not in self._symbols:
            sign = {"positive": True} if around(size)[0] > 0 else {"real": True}
            symbol = sp.Dummy(f"rounded{len(self.numbers)}", **sign)
            self._symbols[size], self.numbers[symbol] = symbol, size
        return self._symbols[size] if c > 0 else -self._symbols[size]


def around(c: sp.Float) -> tuple[sp.Expr, sp.Expr]:
    """Return the ends of what a rounded number may have been."""
    middle = _shortest(c)
    share = max(ROUNDING, sp.Rational(10) ** -max(_digits(c) - 3, 1))
    reach = share * max(abs(middle), sp.S.One)
    return middle - reach, middle + reach


def written(c: sp.Float) -> sp.Rational | None:
    """Return the fraction that a decimal number was written as; None if it has too many digits to tell."""
    if c == 0:
        return sp.S.Zero
    text = str(c)
    digits = Decimal(text).normalize().as_tuple().digits
    if len(digits) > max(_digits(c) - (15 - WRITTEN), 1) or sp.Float(text, precision=_bits(c)) != c:
        return None
    return sp.Rational(text)


def _digits(c: sp.Float) -> int:
    """Return how many decimal digits a number carries."""
    return max(round(_bits(c) / math.log2(10)) - 1, 1)


def _bits(c: sp.Float) -> int:
    return int(c._prec)  # noqa: SLF001 - sympy has no other name for it
