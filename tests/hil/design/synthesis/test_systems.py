"""Systems of a synthesis: the axis, norms and block diagrams, against closed forms and slycot."""

from __future__ import annotations

from math import sqrt

import control
import numpy as np
import pytest

from drivers.errors import SynthesisError
from hil.config.design import DesignAxis
from hil.design.synthesis.axis import actuator, four_block, pade, sampled_axis
from hil.design.synthesis.norm import norm
from hil.design.synthesis.structured import wired
from hil.mathematics.linear_system import LinearSystem, static

INPUTS = ["error", "rate_error"]


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_pade_approximation_delays_and_does_not_amplify(order):
    T = 2e-3
    omega = np.array([0.0, 10.0, 400.0])
    found = pade(T, order).response(omega)[:, 0, 0]
    np.testing.assert_allclose(np.abs(found), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.angle(found), -omega * T, atol=0.05)
    assert np.angle(found[1]) == pytest.approx(-10.0 * T, abs=1e-6)


def test_the_four_block_problem_matches_its_transfer_functions():
    """e = -(d + a) / s^2, y = [e, e'] + n, at one frequency by hand."""
    path = actuator(DesignAxis(gain=0.9, transport_ms=0.5, lag_ms=0.796), 1000.0, 2)
    s = 1j * 50.0
    a = path.response(np.array([50.0]))[0, 0, 0]
    e_d, e_u = -1.0 / s**2, -a / s**2
    expected = [[e_d, 0, 0, e_u], [0, 0, 0, 1], [e_d, 1, 0, e_u], [s * e_d, 0, 1, s * e_u]]
    found = four_block(path, INPUTS).response(np.array([50.0]))[0]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("transport_ms", [0.0, 0.5, 1.0, 1.3, 2.0])
@pytest.mark.parametrize("lag_ms", [0.0, 0.8])
def test_the_step_response_of_the_sampled_axis_has_its_closed_form(transport_ms, lag_ms):
    h, T, L = 1e-3, 1e-3 * transport_ms, 1e-3 * lag_ms
    axis = sampled_axis(DesignAxis(gain=2.0, transport_ms=transport_ms, lag_ms=lag_ms), 1.0 / h, INPUTS)
    x = np.zeros(axis.order)
    for k in range(12):
        t = max(k * h - T, 0.0)
        fade = np.exp(-t / L) if L else 0.0
        position, rate = t * t / 2 - L * t + L * L * (1.0 - fade), t - L * (1.0 - fade)
        np.testing.assert_allclose(axis.C @ x, [-2.0 * position, -2.0 * position, -2.0 * rate], atol=1e-17)
        x = axis.A @ x + axis.B[:, 1]


@pytest.mark.parametrize("zeta", [0.001, 0.1, 0.5])
def test_hinf_norm_of_a_resonance_has_its_closed_form(zeta):
    system = LinearSystem(
        np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]]),
        np.array([[0.0], [1.0]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )
    assert norm(system) == pytest.approx(1.0 / (2.0 * zeta * sqrt(1.0 - zeta**2)), rel=3e-6)


def random(seed, period_s=None):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(6, 6))
    if period_s is None:
        A -= (np.linalg.eigvals(A).real.max() + 0.05) * np.eye(6)
    else:
        A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
    return LinearSystem(
        A, rng.normal(size=(6, 2)), rng.normal(size=(3, 6)), 0.1 * rng.normal(size=(3, 2)), period_s
    )


@pytest.mark.parametrize("period_s", [None, 1e-3])
@pytest.mark.parametrize("seed", range(3))
def test_hinf_norm_of_random_systems_matches_slycot(seed, period_s):
    pytest.importorskip("slycot")
    system = random(seed, period_s)
    peer = control.linfnorm(control.ss(*system[:4], 0 if period_s is None else 1.0))[0]
    assert norm(system) == pytest.approx(peer, rel=1e-5)


def test_hinf_norm_of_a_static_gain_is_exact_and_of_an_unstable_system_refused():
    assert norm(static(np.diag([2.0, -3.0]))) == pytest.approx(3.0)
    one = np.eye(1)
    for unstable in (LinearSystem(0 * one, one, one, one), LinearSystem(one, one, one, one, 1e-3)):
        with pytest.raises(SynthesisError, match="not stable"):
            norm(unstable)


OMEGA = np.geomspace(0.1, 1e3, 30)
S = 1j * OMEGA


def first_order(pole: float, gain: float = 1.0, through: float = 0.0) -> LinearSystem:
    return LinearSystem(np.array([[-pole]]), np.eye(1), np.array([[gain]]), np.array([[through]]))


def test_a_wired_block_diagram_has_the_response_computed_by_hand():
    parts = {"a": (first_order(3.0), {"r": 1.0, "b": -2.0}), "b": (first_order(5.0), {"a": 1.0, "d": 1.0})}
    G = wired(parts, ["r", "d"], [{"b": 1.0}, {"a": 1.0, "r": 1.0}]).response(OMEGA)
    a, b = 1.0 / (S + 3.0), 1.0 / (S + 5.0)
    back = 1.0 + 2.0 * a * b
    expected = np.array([[a * b / back, b / back], [a / back + 1.0, -2.0 * a * b / back]]).transpose(2, 0, 1)
    assert pytest.approx(expected, rel=1e-10) == G
