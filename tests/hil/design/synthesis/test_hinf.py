"""H-infinity synthesis: optima in closed form, and optima of slycot."""

from __future__ import annotations

from math import sqrt

import control
import numpy as np
import pytest

from drivers.errors import SynthesisError
from hil.design.synthesis.hinf import hinf
from hil.mathematics.linear_system import LinearSystem


def scalar(a):
    """x' = a x + w1 + u, z = [x, u], y = x + w2."""
    A, B = np.array([[a]]), np.array([[1.0, 0.0, 1.0]])
    C, D = np.array([[1.0], [0.0], [1.0]]), np.array([[0.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    return LinearSystem(A, B, C, D)


@pytest.mark.parametrize("a", [-2.0, -0.3, 0.0, 1.0, 5.0])
def test_the_optimum_of_a_first_order_plant_has_its_closed_form(a):
    """Both equations are 2 a X + (1 / gamma^2 - 1) X^2 + 1 = 0; X Y = gamma^2 gives gamma^2 = 2 a gamma + 2."""
    assert hinf(scalar(a), 1, 1).gamma_opt == pytest.approx(a + sqrt(a * a + 2.0), rel=1e-5)


def coprime(A, B, C):
    """w = [at the plant's input, at its output], z = [y, u]: D11 is not zero."""
    n = len(A)
    zero, one = np.zeros((n, 1)), np.eye(1)
    D = np.block([[0 * one, one, 0 * one], [0 * one, 0 * one, one], [0 * one, one, 0 * one]])
    return LinearSystem(A, np.hstack([B, zero, B]), np.vstack([C, np.zeros((1, n)), C]), D)


def test_the_optimum_of_the_double_integrator_has_its_closed_form():
    """sqrt(1 + lambda_max(X Z)), X = Z = [[sqrt 2, 1], [1, sqrt 2]]: Glover and McFarlane (1989)."""
    A, B, C = np.array([[0.0, 1], [0, 0]]), np.array([[0.0], [1]]), np.array([[1.0, 0]])
    found = hinf(coprime(A, B, C), 1, 1, 1.05)
    assert found.gamma_opt == pytest.approx(sqrt(4.0 + 2.0 * sqrt(2.0)), rel=1e-5)


def samples():
    rng = np.random.default_rng(7)
    found = []
    for k in range(8):
        n, m1, m2, p1, p2 = (int(rng.integers(*ends)) for ends in ((2, 6), (2, 4), (1, 3), (2, 4), (1, 3)))
        m2, p2 = min(m2, p1), min(p2, m1)
        A, B, C = (rng.normal(size=size) for size in ((n, n), (n, m1 + m2), (p1 + p2, n)))
        D = rng.normal(size=(p1 + p2, m1 + m2))
        D[p1:, m1:] = 0.0
        if k % 2:
            D[:p1, :m1] = 0.0
        found.append((LinearSystem(A, B, C, D), p2, m2))
    return found


@pytest.mark.parametrize("case", [2, 3, 5])
def test_the_optima_of_random_plants_match_slycot(case):
    pytest.importorskip("slycot")
    P, n_y, n_u = samples()[case]
    *_, gamma, _ = control.hinfsyn(control.ss(*P[:4]), n_y, n_u)
    assert hinf(P, n_y, n_u).gamma_opt == pytest.approx(gamma, rel=1e-5)


def double_integrator(B1, D12, D21, C2=((1.0, 0.0),), B2=((0.0,), (1.0,))):
    """z = [x1, u], w = [d, n]."""
    A = np.array([[0.0, 1.0], [0.0, 0.0]])
    B = np.hstack([np.array(B1, float), np.array(B2)])
    C = np.vstack([[[1.0, 0.0], [0.0, 0.0]], np.array(C2)])
    D = np.zeros((3, 3))
    D[1, 2], D[2, 1] = D12, D21
    return LinearSystem(A, B, C, D)


DISTURBED = ((0, 0), (1, 0))
UNDISTURBED = ((0, 0), (0, 0))


@pytest.mark.parametrize(
    ("P", "says"),
    [
        (double_integrator(DISTURBED, 0.0, 1.0), "D12 has no full column rank"),
        (double_integrator(DISTURBED, 1.0, 0.0), "D21 has no full row rank"),
        (double_integrator(UNDISTURBED, 1.0, 1.0), "ill posed: not excited by w"),
        (double_integrator(DISTURBED, 1.0, 1.0, B2=((0.0,), (0.0,))), "not controllable by u"),
        (double_integrator(DISTURBED, 1.0, 1.0, C2=((0.0, 0.0),)), "not observable in y"),
        (double_integrator(DISTURBED, 1.0, 1.0)._replace(period_s=1e-3), "sampled"),
        (double_integrator(((0, 0), (np.nan, 0)), 1.0, 1.0), "not finite"),
    ],
)
def test_a_plant_that_violates_an_assumption_is_refused_with_the_reason(P, says):
    with pytest.raises(SynthesisError, match=says):
        hinf(P, 1, 1)
