"""Systems of the chapter and of textbooks with known stability."""

from typing import Any

import pytest
import sympy as sp

from drivers.errors import ModelError
from hil.proof import Budget, Certificate, Decrease, Equilibrium, Truth, verify
from hil.proof.linearisation import Eigenvalues

x, v, y, z, theta, omega = sp.symbols("x v y z theta omega")
m, b, k0, k1 = sp.symbols("m b k0 k1")
R = sp.Rational
PENDULUM = 1 - sp.cos(theta) + omega**2 / 2
TURN = {theta: (-sp.pi, sp.pi), omega: (-3, 3)}


def test_spring_and_damper_is_asymptotically_stable_for_all_positive_parameters():
    spring = {x: v, v: -(b * v * sp.Abs(v) + k0 * x + k1 * x**3) / m}
    report = verify(spring, m * v**2 / 2 + k0 * x**2 / 2 + k1 * x**4 / 4)
    assert report.certificate.status is Certificate.VALID
    assert report.certificate.decrease is Decrease.WEAK  # the scan has < 0
    assert sp.simplify(report.certificate.V_dot.subs(v, -3) + 27 * b) == 0  # -b |v|^3
    assert report.equilibrium.status is Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE
    assert "LaSalle" in report.equilibrium.by
    assert report.linearisation is Eigenvalues.UNKNOWN  # two on the imaginary axis


@pytest.mark.parametrize("rate", [-(x**3), sp.sin(x) ** 2 - x])
def test_first_order_example_systems_are_globally_asymptotically_stable(rate):
    report = verify({x: rate}, x**2)
    assert report.certificate.decrease is Decrease.STRICT
    assert report.equilibrium.status is Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE


def test_the_damped_pendulum_is_asymptotically_stable_below_the_upright_energy():
    report = verify({theta: omega, omega: -omega - sp.sin(theta)}, PENDULUM, box=TURN)
    assert report.certificate.status is Certificate.VALID
    assert sp.expand(report.certificate.V_dot + omega**2) == 0
    assert report.equilibrium.status is Equilibrium.ASYMPTOTICALLY_STABLE
    assert report.equilibrium.level == 2


def test_the_energy_of_the_damped_pendulum_is_not_a_global_certificate():
    report = verify({theta: omega, omega: -omega - sp.sin(theta)}, PENDULUM)
    assert report.certificate.status is Certificate.NOT_POSITIVE_DEFINITE
    assert abs(report.certificate.at[theta]) == 2 * sp.pi
    assert report.equilibrium.status is Equilibrium.ASYMPTOTICALLY_STABLE
    assert 0 < report.equilibrium.level <= 2


def test_invalid_lyapunov_function_gives_no_conclusion_on_the_system():
    report = verify({x: -x, y: -y}, x**2 - y**2)
    assert report.certificate.status is Certificate.NOT_POSITIVE_DEFINITE
    at = report.certificate.at
    assert at[x] ** 2 - at[y] ** 2 == report.certificate.value <= 0
    assert report.equilibrium.status is Equilibrium.NO_CONCLUSION
    assert report.linearisation is Eigenvalues.LEFT


def test_a_claim_is_undecided_when_the_budget_ends():
    report = verify({x: sp.sin(x) ** 2 - x}, x**2, budget=Budget(3))
    assert report.certificate.status is Certificate.UNDECIDED
    assert report.certificate.truth is Truth.UNDECIDED
    assert "budget" in report.certificate.reason
    assert report.equilibrium.status is Equilibrium.NO_CONCLUSION
    assert report.boxes == 3


