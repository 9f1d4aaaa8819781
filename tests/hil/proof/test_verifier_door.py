"""What the verifier takes for a question, what decimal numbers mean, and that an answer always comes."""

import sys
import threading
import time
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
import sympy as sp

from drivers.errors import ModelError
from hil.proof import Budget, Certificate, Equilibrium, Truth, verify
from hil.proof.door import around, written
from hil.proof.linearisation import Eigenvalues

x, y, v, k = sp.symbols("x y v k")
R = sp.Rational


@pytest.mark.parametrize(
    "rate",
    [
        "-x", True, None, [-x], (-x,), np.array([1.0]), np.float32(1.0), np.int64(2), np.array(-x, dtype=object),
        1j, sp.true, sp.Eq(x, 0), x > 0, sp.Matrix([-x]), sp.ImmutableMatrix([[-x]]), sp.MatrixSymbol("A", 1, 1),
        sp.MatrixSymbol("A", 1, 1)[0, 0] * x, sp.I * x, sp.zoo, sp.nan * x, sp.oo, {x: 1}, object(), float("nan"),
        float("inf"), Decimal("NaN"), -sp.GoldenRatio * x, -sp.EulerGamma * x, -sp.Catalan * x,
        -sp.TribonacciConstant * x, sp.Wild("w") * x, sp.Symbol("A", commutative=False) * x,
        sp.Derivative(sp.Function("g")(x), x), sp.Integral(x, x),
    ],
    ids=lambda each: type(each).__name__,
)  # fmt: skip
def test_what_is_no_expression_is_refused_at_the_door(rate):
    with pytest.raises(ModelError):
        verify({x: rate}, x**2)


@pytest.mark.parametrize(
    "V", ["x**2", True, np.ones(1), sp.Matrix([x**2]), sp.GoldenRatio * x**2, x > 0, sp.I * x**2]
)
def test_V_is_no_string_nor_array(V):
    with pytest.raises(ModelError):
        verify({x: -x}, V)


@pytest.mark.parametrize(
    "options",
    [
        {"at": {x: "0"}}, {"at": {x: False}}, {"at": [0]}, {"box": {x: ("-1", "1")}}, {"box": {x: (False, True)}},
        {"box": {x: "12"}}, {"box": {x: (-1, sp.GoldenRatio)}}, {"box": {x: (-1, sp.nan)}}, {"box": 3},
        {"box": {x: (-1, sp.Float("1e400"))}}, {"box": {x: {-1, 1}}}, {"parameters": {k: ("1", "2")}},
        {"parameters": {k: (1, sp.Catalan)}}, {"parameters": "k"},
    ],
    ids=str,
)  # fmt: skip
def test_options_are_numbers(options):
    with pytest.raises(ModelError):
        verify({x: -k * x}, x**2, **options)


def test_a_string_is_not_evaluated():
    touched = []

    class Spy(str):
        __slots__ = ()

        def __str__(self):
            touched.append(1)
            return "0"

    with pytest.raises(ModelError, match="Spy"):
        verify({x: Spy("__import__('os')")})
    assert not touched


def test_numbers_of_python_are_taken():
    for half in (0.5, Fraction(1, 2), Decimal("0.5"), R(1, 2), np.float64(0.5)):
        assert verify(
            {x: -x}, half * x**2 if not isinstance(half, Fraction | Decimal) else R(str(half)) * x**2
        )
        report = verify({x: -x}, x**2, box={x: (-1, half)})
        assert report.equilibrium.box == {x: (-1, R(1, 2))}
    assert verify({x: 0}, x**2).equilibrium.status is Equilibrium.STABLE


@pytest.mark.parametrize("boxes", [-1, True, 2.5, "9"])
def test_a_budget_is_a_whole_number_of_boxes(boxes):
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
def test_a_short_decimal_is_what_was_written(number, fraction):
    assert written(sp.Float(number) if isinstance(number, float) else number) == fraction


def test_a_rounded_number_stands_for_what_it_may_have_been():
    low, high = around(sp.Float(3.1 / 0.7))
    assert low < R(31, 7) < high
    low, high = around(sp.Float(0.1 + 0.2 - 0.3))
    assert low < 0 < high


def spring(stiffness, damping, mass):
    energy = mass * v**2 / 2 + stiffness * x**2 / 2
    return verify({x: v, v: -(stiffness * x + damping * v) / mass}, energy)


def test_a_rounded_quotient_refutes_nothing():
    report = verify({x: v, v: -(3.1 * x) / 0.7}, 0.7 * v**2 / 2 + 3.1 * x**2 / 2)
    assert report.certificate.status is Certificate.UNDECIDED
    assert "4.42857142857143" in report.certificate.reason
    assert report.equilibrium.asymptotic is Truth.UNDECIDED
    exact = verify({x: v, v: -(R("3.1") * x) / R("0.7")}, R("0.7") * v**2 / 2 + R("3.1") * x**2 / 2)
    assert exact.certificate.status is Certificate.VALID


