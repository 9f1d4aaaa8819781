"""Linear systems: eigenvalues against NumPy and closed forms, quadratic V of many states, and a proposed V."""

import itertools
import random
import time

import numpy as np
import pytest
import sympy as sp

from hil.proof import Budget, Certificate, Equilibrium, Truth, verify
from hil.proof.linearisation import Eigenvalues, eigenvalues, of_rationals
from hil.proof.signs import Signs
from hil.proof.system import make_system

x, y, z, v, w = sp.symbols("x y z v w")
R = sp.Rational
NAMES = [
    "s", "t", "lambda", "E", "x", "I", "N", "S", "Q", "p", "s1", "beta", "gamma", "pi", "O", "C", "u0", "eigenvalue",
]  # fmt: skip


@pytest.mark.parametrize(
    ("A", "where"),
    [
        ([[1, 0], [0, -1]], "R"), ([[-1, 0], [0, 1]], "R"), ([[0, 1], [1, 0]], "R"), ([[-3, 1], [4, 1]], "R"),
        ([[0, 0], [0, 1]], "R"), ([[0, 0], [0, -1]], "0"), ([[0, 1], [-1, 0]], "0"), ([[0, 1], [0, 0]], "0"),
        ([[0, 1, 0], [-1, 0, 0], [0, 0, -1]], "0"), ([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "R"),
        ([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-3, -2, -2, -1]], "R"),  # a zero in Routh's column
        ([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-4, 0, -5, 0]], "0"),  # (s^2 + 1)(s^2 + 4)
        ([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-4, 0, 0, 0]], "R"),  # s^4 + 4
        ([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, -2, 0]], "0"),  # (s^2 + 1)^2
        ([[0, 1, 0], [0, 0, 1], [-2, -2, -1]], "0"),  # (s + 1)(s^2 + 2)
        ([[0, 1, 0], [0, 0, 1], [-6, -11, -6]], "L"), ([[-1, 100], [0, -1]], "L"),
    ],
)  # fmt: skip
def test_eigenvalues_of_rational_matrices_are_located_exactly(A, where):
    found = {"L": Eigenvalues.LEFT, "R": Eigenvalues.RIGHT, "0": Eigenvalues.UNKNOWN}[where]
    assert of_rationals(sp.Matrix(A)) is found


@pytest.mark.parametrize("digits", [20, 60, 200])
def test_even_the_smallest_damping_is_decided(digits):
    small = R(1, 10**digits)
    assert of_rationals(sp.Matrix([[0, 1], [-1, -small]])) is Eigenvalues.LEFT
    assert of_rationals(sp.Matrix([[0, 1], [-1, small]])) is Eigenvalues.RIGHT
    third = sp.Matrix([[0, 1, 0], [0, 0, 1], [-1 + small, -1, -1]])  # s^3 + s^2 + s + 1 - small
    assert of_rationals(third) is Eigenvalues.LEFT
    third[2, 0] = -1 - small
    assert of_rationals(third) is Eigenvalues.RIGHT


def loop(pole, order):
    """A chain of integrators under feedback with one multiple pole."""
    coefficients = sp.Poly(sp.expand((z - pole) ** order), z).all_coeffs()
    q = sp.symbols(f"q0:{order}")
    last = sum(-c * s for c, s in zip(coefficients[:0:-1], q, strict=True))
    return {**dict(itertools.pairwise(q)), q[-1]: sp.expand(last)}


@pytest.mark.parametrize("order", [2, 3, 5])
@pytest.mark.parametrize("pole", [-sp.sqrt(2), -sp.pi, -w, -sp.sqrt(2) * w])
def test_multiple_poles_are_located(pole, order):
    ranges = {w: (R(3, 4), R(5, 4))} if order < 5 else {w: (1, R(51, 50))}
    ranges = {p: side for p, side in ranges.items() if p in pole.free_symbols}
    for sign, where in ((1, Eigenvalues.LEFT), (-1, Eigenvalues.RIGHT)):
        signs = Signs(make_system(loop(sign * pole, order), None, None, None, ranges), Budget())
        assert eigenvalues(signs) is where


def test_loops_near_critical_damping_are_proven_stable():
    report = verify({x: v, v: -2 * sp.sqrt(2) * v - 2 * x})
    assert report.equilibrium.status is Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE
    assert report.certificate.status is Certificate.VALID
    ranges = {y: (R(9, 10), R(11, 10)), w: (1, 2)}
    ranged = verify({x: v, v: -2 * y * w * v - w**2 * x}, parameters=ranges)
    assert ranged.linearisation is Eigenvalues.LEFT


def coupled(n, seed=1, stable=True):
    chance = random.Random(seed)
    q = sp.symbols(f"q0:{n}")
    A = [[chance.randint(-3, 3) - (25 if stable else 0) * (i == j) for j in range(n)] for i in range(n)]
    return {q[i]: sum(a * s for a, s in zip(A[i], q, strict=True)) for i in range(n)}, q


