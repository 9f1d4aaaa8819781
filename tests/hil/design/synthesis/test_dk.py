import numpy as np
import pytest

from drivers.errors import SynthesisError
from hil.design.synthesis.dk import bounds_over_frequency, dk_iteration, inverse, minimum_phase, with_own
from hil.design.synthesis.mu import Block
from hil.design.synthesis.structured import Structured
from hil.mathematics.linear_system import LinearSystem

OMEGA = np.geomspace(0.1, 1e4, 120)
S = 1j * OMEGA


@pytest.mark.parametrize(("zeros", "poles"), [((30.0,), (400.0,)), ((900.0, 20.0), (100.0, 300.0))])
def test_a_scale_is_found_again_from_its_magnitude(zeros, poles):
    d = 0.02 * np.prod([S + z for z in zeros], axis=0) / np.prod([S + p for p in poles], axis=0)
    fit = minimum_phase(OMEGA, np.abs(d), len(zeros), (5.0, 2000.0), np.ones(120))
    assert fit.response(OMEGA)[:, 0, 0] == pytest.approx(d, rel=1e-4)


def test_a_scale_is_stable_with_a_stable_inverse_and_stays_within_its_frequencies():
    magnitude = 1.0 / OMEGA  # no rational function of order 1 is
    fit = minimum_phase(OMEGA, magnitude, 1, (5.0, 2000.0), np.ones(120))
    back = inverse(fit)
    for poles in (fit.poles(), back.poles()):
        assert (poles.real <= -5.0 * (1 - 1e-9)).all()
        assert (poles.real >= -2000.0 * (1 + 1e-9)).all()
    assert back.after(fit).response(OMEGA)[:, 0, 0] == pytest.approx(np.ones(120), rel=1e-9)


def test_what_counts_more_is_fitted_better():
    magnitude = OMEGA**-0.5 + 0.01 * OMEGA**0.5
    low, high = np.where(OMEGA < 10.0, 1.0, 0.01), np.where(OMEGA > 1000.0, 1.0, 0.01)
    off = [
        np.abs(np.log(np.abs(fit.response(OMEGA)[:, 0, 0]) / magnitude))
        for fit in (minimum_phase(OMEGA, magnitude, 1, (0.1, 1e4), weight) for weight in (low, high))
    ]
    assert off[0][OMEGA < 10.0].max() < 0.5 * off[1][OMEGA < 10.0].max()
    assert off[1][OMEGA > 1000.0].max() < 0.7 * off[0][OMEGA > 1000.0].max()


def test_the_grid_is_refined_around_the_peak():
    """A resonance of damping 0.01 between two frequencies of the grid: 50 at 100 rad/s."""
    A, B = np.array([[-2.0, -1e4], [1.0, 0.0]]), np.array([[1.0], [0.0]])
    M = LinearSystem(A, B, np.array([[0.0, 1e4]]), np.zeros((1, 1)))
    coarse = np.geomspace(10.0, 900.0, 14)
    found = bounds_over_frequency(M, [Block()], coarse)
    assert np.abs(M.response(coarse)).max() < 4.0
    assert found.peak > 20.0
    assert found.peak_rad_s == pytest.approx(100.0, rel=0.02)
    assert (np.diff(found.omega) > 0).all()


def test_a_peak_between_the_frequencies_of_the_grid_and_one_at_rest_are_not_missed():
    """A resonance of damping 1e-5: 5e4 at 100 rad/s; and 1 / (s + 0.001) rises to 1000 far below the grid."""
    coarse = np.geomspace(10.0, 900.0, 14)
    one, zero = np.eye(1), np.zeros((1, 1))
    sharp = LinearSystem(
        np.array([[-2e-3, -1e4], [1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[0.0, 1e4]]), zero
    )
    assert bounds_over_frequency(sharp, [Block()], coarse).peak < 1000.0
    seen = bounds_over_frequency(sharp, [Block()], with_own(coarse, sharp))
    assert seen.peak == pytest.approx(5e4, rel=1e-3)
    slow = LinearSystem(-1e-3 * one, one, one, zero)
    seen = bounds_over_frequency(slow, [Block()], with_own(coarse, slow))
    assert seen.peak == pytest.approx(1000.0, rel=1e-3)


def test_a_loop_without_control_over_its_uncertainty_is_refused():
    """z = 1.5 w around a plant that no u reaches: mu is 1.5 with any controller."""
    A, zero = np.array([[-1.0]]), np.zeros((1, 1))
    # [w, d, n, u] -> [z, e, u, y]; x' = -x + d + u
    B, C = np.array([[0.0, 1.0, 0.0, 1.0]]), np.array([[0.0], [1.0], [0.0], [1.0]])
    D = np.zeros((4, 4))
    D[0, 0], D[2, 3], D[3, 2] = 1.5, 1.0, 1.0
    problem = Structured(LinearSystem(A, B, C, D), [Block(), Block(2, 2)], 1)
    K = LinearSystem(-np.eye(1), np.eye(1), zero, zero)
    lines: list[str] = []
    with pytest.raises(SynthesisError, match=r"mu is not below 1\.5\d* after"):
        dk_iteration(problem, K, OMEGA, (1.0, 100.0), lines.append)
    assert len(lines) > 1