STABLE: dict[str, tuple[Any, ...]] = {
    "Duffing, damped (Slotine and Li, chapter 3)": (
        {x: v, v: -x - x**3 - v}, v**2 / 2 + x**2 / 2 + x**4 / 4, {}, Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE),
    "Hopf at its bifurcation (Strogatz, 8.2)": (
        {x: -y - x * (x**2 + y**2), y: x - y * (x**2 + y**2)}, x**2 + y**2, {},
        Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE),
    "Lorenz below r = 1 (Strogatz, 9.2)": (
        {x: 10 * (y - x), y: x / 2 - y - x * z, z: x * y - R(8, 3) * z}, x**2 / 10 + y**2 + z**2, {},
        Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE),
    "Van der Pol in reversed time (Khalil, 8.2)": (
        {x: -v, v: x + (x**2 - 1) * v}, x**2 + v**2, {x: (-R(9, 10), R(9, 10)), v: (-1, 1)},
        Equilibrium.ASYMPTOTICALLY_STABLE),
    "V not radially unbounded, not global (Hahn; Khalil, exercise 4.8)": (
        {x: -6 * x / (1 + x**2) ** 2 + 2 * y, y: -2 * (x + y) / (1 + x**2) ** 2}, x**2 / (1 + x**2) + y**2, {},
        Equilibrium.ASYMPTOTICALLY_STABLE),
}  # fmt: skip
UNSTABLE: dict[str, tuple[Any, ...]] = {
    "Van der Pol (Khalil, 2.4)": ({x: v, v: (1 - x**2) * v - x}, x**2 + v**2, {}, "eigenvalue"),
    "the linearisation is silent (Khalil, 4.3)": ({x: x**3}, x**2, {}, "Chetaev"),
    "Chetaev (Khalil, exercises to 4.1)": (
        {x: x**3 + x**2 * y, y: -y + y**2 + x * y - x**3}, x**2 / 2 - y**2 / 2, {}, "Chetaev"),
    "unstable on its centre manifold y = x^2 + ... (Perko, 2.12)": (
        {x: x**2 * y - x**5, y: -y + x**2}, x - (y - x**2) ** 2, {}, "Chetaev"),
    "a body about its middle axis (Euler)": (
        {x: y * z + z, y: -2 * z * x, z: x * (1 + y)}, x**2 + y**2 + z**2, {}, "eigenvalue"),
    "growth on a set that is left (Krasovskii)": (
        {x: v, v: -(x**3) + v**3}, x**4 / 4 + v**2 / 2, {}, "reversed time"),
}  # fmt: skip


@pytest.mark.parametrize("name", STABLE)
def test_textbook_stable_system_is_proven_stable(name):
    f, V, box, verdict = STABLE[name]
    report = verify(f, V, box=box)
    assert report.certificate.status is Certificate.VALID
    assert report.equilibrium.status is verdict


@pytest.mark.parametrize("name", UNSTABLE)
def test_textbook_unstable_system_is_proven_unstable(name):
    f, V, box, theorem = UNSTABLE[name]
    report = verify(f, V, box=box)
    assert report.certificate.status is not Certificate.VALID
    assert report.equilibrium.status is Equilibrium.UNSTABLE
    assert theorem in report.equilibrium.by
    assert report.equilibrium.asymptotic is Truth.REFUTED


def test_an_equilibrium_other_than_the_origin_is_moved_to_it():
    upright = {theta: omega, omega: -omega - sp.sin(theta)}
    moved = PENDULUM.subs(theta, theta - 2 * sp.pi)
    report = verify(upright, moved, at={theta: 2 * sp.pi}, box={theta: (5, 7), omega: (-1, 1)})
    assert report.equilibrium.status is Equilibrium.ASYMPTOTICALLY_STABLE
    assert report.equilibrium.box[theta] == (5, 7)
    assert verify(upright, at={theta: sp.pi}).equilibrium.status is Equilibrium.UNSTABLE


def test_proof_holds_for_all_parameters_within_their_ranges():
    k = sp.Symbol("k")
    assert verify({x: -k * x}, x**2, parameters={k: (R(1, 2), 2)}).certificate.status is Certificate.VALID
    report = verify({x: -k * x}, x**2, parameters={k: (-1, 2)})
    assert report.certificate.status is Certificate.GROWS
    assert report.certificate.at[k] < 0


