"""The body nearest to an estimate: one whose pseudo-inertia is positive definite."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from drivers.arrays import Array
from hil.lab.identify.estimators.least_squares import Estimate
from hil.lab.identify.estimators.rigid_body import (
    SIZE,
    from_log_cholesky,
    from_pseudo_inertia,
    log_cholesky,
    pseudo_inertia,
)

LEAST = 1e-9
"""Smallest eigenvalue from which the search begins, of the largest there is."""
FARTHEST = 15.0
"""Bound of the logarithms: a body may be as thin as exp(-15) of the platform."""
_POWERS = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])


class Consistent(NamedTuple):
    """An estimate that a body can have."""

    theta: Array
    """(29,)."""
    smallest: float
    """Smallest eigenvalue of the pseudo-inertia that least squares alone gave, lengths in radii, kg; <= 0: no
    body has it, and `theta` is another one."""
    shift: float
    """Largest change for that along a direction that the motion shows, in standard errors."""


def consistent(estimate: Estimate, radius: float, carrier: Array | None = None) -> Consistent:
    """Return the least squares among bodies.

    The pseudo-inertia is that of the carrier plus one in log-Cholesky form, so no constraint is needed (C.
    Rucker and P. M. Wensing, IEEE Robotics and Automation Letters 7(2), 2022). Directions that the motion
    does not show stay as believed, as far as a body can. Friction and reflected masses are unknowns
    beside it, without bounds: what a model error leaves of a friction of zero may be negative, and a bound
    would push that into the inertia.

    Parameters
    ----------
    estimate : least squares alone.
    radius : m, makes the lengths of the pseudo-inertia comparable.
    carrier : (10,), a body that is known: what comes on top of it has to be a body by itself. Default none.
    """
    base = np.zeros(SIZE) if carrier is None else carrier
    own = (estimate.theta[:SIZE] - base) / radius**_POWERS
    smallest = float(np.linalg.eigvalsh(pseudo_inertia(own))[0])
    if smallest > 0.0:
        return Consistent(estimate.theta, smallest, 0.0)
    scale, n = estimate.scale, int(estimate.free[SIZE:].sum())
    unit = float(np.abs(own).max())
    H = estimate.hidden.T / scale

    def theta_of(x: Array) -> Array:
        theta = estimate.theta.copy()
        theta[:SIZE] = base + unit * from_log_cholesky(x[:SIZE]) * radius**_POWERS
        theta[SIZE : SIZE + n] = x[SIZE:] * scale[SIZE : SIZE + n]
        return theta

    def residual(x: Array) -> Array:
        change = theta_of(x) - estimate.theta
        return np.concatenate([estimate.root @ change, H @ change])

    begin = np.concatenate([
        np.clip(log_cholesky(_nearest(own / unit)), 1e-3 - FARTHEST, FARTHEST - 1e-3),
        estimate.theta[SIZE : SIZE + n] / scale[SIZE : SIZE + n],
    ])  # fmt: skip
    end = np.full(SIZE + n, np.inf)
    end[:4] = FARTHEST  # a, d1, d2, d3
    fit = least_squares(residual, begin, bounds=(-end, end), x_scale="jac", max_nfev=500)
    theta = theta_of(fit.x)
    return Consistent(theta, smallest, _shift(estimate, theta))


def _shift(estimate: Estimate, theta: Array) -> float:
    """Return how far theta (29,) is off, in standard errors of the directions that the motion shows."""
    to_shown = estimate.shown.T / estimate.scale
    variance = np.diag(to_shown @ estimate.covariance @ to_shown.T)
    change = np.abs(to_shown @ (theta - estimate.theta))
    return float((change / np.sqrt(np.maximum(variance, 1e-24))).max(initial=0.0))


def _nearest(theta: Array) -> Array:
    """Return theta with a positive definite pseudo-inertia: too small eigenvalues are raised."""
    values, vectors = np.linalg.eigh(pseudo_inertia(theta))
    values = np.maximum(values, LEAST * np.abs(values).max())
    return from_pseudo_inertia(vectors @ np.diag(values) @ vectors.T)
