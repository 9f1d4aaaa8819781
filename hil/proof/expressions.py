"""Input expressions and numbers of SymPy, and the meaning of decimal numbers in them.

A decimal number of few digits is the fraction as written: 3.1 is 31/10. A number of many digits is usually a
rounded result, such as -4.428571428571429 for -(3.1*x)/0.7, whose exact value is unknown. Such a number
represents every number within its rounding; a claim is proven or refuted only for all of them.
"""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction
from typing import Any

import sympy as sp

from drivers.errors import ModelError

WRITTEN = 12
"""Largest number of digits with which a decimal number of 15-digit precision counts as exact."""
ROUNDING = sp.Rational(1, 10**12)
"""Assumed rounding error of a longer number, relative to the larger of its magnitude and 1."""
DIGITS, EXPONENT = 1000, 10**4
"""Limits for numbers and exponents, so that exact arithmetic stays feasible."""
_HOW = "write it with sympy: numbers, and expressions in sympy.Symbol"


def read(value: Any, what: str, *, infinite: bool = False) -> sp.Expr:
    """Check a number or an expression, and return it unchanged.

    Raises ModelError for any other type: strings (SymPy would evaluate them), truth values, arrays, matrices,
    relations, complex numbers, infinite numbers unless `infinite`, and constants without an enclosure.
    """
    if isinstance(value, bool) or not isinstance(value, sp.Expr | int | float | Fraction | Decimal):
        raise ModelError(f"{what} is {value!r}, a {type(value).__name__}: {_HOW}")
    try:
        e = sp.Rational(str(value)) if isinstance(value, Fraction | Decimal) else sp.sympify(value)
    except (TypeError, ValueError):
        raise ModelError(f"{what} is {value}, which is not a finite number: {_HOW}") from None
    for node in sp.preorder_traversal(e):
        if node in (sp.oo, -sp.oo) and infinite:
            continue
        if _size(node) > 3.322 * DIGITS:
            raise ModelError(f"{what} has a number of more than {DIGITS} digits")
        if isinstance(node, sp.Pow) and node.exp.is_Rational and max(abs(node.exp.p), node.exp.q) > EXPONENT:
            raise ModelError(f"{what} has an exponent beyond {EXPONENT}")
        known = isinstance(node, sp.Rational | sp.Float) or node in (sp.pi, sp.E)
        unknown = isinstance(node, sp.Expr) and node.is_Atom and not known
        if getattr(node, "is_Matrix", False) or (unknown and type(node) not in (sp.Symbol, sp.Dummy)):
            raise ModelError(
                f"{what} contains {node}, a {type(node).__name__}, which has no known enclosure: {_HOW}"
            )
    return e


def _size(node: sp.Basic) -> int:
    """Approximate bits of a number's numerator or denominator; 0 for any other node."""
    if isinstance(node, sp.Float):
        _, mantissa, exponent, bits = node._mpf_
        return abs(int(exponent) + int(bits)) if mantissa else 0
    if isinstance(node, sp.Rational):
        return max(abs(int(node.p)).bit_length(), int(node.q).bit_length())
    return 0


def exact(e: sp.Expr) -> sp.Expr:
    """Expression with each decimal number replaced by the fraction that its printed digits mean."""
    return e.xreplace({c: sp.Rational(str(c)) for c in e.atoms(sp.Float)})


class Rounded:
    """Decimal numbers of a problem that may have been rounded, one symbol for each.

    Mutable: `numbers` grows with each new number.
    """

    def __init__(self) -> None:
        self.numbers: dict[sp.Dummy, sp.Float] = {}
        self._symbols: dict[sp.Float, sp.Dummy] = {}

    @property
    def shown(self) -> dict[sp.Dummy, sp.Expr]:
        """Symbol -> its number as printed, for output; SymPy does not combine such numbers."""
        return {symbol: sp.UnevaluatedExpr(c) for symbol, c in self.numbers.items()}

    def apart(self, e: sp.Expr) -> sp.Expr:
        """Expression with exact decimals replaced by fractions, and possibly rounded ones by symbols."""
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
    """Smallest and largest exact value that a rounded decimal number may stand for."""
    middle = sp.Rational(str(c))
    share = max(ROUNDING, sp.Rational(10) ** -max(_digits(c) - 3, 1))
    reach = share * max(abs(middle), sp.S.One)
    return middle - reach, middle + reach


def written(c: sp.Float) -> sp.Rational | None:
    """Fraction that a decimal number with few digits means exactly; None if it has too many digits."""
    if c == 0:
        return sp.S.Zero
    text = str(c)
    digits = Decimal(text).normalize().as_tuple().digits
    if len(digits) > max(_digits(c) - (15 - WRITTEN), 1) or sp.Float(text, precision=_bits(c)) != c:
        return None
    return sp.Rational(text)


def _digits(c: sp.Float) -> int:
    """Precision of a number in decimal digits."""
    return max(round(_bits(c) / math.log2(10)) - 1, 1)


def _bits(c: sp.Float) -> int:
    return int(c._prec)  # noqa: SLF001 - sympy has no other name for it