def test_stability_without_a_lyapunov_function_is_decided_by_the_linearisation():
    assert verify({x: v, v: -x - v}).equilibrium.asymptotic is Truth.PROVEN
    assert verify({x: v, v: -x}).equilibrium.status is Equilibrium.NO_CONCLUSION
    third = {x: y, y: z, z: -k0 * x - y - z}  # Routh: stable where k0 < 1
    assert verify(third).linearisation is Eigenvalues.UNKNOWN
    for side, verdict in (((R(1, 10), R(9, 10)), Eigenvalues.LEFT), ((R(11, 10), 3), Eigenvalues.RIGHT)):
        assert verify(third, parameters={k0: side}).linearisation is verdict


@pytest.mark.parametrize(
    ("f", "options", "words"),
    [
        ({x: 1 - x}, {}, "not shown to be an equilibrium"),
        ({x: -sp.sign(x)}, {}, "continuous"),
        ({x: -sp.Piecewise((x, x > 0), (2 * x, True))}, {}, "Piecewise"),
        ({x: -x * sp.Symbol("t")}, {}, "time"),
        ({x: -x}, {"box": {x: (1, 2)}}, "not inside its box"),
        ({x: -x}, {"box": {x: (2, 1)}}, "lower first"),
        ({x: -m * x}, {"parameters": {m: (0, sp.oo)}}, "has no end"),
        ({}, {}, "no state"),
        ({"x": "-x"}, {}, "not a SymPy symbol"),
        ({x: -x}, {"box": {y: (-1, 1)}}, "which is not a state"),
        ({x: y - x, y: y}, {"at": {x: y}}, "is not a parameter"),
        ({x: 1 - m * x}, {"at": {x: 1 / m}, "box": {x: (0, 5)}}, "it must be a number"),
        ({x: x**3 - x}, {"parameters": {x: (-R(1, 2), R(1, 2))}}, "which is a state"),
        ({x: -x}, {"parameters": {m: (1, 2)}}, "neither f nor V"),
        ({x: -x - x ** (10**9 + 1)}, {}, "exponent beyond 10000"),
        ({x: -(10**1001) * x}, {}, "more than 1000 digits"),
        ({x: -x * sp.Float("1e-2000")}, {}, "more than 1000 digits"),
        ({sp.Symbol("x_{1}"): -sp.Symbol("x_{1}")}, {"box": {y: (-1, 1)}}, "which is not a state"),
    ],
)
def test_invalid_input_of_the_verifier_is_refused_with_the_reason(f, options, words):
    with pytest.raises(ModelError, match=words):
        verify(f, x**2, **options)


@pytest.mark.parametrize(
    ("assumption", "side"),
    [({"negative": True}, None), ({"integer": True}, None), ({"positive": True}, (-1, 1))],
)
def test_parameters_with_stronger_assumptions_than_the_claim_are_refused(assumption, side):
    k = sp.Symbol("k", **assumption)
    with pytest.raises(ModelError, match="assumption"):
        verify({x: -k * x}, x**2, parameters=None if side is None else {k: side})


def test_states_may_be_declared_real_but_not_positive():
    s = sp.Symbol("s", positive=True)  # sympy makes s of sqrt(s^2), which is |s|
    with pytest.raises(ModelError, match="assumption"):
        verify({s: -sp.sqrt(s**2)}, s**2)
    r, k = sp.Symbol("r", real=True), sp.Symbol("k", positive=True)
    assert verify({r: -k * r}, r**2, parameters={k: (1, 2)}).certificate.status is Certificate.VALID


def test_the_report_lists_the_parameters_and_their_ranges():
    report = verify({x: -m * k0 * x}, x**2, parameters={m: (R(1, 2), 2)})
    assert report.parameters == {k0: (0, sp.oo), m: (R(1, 2), 2)}
    assert str(report).endswith("for all k0 > 0, m in [1/2, 2]")
    assert "for all" not in str(verify({x: -x}, x**2))
