"""Invalid V and difficult systems: the verifier may be undecided, but never wrong."""

import itertools
import math
import random

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.proof import Budget, Certificate, Equilibrium, Truth, verify

x, y, z, v, w, k = sp.symbols("x y z v w k")
sin, cos, exp, sqrt, Abs, R = sp.sin, sp.cos, sp.exp, sp.sqrt, sp.Abs, sp.Rational
UNSTABLE, STABLE = "unstable", "stable, not asymptotically"
LOCAL, GLOBAL = "asymptotically, not globally", "globally"
STILL = {Equilibrium.STABLE, Equilibrium.NO_CONCLUSION}
ALLOWED = {
    UNSTABLE: {Equilibrium.UNSTABLE, Equilibrium.NO_CONCLUSION},
    STABLE: STILL,
    LOCAL: STILL | {Equilibrium.ASYMPTOTICALLY_STABLE},
    GLOBAL: STILL | {Equilibrium.ASYMPTOTICALLY_STABLE, Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE},
}
BAD, GOOD = False, True
SYSTEMS = [
    # f, V, what is true of the system, is V (> 0, falling) on the whole space?
    ({x: x**3}, x**4, UNSTABLE, BAD),
    ({x: x**2}, x**2, UNSTABLE, BAD),
    ({x: -(x**2)}, Abs(x) ** 3, UNSTABLE, BAD),
    ({x: -Abs(x)}, x**2, UNSTABLE, BAD),
    ({x: x * Abs(x)}, x**2, UNSTABLE, BAD),
    ({x: x / 10**6 - x**3}, x**2, UNSTABLE, BAD),  # grows within 0.001 only
    ({x: x**3 / 10**6 - x**5}, x**2, UNSTABLE, BAD),
    ({x: -sqrt(Abs(x))}, x**2, UNSTABLE, BAD),  # many solutions from one point
    ({x: -x, y: y**3}, x**2, UNSTABLE, BAD),  # V does not see the state that grows
    ({x: v, v: sp.S.Zero}, v**2, UNSTABLE, BAD),
    ({x: x * y, y: -y + x**2}, x**2 + y**2, UNSTABLE, BAD),
    ({x: v, v: sin(x) - v}, 1 - cos(x) + v**2 / 2, UNSTABLE, BAD),  # about the upright pendulum
    ({x: v, v: x - x**3 - v}, v**2 / 2 + x**4 / 4 - x**2 / 2, UNSTABLE, BAD),
    ({x: exp(x) - 1}, x**2, UNSTABLE, BAD),
    ({x: v, v: -x**3 + v**3}, x**4 / 4 + v**2 / 2, UNSTABLE, BAD),
    ({x: sp.S.Zero}, x**2, STABLE, GOOD),
    ({x: y, y: -x}, x**2 + 2 * y**2, STABLE, BAD),
    ({x: -x, y: sp.S.Zero}, x**2 + y**2, STABLE, GOOD),
    ({x: -x * y**2, y: -y * x**2}, x**2 + y**2, STABLE, GOOD),  # both axes rest
    ({x: v, v: -v}, v**2 + (x + v) ** 2, STABLE, GOOD),
    ({x: v, v: -v}, v**2, STABLE, BAD),
    ({x: -x, y: z, z: -y}, x**2 + y**2 + z**2, STABLE, GOOD),  # a centre within dV/dt = 0
    ({x: v, v: -x - v, y: w, w: -y}, x**2 + v**2 + y**2 + w**2, STABLE, GOOD),
    ({x: y**3, y: -(x**3)}, x**4 + y**4, STABLE, GOOD),
    ({x: v * cos(y) ** 2 + v * sin(y) ** 2 - v, y: -y, v: -v}, x**2 + v**2 + y**2, STABLE, GOOD),
    ({x: -x, y: z, z: -y - x**2 * z**3}, x**2 + y**2 + z**2, STABLE, GOOD),  # the damping dies out
    ({x: v, v: -x - v * Abs(x - 1 + Abs(x - 1))}, x**2 + v**2, STABLE, GOOD),  # no damping below 1
    ({x: v, v: -x - v * (x**2 + v**2 - 1) ** 2}, x**2 + v**2, LOCAL, GOOD),  # a cycle within dV/dt = 0
    ({x: -x + x**3}, x**2, LOCAL, BAD),
    ({x: -x + x**3 / 10**6}, x**2, LOCAL, BAD),
    ({x: -sin(x)}, x**2, LOCAL, BAD),
    ({x: -x / (1 - x)}, x**2, LOCAL, BAD),  # a pole
    ({x: y - x * (1 - x**2 - y**2), y: -x - y * (1 - x**2 - y**2)}, x**2 + y**2, LOCAL, BAD),
    ({x: -x, y: -y}, (x - y) ** 2, GLOBAL, BAD),
    ({x: -x, y: -y}, (x - y**2) ** 2, GLOBAL, BAD),  # zero on a parabola
    ({x: -x, y: -y}, (x - y**2) ** 2 - y**6 / 10**3, GLOBAL, BAD),
    ({x: -x, y: -y}, x**4 * y**2 + x**2 * y**4 - 3 * x**2 * y**2 + x**6, GLOBAL, BAD),
    ({x: -x, y: -y}, x**2 * y**2, GLOBAL, BAD),
    ({x: -x, y: -y}, x**2 + y**2 + x**2 * y**2 - 3 * x * y, GLOBAL, BAD),
    ({x: -x}, 1 + x**2, GLOBAL, BAD),
    ({x: -x}, x**3, GLOBAL, BAD),
    ({x: -x}, Abs(x), GLOBAL, BAD),  # not C1
    ({x: -x}, x**2 - x**4, GLOBAL, BAD),
    ({x: -x}, 10**9 * x**2 - x**4, GLOBAL, BAD),
    ({x: -x}, x**2 * exp(-(x**2)), GLOBAL, BAD),
    ({x: -x}, x**2 / (1 + x**2), GLOBAL, GOOD),  # not radially unbounded
    ({x: -x + R(21, 10) * y, y: -y}, x**2 + y**2, GLOBAL, BAD),
    ({x: y, y: z, z: -x - 2 * y - z}, x**2 + y**2 + z**2, STABLE, BAD),
    ({x: v, v: -k * x - v}, k * x**2 / 2 - v**2 / 2, GLOBAL, BAD),
]  # fmt: skip


