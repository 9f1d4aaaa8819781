"""The H-infinity norm: closed forms, a dense grid, a peer."""

from __future__ import annotations

from math import log, pi, sqrt

import control
import numpy as np
import pytest

from drivers.errors import SynthesisError
from hil.design.synthesis.norm import gains, norm
from hil.mathematics.linear_system import LinearSystem, static


@pytest.mark.parametrize("zeta", [0.001, 0.1, 0.5])
def test_a_resonance_has_the_height_and_place_of_the_closed_form(zeta):
    system = LinearSystem(
        np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]]),
        np.array([[0.0], [1.0]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )
    found = norm(system)
    assert found.value == pytest.approx(1.0 / (2.0 * zeta * sqrt(1.0 - zeta**2)), rel=3e-6)
    assert found.omega == pytest.approx(sqrt(1.0 - 2.0 * zeta**2), rel=1e-2)


@pytest.mark.parametrize(("pole", "omega"), [(0.9, 0.0), (-0.9, pi / 1e-3)])
def test_a_sampled_lag_has_its_norm_at_rest_or_at_the_nyquist_frequency(pole, omega):
    one = np.eye(1)
    found = norm(LinearSystem(pole * one, one, one, 0 * one, 1e-3))
    assert found.value == pytest.approx(10.0, rel=1e-6)
    assert found.omega == pytest.approx(omega, abs=1e-3)


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
def test_the_norm_is_the_top_of_a_dense_grid(seed, period_s):
    system = random(seed, period_s)
    end = log(1e3) if period_s is None else log(pi / period_s)
    top = gains(system, np.exp(np.linspace(end - log(1e6), end, 8_000))).max()
    assert top * (1.0 - 1e-9) <= norm(system).value <= top * (1.0 + 1e-3)


@pytest.mark.parametrize("period_s", [None, 1e-3])
@pytest.mark.parametrize("seed", range(3))
def test_the_norm_is_the_one_that_slycot_finds(seed, period_s):
    pytest.importorskip("slycot")
    system = random(seed, period_s)
    peer = control.linfnorm(control.ss(*system[:4], 0 if period_s is None else 1.0))[0]
    assert norm(system).value == pytest.approx(peer, rel=1e-5)


def test_a_gain_has_its_own_norm_and_an_unstable_system_none():
    assert norm(static(np.diag([2.0, -3.0]))).value == pytest.approx(3.0)
    one = np.eye(1)
    for unstable in (LinearSystem(0 * one, one, one, one), LinearSystem(one, one, one, one, 1e-3)):
        with pytest.raises(SynthesisError, match="not stable"):
            norm(unstable)
