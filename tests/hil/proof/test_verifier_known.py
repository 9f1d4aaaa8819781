"""Sixty systems of known stability: half unstable, a third with parameter names that SymPy uses itself."""

import pytest
import sympy as sp

from hil.proof import Certificate, Equilibrium, Truth, verify

x, y, z, v, w = sp.symbols("x y z v w")
s, t, L, E, X, I, N, S, Q = sp.symbols("s t lambda E X I N S Q")
a, b, c = sp.symbols("a b c")
R, sin, cos, tanh, exp, Abs = sp.Rational, sp.sin, sp.cos, sp.tanh, sp.exp, sp.Abs
U, M, A, G = "unstable", "stable, not asymptotically", "asymptotically, not globally", "globally"
BOX = {"box": {x: (-R(1, 2), R(1, 2)), v: (-R(1, 2), R(1, 2))}}
ENERGY = x**2 / 2 + v**2 / 2
KNOWN = [
    # f, V, what is true, options
    ({x: s * x}, None, U, {}),
    ({x: -s * x}, x**2, G, {}),
    ({x: t * x}, None, U, {"parameters": {t: (1, 2)}}),
    ({x: -t * x}, None, G, {"parameters": {t: (1, 2)}}),
    ({x: v, v: L * v - x}, ENERGY, U, {}),
    ({x: v, v: -L * v - x}, ENERGY, G, {}),
    ({x: E * x - y, y: x + E * y}, x**2 + y**2, U, {}),
    ({x: -E * x - y, y: x - E * y}, x**2 + y**2, G, {}),
    ({x: v, v: X * x - v}, None, U, {}),
    ({x: v, v: -X * x - v}, None, G, {}),
    ({x: I * x + y, y: -N * y}, x**2 + y**2, U, {}),
    ({x: -I * x + y, y: -N * y}, None, G, {}),
    ({x: S * y, y: Q * x}, x**2 + y**2, U, {}),
    ({x: S * y, y: -Q * x}, Q * x**2 + S * y**2, M, {}),
    ({x: v, v: -s * x - E * x**3 - L * v}, s * x**2 / 2 + E * x**4 / 4 + v**2 / 2, G, {}),
    ({x: v, v: s * x - E * x**3 - L * v}, v**2 / 2 - s * x**2 / 2 + E * x**4 / 4, U, {}),
    ({x: v, v: -S * sin(x) - N * v}, S * (1 - cos(x)) + v**2 / 2, A, BOX),
    ({x: v, v: S * sin(x) - N * v}, S * (1 - cos(x)) + v**2 / 2, U, BOX),
    ({x: -s * x**3}, x**2, G, {}),
    ({x: s * x**3}, x**2, U, {}),
    ({x: y, y: z, z: -s * x - s * y - s * z}, None, G, {"parameters": {s: (2, 3)}}),
    ({x: y, y: z, z: -s * x - s * y - s * z}, None, U, {"parameters": {s: (R(1, 4), R(3, 4))}}),
    ({x: x}, x**2, U, {}),
    ({x: x**2}, x**2, U, {}),
    ({x: x, y: -y}, x**2 + y**2, U, {}),
    ({x: -x, y: y, z: -z}, x**2 + y**2 + z**2, U, {}),
    ({x: y, y: x}, x**2 + y**2, U, {}),
    ({x: v, v: -x + v / 10**30}, ENERGY, U, {}),
    ({x: v, v: -x - v / 10**30}, ENERGY, G, {}),
    ({x: v, v: v * (1 - x**2) - x}, ENERGY, U, {}),
    ({x: v, v: -v * (1 - x**2) - x}, ENERGY, A, BOX),
    ({x: v, v: sin(x) - v}, None, U, {}),
    ({x: v, v: -sin(x) - v}, None, A, {}),
    ({x: v, v: -sin(x)}, 1 - cos(x) + v**2 / 2, M, BOX),
    ({x: x * (1 - x)}, None, U, {}),
    ({x: x * (1 - x)}, None, A, {"at": {x: 1}}),
    ({x: 10 * (y - x), y: 28 * x - y - x * z, z: x * y - R(8, 3) * z}, x**2 + y**2 + z**2, U, {}),
    ({x: 10 * (y - x), y: x / 2 - y - x * z, z: x * y - R(8, 3) * z}, x**2 / 10 + y**2 + z**2, G, {}),
    ({x: y * z, y: -2 * x * z, z: x * y}, x**2 + y**2 + z**2, M, {}),
    ({x: x**3 + x * y**2, y: y**3}, x**2 + y**2, U, {}),
    ({x: -(x**3) + y, y: -x - y**3}, x**2 + y**2, G, {}),
    ({x: x**3 + y, y: -x + y**3}, x**2 + y**2, U, {}),
    ({x: -tanh(x)}, x**2, G, {}),
    ({x: tanh(x)}, x**2, U, {}),
    ({x: exp(x) - 1}, x**2, U, {}),
    ({x: -x / (1 + x**2)}, x**2, G, {}),
    ({x: x / (1 + x**2)}, x**2, U, {}),
    ({x: v, v: -x - v * Abs(v)}, ENERGY, G, {}),
    ({x: v, v: -x + v * Abs(v)}, ENERGY, U, {}),
    ({x: v, v: -(x**3) - v}, x**4 / 4 + v**2 / 2, G, {}),
    ({x: v, v: x**3 - v}, v**2 / 2 - x**4 / 4, U, {}),
    ({x: -x + y, y: -y, z: z}, None, U, {}),
    ({x: -x, y: sp.S.Zero}, x**2 + y**2, M, {}),
    ({x: v, v: -x, y: w, w: -4 * y}, x**2 + v**2 + 4 * y**2 + w**2, M, {}),
    ({x: v, v: -2 * x + y, y: w, w: x - 2 * y + w}, None, U, {}),
    ({x: v, v: -2 * x + y - v, y: w, w: x - 2 * y}, x**2 - x * y + y**2 + v**2 / 2 + w**2 / 2, G, {}),
    ({x: y - x * (1 - x**2 - y**2), y: -x - y * (1 - x**2 - y**2)}, None, A, {}),
    ({x: y + x * (1 - x**2 - y**2), y: -x + y * (1 - x**2 - y**2)}, None, U, {}),
    ({x: 0.3 * y + 0.1 * x, y: -0.3 * x + 0.1 * y}, x**2 + y**2, U, {}),
    ({x: 0.3 * y - 0.1 * x, y: -0.3 * x - 0.1 * y}, x**2 + y**2, G, {}),
]  # fmt: skip
ALLOWED = {
    U: {Equilibrium.UNSTABLE},
    M: {Equilibrium.STABLE},
    A: {Equilibrium.STABLE, Equilibrium.ASYMPTOTICALLY_STABLE},
    G: {Equilibrium.STABLE, Equilibrium.ASYMPTOTICALLY_STABLE, Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE},
}
ASYMPTOTIC = {U: Truth.REFUTED, M: Truth.REFUTED, A: Truth.PROVEN, G: Truth.PROVEN}


def decided(case):
    """True if asymptotic stability is proven or refuted; asserts that no finding is false."""
    f, V, truth, options = case
    report = verify(f, V, **options)
    assert report.equilibrium.status in ALLOWED[truth] | {Equilibrium.NO_CONCLUSION}
    assert report.equilibrium.asymptotic in {ASYMPTOTIC[truth], Truth.UNDECIDED}
    if truth == U:
        assert report.certificate.status is not Certificate.VALID
    return report.equilibrium.asymptotic is not Truth.UNDECIDED


@pytest.mark.parametrize("case", KNOWN[::4], ids=lambda case: str(case[0]))
def test_a_system_of_known_stability_is_decided_correctly(case):
    assert decided(case)


@pytest.mark.long
def test_all_systems_of_known_stability_are_decided_correctly():
    assert sum(map(decided, KNOWN)) >= 59
