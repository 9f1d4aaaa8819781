"""D-K iteration: a controller for the worst case of a structured uncertainty.

mu of the closed loop cannot be minimised directly. The largest singular value of D M(K) D^-1 is an upper
bound. The bound is convex in D for a given K, and an H-infinity problem in K for a given D. The iteration
alternates both steps, from the controller of the nominal problem on (Doyle 1985; Zhou, Doyle and Glover 1996,
section 11.4). The iteration may end in a local optimum.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from drivers.arrays import Array, ComplexArray
from drivers.errors import SynthesisError
from hil.design.synthesis import mu
from hil.design.synthesis.hinf import hinf
from hil.design.synthesis.mu import Block, UpperBound, upper_bound
from hil.design.synthesis.structured import Structured
from hil.mathematics.linear_system import LinearSystem, static

ROUNDS = 10
GAIN = 0.003
"""Smallest relative decrease of mu that allows another round."""


class Bounds(NamedTuple):
    """Upper bound on the structured singular value mu of a loop over frequency."""

    omega: Array
    """(N,) rad/s, frequencies, refined around the peak."""
    upper: UpperBound

    @property
    def peak(self) -> float:
        """Largest upper bound on mu over all frequencies."""
        return float(self.upper.bound.max())

    @property
    def peak_rad_s(self) -> float:
        """Frequency, rad/s, at which the upper bound on mu is largest."""
        return float(self.omega[self.upper.bound.argmax()])


class Iterated(NamedTuple):
    """The controller u = K y with the smallest mu found, and the progress of the iteration."""

    K: LinearSystem
    bounds: Bounds
    history: list[float]
    """Peak of the upper bound on mu after each round."""


def bounds_over_frequency(M: LinearSystem, blocks: list[Block], omega: Array) -> Bounds:
    """Upper bounds on mu of M at the frequencies `omega` and at 16 more around the peak."""
    k = int(upper_bound(M.response(omega), blocks).bound.argmax())
    finer = np.geomspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], 18)[1:-1]
    omega = np.sort(np.concatenate([omega, finer[~np.isclose(finer, omega[k], rtol=1e-9)]]))
    return Bounds(omega, upper_bound(M.response(omega), blocks))


def with_own(omega: Array, M: LinearSystem) -> Array:
    """Frequencies `omega`, those of M's poles, where a bound can be sharp, and a quasi-static one, sorted.

    The quasi-static frequency is a hundredth of the slowest pole. M is stable.
    """
    own = np.abs(M.poles())
    return np.unique(np.concatenate([omega, own, [0.01 * own.min()]]))


def fitted_scales(
    M: LinearSystem, found: Bounds, blocks: list[Block], within: tuple[float, float]
) -> list[LinearSystem]:
    """First-order d(s) for each uncertain block, fitted in magnitude to the scales found by `upper_bound`."""
    weight = _matters(M.response(found.omega), found, blocks)
    return [
        minimum_phase(found.omega, found.upper.D[:, i], within, weight[:, i]) for i in range(len(blocks) - 1)
    ]


def minimum_phase(omega: Array, magnitude: Array, within: tuple[float, float], weight: Array) -> LinearSystem:
    """First-order g (s + z) / (s + p), z and p > 0, with |d(j omega)| fitted to `magnitude` in decibels.

    z and p stay `within` two frequencies, rad/s. `weight` (N,) of each frequency.
    """
    target = np.log(magnitude)
    low, high = np.log(within)

    def off(x: Array) -> Array:
        zero, pole = 0.5 * np.log(omega[:, None] ** 2 + np.exp(2.0 * x[1:])).T
        return np.asarray(weight * (x[0] + zero - pole - target), float)

    middle = 0.5 * (low + high)
    start = [np.average(target, weights=weight), middle, middle - 0.05 * (high - low)]
    g, z, p = np.exp(least_squares(off, start, bounds=([-np.inf, low, low], [np.inf, high, high])).x)
    return LinearSystem(np.array([[-p]]), np.array([[g]]), np.array([[z - p]]), np.array([[g]]))


def inverse(d: LinearSystem) -> LinearSystem:
    """System 1 / d(s) of a d(s) whose feed-through is not zero."""
    E: Array = np.asarray(np.linalg.inv(d.D), float)
    return LinearSystem(d.A - d.B @ E @ d.C, d.B @ E, -E @ d.C, E)


def scaled(problem: Structured, scales: list[LinearSystem]) -> LinearSystem:
    """Plant with scale d(s) on the output and 1 / d(s) on the input of each uncertain block."""
    left = right = static(np.zeros((0, 0)))
    for d in scales:
        left, right = left.beside(d), right.beside(inverse(d))
    rest_out = problem.plant.C.shape[0] - len(scales)
    rest_in = problem.plant.B.shape[1] - len(scales)
    widened = left.beside(static(np.eye(rest_out))).after(problem.plant)
    return widened.after(right.beside(static(np.eye(rest_in))))


def dk_iteration(
    problem: Structured,
    K: LinearSystem,
    omega: Array,
    within: tuple[float, float],
    progress: Callable[[str], None],
) -> Iterated:
    """Find the controller with the smallest upper bound on mu by D-K iteration.

    Parameters
    ----------
    K : initial controller, must stabilise the plant
    omega : (N,) grid of mu, rad/s
    within : range of zeros and poles of the scales, rad/s
    progress : callback for one line per round

    Raises SynthesisError if mu stays at 1 or above, and the errors of `hinf`.
    """
    M = problem.plant.closed_with(K)
    found = bounds_over_frequency(M, problem.blocks, omega)
    progress(f"without uncertainty: mu <= {found.peak:.3f} at {found.peak_rad_s:.0f} rad/s")
    best = Iterated(K, found, [found.peak])
    for k in range(ROUNDS):
        scales = fitted_scales(M, found, problem.blocks, within)
        made = hinf(scaled(problem, scales), problem.n_y, 1)
        M = problem.plant.closed_with(made.K)
        found = bounds_over_frequency(M, problem.blocks, omega)
        history = [*best.history, found.peak]
        progress(
            f"round {k + 1}: gamma {made.gamma:.3f}, mu <= {found.peak:.3f} at {found.peak_rad_s:.0f} rad/s"
        )
        falls = found.peak < (1.0 - GAIN) * best.bounds.peak
        if found.peak < best.bounds.peak:
            best = Iterated(made.K, found, history)
        best = best._replace(history=history)
        if not falls:
            break
    if best.bounds.peak >= 1.0:
        raise SynthesisError(
            f"mu is not below {best.bounds.peak:.3f} after {len(best.history) - 1} rounds, with its peak at "
            f"{best.bounds.peak_rad_s:.0f} rad/s, allowed: below 1; relax the weights (weights.error, "
            "weights.control) or narrow the uncertainty"
        )
    return best


def _matters(M: ComplexArray, found: Bounds, blocks: list[Block]) -> Array:
    """Relative rise of the bound over its peak for a scale that is wrong by a factor of 1.5.

    (N, blocks - 1); the square root, because the fit squares it. Where a scale has little effect, mainly at
    low frequency, its fit may be poor.
    """
    rise = np.zeros((len(M), len(blocks) - 1))
    for i in range(len(blocks) - 1):
        for factor in (1.5, 1.0 / 1.5):
            D = found.upper.D.copy()
            D[:, i] *= factor
            sigma = np.linalg.svd(mu.scaled(M, D, blocks), compute_uv=False)[:, 0]
            rise[:, i] += np.maximum(sigma - found.upper.bound, 0.0) / found.peak
    return np.sqrt(rise * (found.upper.bound / found.peak)[:, None] ** 2) + 1e-4