@pytest.mark.parametrize(("f", "V", "truth", "good"), SYSTEMS, ids=lambda a: str(a).replace(" ", "")[:60])
def test_no_false_claim_is_proven_and_no_true_claim_is_refuted(f, V, truth, good):
    report = verify(f, V, budget=Budget(3000))
    assert report.equilibrium.status in ALLOWED[truth]
    assert (report.equilibrium.asymptotic is not Truth.PROVEN) or truth in {LOCAL, GLOBAL}
    assert (report.equilibrium.asymptotic is not Truth.REFUTED) or truth in {UNSTABLE, STABLE}
    assert report.certificate.truth is not (Truth.REFUTED if good else Truth.PROVEN)
    _check_counterexample(f, V, report.certificate)


def _check_counterexample(f, V, certificate):
    if certificate.at is None:
        return
    real = {s: sp.Symbol(str(s), real=True) for s in {*f, *V.free_symbols}}
    at = {real[s]: value for s, value in certificate.at.items()}
    V = V.xreplace(real)
    V_dot = sum(sp.diff(V, real[s]) * e.xreplace(real) for s, e in f.items())
    if certificate.status is Certificate.GROWS:
        assert V_dot.subs(at).evalf(60) > 0
    else:
        assert V.subs(at).evalf(60) <= 0 or V.subs(dict.fromkeys(real.values(), 0)) != 0


@pytest.mark.parametrize(
    "zero",
    [
        16 * sp.atan(R(1, 5)) - 4 * sp.atan(R(1, 239)) - sp.pi,
        sum(cos(k * sp.pi / 7) for k in (1, 3, 5)) - R(1, 2),
    ],
)
def test_zero_that_symbolic_algebra_does_not_recognise_is_not_a_counterexample(zero):  # Machin's and Gauss's
    for V, truth in ((x**2 + zero, Truth.UNDECIDED), (x**2 + zero + R(1, 10**6), Truth.REFUTED)):
        assert verify({x: -x}, V).certificate.truth is truth


def test_a_counterexample_lies_in_the_box():
    f, V = {x: v, v: -v - sin(x)}, 1 - cos(x) + v**2 / 2  # zero at 2 pi too
    report = verify(f, V, box={x: (-3, 3)})
    assert report.certificate.status is Certificate.VALID
    assert report.equilibrium.status is Equilibrium.ASYMPTOTICALLY_STABLE  # and not globally: x has ends
    for end, verdict in ((1, Certificate.NOT_POSITIVE_DEFINITE), (R(999, 1000), Certificate.VALID)):
        edge = verify({x: sp.S.Zero}, x**2 * (1 - x), box={x: (-1, end)})
        assert edge.certificate.status is verdict


def test_a_pole_of_f_that_cancels_in_dV_dt_is_found():
    f = {x: -x + y / (x - R(1, 2)), y: -y - x / (x - R(1, 2))}
    report = verify(f, x**2 + y**2, box={x: (-1, 1), y: (-1, 1)})
    assert report.certificate.status is Certificate.UNDECIDED
    assert report.equilibrium.status is Equilibrium.ASYMPTOTICALLY_STABLE  # on a box without the pole
    assert report.equilibrium.box[x][1] < R(1, 2)