@pytest.mark.parametrize(("damping", "truth"), [(0.3, Truth.PROVEN), (-0.3, Truth.REFUTED)])
def test_a_rounded_number_decides_where_rounding_does_not_matter(damping, truth):
    rate = -(3.1 * x) / 0.7 - damping * v / 0.7
    assert verify({x: v, v: rate}).linearisation is (
        Eigenvalues.LEFT if truth is Truth.PROVEN else Eigenvalues.RIGHT
    )
    assert verify({x: v, v: rate}).equilibrium.asymptotic is truth
    assert verify({x: -(3.1 * x) / 0.7}, x**2 / 3).certificate.status is Certificate.VALID
    assert verify({x: (3.1 * x) / 0.7}, x**2 / 3).certificate.status is Certificate.GROWS


@pytest.mark.parametrize("c", [0.1 + 0.2 - 0.3, -(0.1 + 0.2 - 0.3)])
def test_what_rounding_left_of_zero_has_no_sign(c):
    report = verify({x: c * x}, x**2)
    assert report.certificate.status is Certificate.UNDECIDED
    assert report.linearisation is Eigenvalues.UNKNOWN
    assert report.equilibrium.asymptotic is Truth.UNDECIDED


@pytest.mark.parametrize("exponent", [-400, -300, 300, 400])
def test_a_large_exponent_is_exact(exponent):
    c = sp.Float(f"1e{exponent}")
    assert verify({x: -c * x}, x**2).equilibrium.status is Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE
    assert verify({x: c * x}, x**2).equilibrium.status is Equilibrium.UNSTABLE
    assert verify({x: v, v: -x - c * v}).equilibrium.asymptotic is Truth.PROVEN


@pytest.mark.parametrize("large", [sp.Float("1e-90000"), sp.Float("1e90000"), R(1, 7**5000), R(7**5000, 3)])
def test_a_huge_number_is_undecided_with_the_reason(large):
    report = verify({x: -large * x}, x**2)
    assert report.certificate.status is Certificate.UNDECIDED
    assert "exact arithmetic" in report.certificate.reason
    assert "undecided" in str(report)
    assert report.equilibrium.status is Equilibrium.NO_CONCLUSION
    assert (
        verify({x: -x}, x**2 + sum(sp.symbols("a:z")) ** 20 - 1).certificate.status is Certificate.UNDECIDED
    )
    assert verify({x: -(x**100001)}, x**2).certificate.status is Certificate.UNDECIDED


def _endless():
    a = sp.symbols("a0:9")
    return {s: -s + sum(a) ** 9 - s * sp.sin(sum(a)) ** 40 for s in a}, sum(s**2 for s in a) + sum(a) ** 8


def test_an_answer_comes_when_the_seconds_end():
    f, V = _endless()
    began = time.monotonic()
    report = verify(f, V, budget=Budget(seconds=2.0))
    assert time.monotonic() - began < 8
    assert report.certificate.status is Certificate.UNDECIDED
    assert "time ended" in report.certificate.reason
    assert report.equilibrium.status in {Equilibrium.NO_CONCLUSION, Equilibrium.ASYMPTOTICALLY_STABLE}


@pytest.mark.long
def test_an_answer_comes_in_a_thread_without_an_alarm():
    f, V = _endless()
    reports = []
    thread = threading.Thread(target=lambda: reports.append(verify(f, V, budget=Budget(seconds=2.0))))
    thread.start()
    thread.join(20)
    assert reports
    assert reports[0].certificate.status is Certificate.UNDECIDED


class _Lingers:
    """What is raised in its finalizer is swallowed, and it takes longer than the question may."""

    def __del__(self):
        end = time.monotonic() + 1.3
        while time.monotonic() < end:
            pass


def _lingers_then_goes_on(seconds):
    began = time.monotonic()
    _Lingers()
    while time.monotonic() < began + seconds:
        pass


def _cut_short():
    budget = Budget(seconds=1.0)
    budget.start()
    began = time.monotonic()
    answer = budget.within(1.0, lambda: _lingers_then_goes_on(15), "cut short")
    return answer, time.monotonic() - began


def test_seconds_that_end_in_a_finalizer_still_end_the_question():
    hook = sys.unraisablehook
    answer, took = _cut_short()
    assert answer == "cut short"
    assert took < 8
    assert sys.unraisablehook is hook


def test_and_so_they_do_in_a_thread():
    answers = []
    thread = threading.Thread(target=lambda: answers.append(_cut_short()))
    thread.start()
    thread.join(20)
    assert answers[0][0] == "cut short"
    assert answers[0][1] < 8


@pytest.mark.long
def test_what_was_shown_before_the_seconds_end_stays():
    f, V = _endless()
    growing = {y: 2 * y} | f
    assert verify(growing, V + y**2, budget=Budget(seconds=4.0)).certificate.status is Certificate.UNDECIDED
