"""Accepted input, the meaning of decimal numbers, and the time limit of the verifier."""

import time
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
import sympy as sp

from drivers.errors import ModelError
from hil.proof import Budget, Certificate, Equilibrium, Truth, verify
from hil.proof.expressions import written
from hil.proof.linearisation import Eigenvalues

x, y, v, k = sp.symbols("x y v k")
R = sp.Rational


@pytest.mark.parametrize(
    "bad",
    [
        "x**2", True, None, [-x], np.array([1.0]), np.int64(2), 1j, sp.Eq(x, 0), x > 0, sp.Matrix([-x]),
        sp.I * x, sp.zoo, sp.oo, {x: 1}, float("nan"), Decimal("NaN"), -sp.GoldenRatio * x, sp.Wild("w") * x,
        sp.Symbol("A", commutative=False) * x, sp.Derivative(sp.Function("g")(x), x), sp.Integral(x, x),
    ],
    ids=lambda each: type(each).__name__,
)  # fmt: skip
def test_f_must_be_an_expression_of_real_numbers(bad):
    with pytest.raises(ModelError):
        verify({x: bad}, x**2)


@pytest.mark.parametrize("V", ["x**2", True, np.ones(1), sp.GoldenRatio * x, x > 0, sp.I * x])
def test_V_must_be_an_expression_of_real_numbers(V):
    with pytest.raises(ModelError):
        verify({x: -x}, V)


@pytest.mark.parametrize(
    "options",
    [
        {"at": {x: "0"}}, {"at": [0]}, {"box": {x: ("-1", "1")}}, {"box": {x: (False, True)}},
        {"box": {x: (-1, sp.GoldenRatio)}}, {"box": {x: (-1, sp.nan)}}, {"box": 3}, {"box": {x: {-1, 1}}},
        {"parameters": {k: (1, sp.Catalan)}}, {"parameters": "k"},
    ],
    ids=str,
)  # fmt: skip
def test_options_with_anything_but_real_numbers_are_refused(options):
    with pytest.raises(ModelError):
        verify({x: -k * x}, x**2, **options)


def test_python_and_numpy_numbers_are_accepted():
    for half in (0.5, Fraction(1, 2), Decimal("0.5"), R(1, 2), np.float64(0.5)):
        report = verify({x: -x}, x**2, box={x: (-1, half)})
        assert report.equilibrium.box == {x: (-1, R(1, 2))}
    assert verify({x: 0}, x**2).equilibrium.status is Equilibrium.STABLE


@pytest.mark.parametrize("boxes", [-1, True, 2.5, "9"])
def test_an_invalid_budget_is_refused(boxes):
    with pytest.raises(ModelError):
        Budget(boxes)
    with pytest.raises(ModelError):
        Budget(seconds=0)


@pytest.mark.parametrize(
    ("number", "fraction"),
    [
        (3.1, R(31, 10)), (0.7, R(7, 10)), (-0.1, R(-1, 10)), (1e-23, R(1, 10**23)), (1.380649e-23, R(1380649, 10**29)),
        (2.5e300, 25 * 10**299), (0.1 + 0.2, None), (1 / 3, None), (0.1 + 0.2 - 0.3, None), (3.1 / 0.7, None),
        (sp.Float("3.1", 40), R(31, 10)), (sp.Float(3.1, 40), None), (sp.Float("0.25", 5), R(1, 4)), (sp.pi.evalf(), None),
    ],
)  # fmt: skip
def test_a_short_decimal_is_the_fraction_as_written(number, fraction):
    assert written(sp.Float(number) if isinstance(number, float) else number) == fraction


def test_a_rounded_quotient_leaves_the_claim_undecided():
    report = verify({x: v, v: -(3.1 * x) / 0.7}, 0.7 * v**2 / 2 + 3.1 * x**2 / 2)
    assert report.certificate.status is Certificate.UNDECIDED
    assert "4.42857142857143" in report.certificate.reason
    assert report.equilibrium.asymptotic is Truth.UNDECIDED
    exact = verify({x: v, v: -(R("3.1") * x) / R("0.7")}, R("0.7") * v**2 / 2 + R("3.1") * x**2 / 2)
    assert exact.certificate.status is Certificate.VALID


@pytest.mark.parametrize(("damping", "truth"), [(0.3, Truth.PROVEN), (-0.3, Truth.REFUTED)])
def test_a_rounded_number_decides_if_rounding_does_not_matter(damping, truth):
    rate = -(3.1 * x) / 0.7 - damping * v / 0.7
    assert verify({x: v, v: rate}).linearisation is (
        Eigenvalues.LEFT if truth is Truth.PROVEN else Eigenvalues.RIGHT
    )
    assert verify({x: v, v: rate}).equilibrium.asymptotic is truth
    assert verify({x: -(3.1 * x) / 0.7}, x**2 / 3).certificate.status is Certificate.VALID
    assert verify({x: (3.1 * x) / 0.7}, x**2 / 3).certificate.status is Certificate.GROWS


@pytest.mark.parametrize("c", [0.1 + 0.2 - 0.3, -(0.1 + 0.2 - 0.3)])
def test_a_rounding_residue_of_zero_has_no_sign(c):
    report = verify({x: c * x}, x**2)
    assert report.certificate.status is Certificate.UNDECIDED
    assert report.linearisation is Eigenvalues.UNKNOWN
    assert report.equilibrium.asymptotic is Truth.UNDECIDED


def _endless():
    a = sp.symbols("a0:9")
    return {s: -s + sum(a) ** 9 - s * sp.sin(sum(a)) ** 40 for s in a}, sum(s**2 for s in a) + sum(a) ** 8


# an alarm that rings inside the garbage collector is lost; the next one counts
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_verifier_answers_at_its_time_limit():
    f, V = _endless()
    began = time.monotonic()
    report = verify(f, V, budget=Budget(seconds=2.0))
    assert time.monotonic() - began < 8
    assert report.certificate.status is Certificate.UNDECIDED
    assert "time limit" in report.certificate.reason
    assert report.equilibrium.status in {Equilibrium.NO_CONCLUSION, Equilibrium.ASYMPTOTICALLY_STABLE}