def test_a_quadratic_V_of_twelve_coupled_states_is_decided_within_5_s():
    f, q = coupled(12)
    V = sum(s**2 for s in q) + sum(a * b for a, b in itertools.pairwise(q)) / 2
    began = time.process_time()
    report = verify(f, V)
    assert time.process_time() - began < 5
    assert report.certificate.status is Certificate.VALID
    assert report.equilibrium.status is Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE
    bad = verify(f, V - 3 * q[0] * q[11])
    assert bad.certificate.status is Certificate.NOT_POSITIVE_DEFINITE
    at = bad.certificate.at
    assert (V - 3 * q[0] * q[11]).subs(at) == bad.certificate.value <= 0
    assert any(at.values())


def test_a_proposed_V_is_proven_for_the_nonlinear_system():
    report = verify({x: v, v: -x - v + x**3})
    assert report.certificate.status is Certificate.VALID
    V, V_dot = report.certificate.V, report.certificate.V_dot
    assert sp.expand(V - (v**2 + v * x + R(3, 2) * x**2)) == 0  # A^T P + P A = -1, by hand
    assert sp.expand(sp.diff(V, x) * v + sp.diff(V, v) * (-x - v + x**3) - V_dot) == 0
    assert report.equilibrium.status is Equilibrium.ASYMPTOTICALLY_STABLE
    box, level = report.equilibrium.box, report.equilibrium.level
    assert level > 0
    chance = random.Random(1)
    for _ in range(300):
        at = {s: R(chance.randint(-100, 100), 100) * box[s][1] for s in (x, v)}
        assert V_dot.subs(at) < 0 or not any(at.values())
        edge = at | {x: box[x][1]}
        assert V.subs(edge) >= level
    assert "proposed" in str(report)


def test_a_proposed_V_proves_linear_systems_globally_others_locally():
    a, b = sp.symbols("a b")
    linear = verify({x: v, v: -a * x - b * v})
    assert linear.equilibrium.status is Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE
    assert linear.certificate.V.free_symbols == {x, v, a, b}
    assert verify({x: -x - x**3, y: -y}).equilibrium.status is Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE
    assert verify({x: -x + x**3}).equilibrium.status is Equilibrium.ASYMPTOTICALLY_STABLE
    assert verify({x: -sp.sin(x)}).equilibrium.box is not None
    assert verify({x: 1 - x**2}, at={x: 1}).equilibrium.status is Equilibrium.ASYMPTOTICALLY_STABLE
    ranged = verify({x: v, v: -a * x - v + x**2}, parameters={a: (1, 2)})
    assert ranged.equilibrium.asymptotic is Truth.PROVEN
    assert ranged.certificate.status is Certificate.VALID
    assert verify({x: -x, y: sp.S.Zero}).certificate.status is Certificate.NONE


def _system(chance):
    """A stable or unstable random matrix of 2 to 6 states in up to three parameters, and their ranges."""
    n = chance.randint(2, 6)
    m = chance.randint(1, 3)
    names = chance.sample(NAMES, m)
    p = sp.symbols(names)
    shift = chance.choice([-4, -2, 0, 2]) - (n if chance.random() < 0.6 else 0)
    A = sp.Matrix(n, n, lambda i, j: chance.randint(-3, 3) * (chance.random() < 0.6) + shift * (i == j))
    for k in p:
        i, j = chance.randrange(n), chance.randrange(n)
        A[i, j] += chance.choice([1, -1, 2]) * k
    if chance.random() < 0.3:
        A *= p[0]
    ranges = {k: (R(1, chance.randint(2, 4)), R(chance.randint(2, 4), 2)) for k in p}
    return A, {k: r for k, r in ranges.items() if k in A.free_symbols}


def _rightmost(A, ranges, chance):
    """Smallest and largest real part of the rightmost eigenvalue at 20 points, by NumPy."""
    numbers = sp.lambdify(list(ranges), A, "numpy")
    at = [[chance.uniform(float(low), float(high)) for low, high in ranges.values()] for _ in range(20)]
    right = [max(np.linalg.eigvals(np.array(numbers(*p), float)).real) for p in at]
    return min(right), max(right)


def judge(count, seed):
    """Numbers of wrong findings, of decided systems, and of systems with one verdict at 20 points."""
    chance = random.Random(seed)
    wrong = decided = uniform = 0
    for _ in range(count):
        A, ranges = _system(chance)
        q = sp.symbols(f"q0:{A.rows}")
        f = dict(zip(q, A * sp.Matrix(q), strict=True))
        signs = Signs(make_system(f, None, None, None, ranges), Budget(2000))
        found = eigenvalues(signs)
        least, greatest = _rightmost(A, ranges, chance)
        wrong += found is Eigenvalues.LEFT and greatest > 1e-9
        wrong += found is Eigenvalues.RIGHT and least < -1e-9
        decided += found is not Eigenvalues.UNKNOWN
        uniform += bool(greatest < -1e-6 or least > 1e-6)
    return wrong, decided, uniform


def test_findings_on_random_linear_systems_agree_with_numpy():
    wrong, decided, uniform = judge(20, seed=7)
    assert wrong == 0
    assert decided >= 0.8 * uniform
