"""Input file of `hil prove`: states, their derivatives, the candidate V and the box for which it is claimed.

An expression is text in a small grammar: numbers, names, + - * / **, brackets and the functions of FUNCTIONS.
The text is parsed to a syntax tree without executing Python. Numbers are bounded before SymPy evaluates them.
"""

import ast
import operator
from collections.abc import Callable
from decimal import Decimal
from keyword import iskeyword
from typing import Annotated, Literal

import sympy as sp
from pydantic import AfterValidator, Field, StringConstraints

from drivers.section import Section
from hil.proof import interval
from hil.proof.branch_and_bound import Budget
from hil.proof.report import Report
from hil.proof.theorems import verify

LONGEST = 4000
"""Largest number of characters of an expression, and of digits of a power of numbers."""
EXPONENT = 10_000
"""Largest numerator and denominator of an exponent, and of a number in a function."""
LARGEST = 300
"""Largest decimal exponent of a number."""
FUNCTIONS: dict[str, Callable[[sp.Expr], sp.Expr]] = {
    **{function.__name__.lower(): function for function in interval.FUNCTIONS},
    "sqrt": sp.sqrt,
    "sign": sp.sign,
}
CONSTANTS: dict[str, sp.Expr] = {"pi": sp.pi, "e": sp.E}
_OPERATORS: dict[type, Callable[..., sp.Expr]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_SIZES = (
    f"allowed: numbers up to 1e{LARGEST}, exponents and arguments up to {EXPONENT}, "
    f"powers of up to {LONGEST} digits"
)
_ALLOWED = f"allowed: numbers, names, + - * / ** ( ), {', '.join(sorted(FUNCTIONS))}"


def expression(text: str | float) -> sp.Expr:
    """Parse an expression of this module's grammar; a name is a symbol, `pi` and `e` are the constants.

    Raises ValueError for any other text.
    """
    text = str(text)
    if len(text) > LONGEST:
        raise ValueError(f"{len(text)} characters, allowed: up to {LONGEST}")
    try:
        return _built(ast.parse(text.strip(), mode="eval").body, text.strip())
    except (SyntaxError, RecursionError, MemoryError):
        raise ValueError(f"{text[:60]!r} is not an expression, {_ALLOWED}") from None


def _built(node: ast.expr, text: str) -> sp.Expr:
    match node:
        case ast.Constant(value=int() | float()) if not isinstance(node.value, bool):
            return _number(ast.get_source_segment(text, node) or "")
        case ast.Name(id=name) if name not in FUNCTIONS:
            return CONSTANTS.get(name) or sp.Symbol(name)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            a, b = _built(left, text), _built(right, text)
            if isinstance(op, ast.Div) and b == 0:
                raise ValueError(f"{ast.unparse(node):.60} divides by zero")
            if isinstance(op, ast.Pow) and b.is_number and not _held(a, b):
                raise ValueError(f"{ast.unparse(node):.60} is out of range, {_SIZES}")
            return _OPERATORS[type(op)](a, b)
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_built(operand, text))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            inner = _built(argument, text)
            if inner.is_number and not (_small(inner) or _small(inner / sp.pi)):
                raise ValueError(f"{ast.unparse(node):.60} is out of range, {_SIZES}")
            return FUNCTIONS[name](inner)
    raise ValueError(f"{ast.unparse(node):.60} is not in the grammar, {_ALLOWED}")


def _held(a: sp.Expr, b: sp.Expr) -> bool:
    """True if a power with a numeric exponent is finite and has few enough digits."""
    if not b.is_Rational:
        return not a.is_number
    if a == 0:
        return bool(b >= 0)
    factor = a.as_coeff_Mul()[0]
    digits = max(factor.p.bit_length(), factor.q.bit_length()) if factor.is_Rational else 1
    return _small(b) and bool(digits * abs(b) <= 4 * LONGEST)


def _small(number: sp.Expr) -> bool:
    return bool(number.is_Rational and max(abs(number.p), number.q) <= EXPONENT)


def _number(text: str) -> sp.Expr:
    try:
        number = Decimal(text)
    except ArithmeticError:
        raise ValueError(f"{text:.60} is not a decimal number, {_ALLOWED}") from None
    if number and abs(number.adjusted()) > LARGEST:
        raise ValueError(f"{text:.60} is out of range, {_SIZES}")
    return sp.Rational(str(number))


def _checked(text: str | float) -> str | float:
    expression(text)
    return text


Expression = Annotated[str | float, AfterValidator(_checked)]


def _free(name: str) -> str:
    if name in CONSTANTS or name in FUNCTIONS or iskeyword(name):
        raise ValueError(f"{name} is a constant, a function or a keyword, allowed: another name")
    return name


Name = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=50), AfterValidator(_free)
]
Range = tuple[Expression, Expression]


class Question(Section):
    """Content of an input file of `hil prove`."""

    kind: Literal["proof"]
    states: Annotated[dict[Name, Expression], Field(min_length=1)]
    """State -> its time derivative."""
    V: Expression | None = None
    """Lyapunov candidate; if omitted, one is proposed from the linearisation."""
    at: dict[Name, Expression] = {}
    """State -> its value at the equilibrium; omitted states are 0."""
    box: dict[Name, Range] = {}
    """Range of each state in which V is claimed; a state without a range is unbounded."""
    parameters: dict[Name, Range] = {}
    """Ranges of parameters; an omitted parameter is any positive number."""
    boxes: Annotated[int, Field(gt=0)] = 40_000
    """Largest number of cells in the search."""
    seconds: Annotated[float, Field(gt=0)] = 15.0
    """Time limit of the search, s."""

    def answer(self) -> Report:
        """Report of the verifier on this input. Raises the ModelError of `hil.proof.theorems.verify`."""
        return verify(
            {sp.Symbol(x): expression(rate) for x, rate in self.states.items()},
            None if self.V is None else expression(self.V),
            at={sp.Symbol(x): expression(value) for x, value in self.at.items()},
            box=_ranges(self.box),
            parameters=_ranges(self.parameters),
            budget=Budget(self.boxes, self.seconds),
        )


def _ranges(given: dict[str, Range]) -> dict[sp.Symbol, tuple[sp.Expr, sp.Expr]]:
    return {sp.Symbol(name): (expression(low), expression(high)) for name, (low, high) in given.items()}