def test_a_narrow_negative_dip_of_V_is_not_overlooked():
    dip = R(141421, 10**5)
    V = x**2 * ((x - dip) ** 2 - R(1, 10**10))  # negative on a stretch of 2e-5
    report = verify({x: -x}, V, box={x: (-2, 2)})
    assert report.certificate.status is not Certificate.VALID
    raised = x**2 * ((x - dip) ** 2 + R(1, 10**4))
    assert verify({x: sp.S.Zero}, raised, box={x: (-2, 2)}).certificate.status is Certificate.VALID


@pytest.mark.parametrize(
    ("f", "V", "status"),
    [
        ({x: x / 10**6 - x**3}, x**2, Certificate.GROWS),  # within 0.001 only
        ({x: x**3 / 10**6 - x**5}, x**2, Certificate.GROWS),
        ({x: -x, y: y / 10**6 - y**3}, x**2 + x * y + y**2, Certificate.GROWS),
        (
            {x: -x, y: -y},
            (x**2 + y**2) * ((x - R(7, 5)) ** 2 + (y - R(3, 5)) ** 2 - R(1, 100)),
            Certificate.NOT_POSITIVE_DEFINITE,
        ),
    ],
)
def test_claims_false_only_near_the_origin_or_off_the_axes_are_refuted(f, V, status):
    report = verify(f, V)
    assert report.certificate.status is status
    _check_counterexample(f, V, report.certificate)


TERMS = [
    x, y, x * y, x**2, y**2, x**3, y**3, x**2 * y, x * y**2,
    sin(x), sin(y), 1 - cos(x), x * Abs(x), y * Abs(y),
]  # fmt: skip
BOWLS = [x**2, y**2, x**4, y**4, x * y, 1 - cos(x), x**2 * y**2, Abs(y) ** 3, x**3, sin(y) ** 2]


def _sum(terms):
    return st.lists(
        st.tuples(st.sampled_from(terms), st.sampled_from([-2, -1, R(1, 2), 1, 2])), min_size=1, max_size=3
    ).map(lambda parts: sum(c * e for e, c in parts))


@settings(max_examples=6, derandomize=True, database=None)
@given(_sum(TERMS), _sum(TERMS), st.lists(_sum(BOWLS), min_size=2, max_size=2))
@pytest.mark.long
def test_proven_lyapunov_functions_hold_at_random_points_and_never_contradict_each_other(dx, dy, candidates):
    f = {x: dx, y: dy}
    box = {x: (-1, 1), y: (-1, 1)}
    said = []
    for V in [*candidates, x**2 + y**2]:
        report = verify(f, V, box=box, budget=Budget(1500))
        said.append(report.equilibrium)
        _check_counterexample(f, sp.sympify(V), report.certificate)
        if report.certificate.status is Certificate.VALID:
            _holds_at_random_points(f, V)
    _do_not_contradict(said)


def _holds_at_random_points(f, V):
    g = sp.lambdify((x, y), V, "math")
    rates = [sp.lambdify((x, y), e, "math") for e in f.values()]
    chance = random.Random(1)
    for scale in (1.0, 1e-1, 1e-2):
        for _ in range(60):
            a, c = (chance.uniform(-scale, scale) for _ in range(2))
            assert g(a, c) > 0
            norm = max(1.0, *(abs(r(a, c)) for r in rates))
            step = 1e-6 * scale / norm  # a difference along the trajectory, not the derivative under test
            ahead, behind = ((a + s * rates[0](a, c), c + s * rates[1](a, c)) for s in (step, -step))
            assert g(*ahead) - g(*behind) <= 1e-9 * step * norm + 4e-16 * g(a, c) + 1e-18


def _do_not_contradict(said):
    stable = {
        Equilibrium.STABLE,
        Equilibrium.ASYMPTOTICALLY_STABLE,
        Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE,
    }
    for one, other in itertools.permutations(said, 2):
        assert not (one.status is Equilibrium.UNSTABLE and other.status in stable)
        assert not (one.asymptotic is Truth.PROVEN and other.asymptotic is Truth.REFUTED)


@settings(max_examples=15, derandomize=True, database=None)
@given(st.lists(st.integers(-3, 3), min_size=9, max_size=9))
def test_eigenvalue_findings_of_random_matrices_match_lapack(entries):
    A = np.array(entries).reshape(3, 3)
    states = (x, y, z)
    f = {
        s: sum(int(a) * q for a, q in zip(row, states, strict=True)) for s, row in zip(states, A, strict=True)
    }
    report = verify({s: sp.sympify(e) for s, e in f.items()})
    right = max(np.linalg.eigvals(A).real)
    if right > 1e-4:
        assert report.equilibrium.status is Equilibrium.UNSTABLE
    elif right < -1e-4:
        assert report.equilibrium.status is Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE  # it is linear
    assert not math.isnan(right)
