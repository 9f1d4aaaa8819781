"""Masses and friction by weighted least squares of leg forces, and the nearest physically possible body.

Each leg is weighted by the variance of its residual. Regressors are projected onto their instruments, so
errors of the length readings bias nothing, not even through the law (two-stage least squares; W. A. Fuller,
Measurement Error Models, 1987, ch. 1). Unknowns are scaled by the platform's own size. A direction of the
unknowns counts as hidden (not observable), and keeps its configured value, in two cases: its standard
deviation would exceed FAINT of that size, or its instruments are WEAK.

Residuals are coloured: filtered noise, and errors of the model. Standard errors follow from the products of
residuals and regressors, expanded in the lowest terms of a cosine series over the whole log, which do not
leak (U. K. Mueller, J. Econometrics 141, 2007; Y. Sun, Econometrics J. 16, 2013). So noise that grows with
frequency counts at the frequencies of the motion, not at its own.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from drivers.arrays import Array, Ints
from drivers.errors import IdentificationError
from hil.lab.identify.estimators.leg_equations import Equations
from hil.lab.identify.estimators.rigid_body import SIZE, from_pseudo_inertia, pseudo_inertia
from hil.robot.geometry import Platform

WEIGHT = 9.81
"""m/s^2: scales a mass to a force; not the gravity of a model."""
FAINT = 0.3
"""Standard deviation, relative to the platform's size, above which a direction is hidden."""
WEAK = 10.0
"""F statistic of the first stage below which instruments are weak (D. Staiger and J. H. Stock, Econometrica
65, 1997).
"""
SERIES, FEW, ALIKE = 96, 32, 2.0
"""Terms of the cosine series, degrees of freedom of an error over its standard error. Only the first 32 are
used if the others exceed them more than two-fold: those overstate noise that grows with frequency.
"""
FEWEST_SAMPLES = 100
ROUNDS = 3
"""Rounds of weighting by the residuals."""


class Estimate(NamedTuple):
    """Least-squares estimate of platform and drive parameters, before the constraint to a possible body."""

    theta: Array
    """(29,) parameters, in the order of the columns of `Equations`."""
    covariance: Array
    """(29, 29), of the shown directions only: hidden ones have no finite standard deviation."""
    shown: Array
    """(29, k) columns: directions of theta / scale that the motion shows."""
    hidden: Array
    """(29, h) columns: directions that the motion does not show."""
    condition: float
    """Condition number of the columns, each scaled to unit length."""
    residual_N: Array
    """(6,) N, rms residual of each leg, or (12,) with load cells: then those of the drives."""
    root: Array
    """(29, 29): |root (theta - x)|^2 is the increase of the weighted sum of squares from theta to x."""
    scale: Array
    """(29,) typical size of each parameter, see `unknowns_scale`."""
    samples: int

    @property
    def std(self) -> Array:
        """Standard errors (29,) of the parameters; for a partly unobservable one, of its observable part."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def unknown(self) -> Array:
        """Share of each parameter (29,), 0 to 1, in directions that the motion does not show."""
        return np.asarray((self.hidden**2).sum(axis=1), np.float64)


def unknowns_scale(platform: Platform) -> Array:
    """Sizes (29,): mass m; m r; inertia m r^2; friction: weight / 6 at 1 m/s; delay 1 ms; mass m / 6."""
    m, r = platform.platform.mass, platform.radius
    return np.array([m, *3 * (m * r,), *6 * (m * r * r,), *12 * (m * WEIGHT / 6.0,), 1e-3, *6 * (m / 6.0,)])


def solve(equations: Equations, believed: Array, scale: Array) -> Estimate:
    """Solve the leg equations of all logs for the parameters (29,) by weighted least squares.

    believed (29,): configured values, kept in unobservable directions; scale: `unknowns_scale`. Raises
    IdentificationError: too few samples.
    """
    count = np.bincount(equations.leg, minlength=6)
    if count.min() < FEWEST_SAMPLES:
        raise IdentificationError(
            f"too little motion: leg {int(count.argmin()) % 6} has {count.min()} usable samples (brakes "
            f"open, encoder fresh, moving one way), allowed: at least {FEWEST_SAMPLES}; log a longer motion"
        )
    X, W = equations.A * scale, equations.instruments * scale
    rest = equations.y - equations.A @ believed
    weight = np.ones(len(count))
    for _ in range(ROUNDS):
        w = weight[equations.leg]
        led = _projected(X * w[:, None], W * w[:, None])
        shown, hidden = _directions(led, X * w[:, None] - led)
        z = np.linalg.lstsq(led @ shown, rest * w, rcond=None)[0]
        theta = believed + scale * (shown @ z)
        residual = equations.y - equations.A @ theta
        rms = np.array([np.sqrt(np.mean(residual[equations.leg == leg] ** 2)) for leg in range(len(count))])
        weight = 1.0 / np.maximum(rms, 1e-9 * np.abs(equations.y).max())
    w = weight[equations.leg]
    A, y = equations.A * w[:, None], equations.y * w
    led = _projected(X * w[:, None], W * w[:, None])
    spread = coloured_covariance(led @ shown, y - A @ theta, equations.sample)
    root = np.asarray(np.linalg.qr(led / scale, mode="r"), np.float64)
    columns = A[:, A.any(axis=0)]
    columns = columns / np.linalg.norm(columns, axis=0)
    T = scale[:, None] * shown
    return Estimate(
        theta, T @ spread @ T.T, shown, hidden, float(np.linalg.cond(columns)), rms,
        root, scale, len(np.unique(equations.sample)),
    )  # fmt: skip


def _projected(X: Array, W: Array) -> Array:
    """Columns of X (m, n) projected onto the column space of W (m, n)."""
    return np.asarray(W @ np.linalg.lstsq(W, X, rcond=None)[0], np.float64)


def _directions(led: Array, rest: Array) -> tuple[Array, Array]:
    """Orthonormal columns of the observable and the unobservable directions of the parameters.

    led (m, n): part of the weighted regressors that the instruments explain; rest (m, n): part that they do
    not; the residual has unit variance.
    """
    m, n = led.shape
    _, s, Vt = np.linalg.svd(led, full_matrices=False)
    noise = np.linalg.norm(rest @ Vt.T, axis=0) / np.sqrt(max(m - n, 1))
    seen = (s * FAINT > 1.0) & (s**2 > WEAK * n * noise**2)
    return Vt[seen].T, Vt[~seen].T


def coloured_covariance(Z: Array, residual: Array, sample: Ints) -> Array:
    """Covariance (k, k) of the least squares of Z x = y with coloured residuals (m,).

    A^-1 (mean over j of L_j L_j^T) A^-1, A = Z^T Z, L_j = sqrt(2) sum_t cos(pi j (t - 1/2) / n) s_t with the
    scores s_t = sum of Z^T residual over the rows of one instant, j = 1 .. SERIES. The factor m / (m - k)
    accounts for the k fitted unknowns.
    """
    m, k = Z.shape
    instant = np.unique(sample, return_inverse=True)[1]
    scores = np.zeros((int(instant.max()) + 1, k))
    np.add.at(scores, instant, Z * residual[:, None])
    n = len(scores)
    j = np.arange(1, SERIES + 1)[:, None]
    L = np.sqrt(2.0) * np.cos(np.pi * j * (np.arange(n) + 0.5) / n) @ scores
    half = np.linalg.solve(Z.T @ Z, L.T)
    first, rest = ((part**2).mean(axis=1) for part in (half[:, :FEW], half[:, FEW:]))
    if np.mean(rest / first) > ALIKE:
        half = half[:, :FEW]
    return np.asarray(half @ half.T / half.shape[1] * (m / max(m - k, 1)), np.float64)


def prediction_error(equations: Equations, theta: Array) -> float:
    """Rms residual, N, of the leg equations with parameters theta (29,)."""
    return float(np.sqrt(np.mean((equations.y - equations.A @ theta) ** 2)))


def halves(equations: Equations) -> list[Equations]:
    """Split equations into those of the first and of the second half of the log's time."""
    first = equations.sample <= np.median(equations.sample)
    return [equations.part(first), equations.part(~first)]


LEAST = 1e-9
"""Smallest eigenvalue at the start of the search, relative to the largest."""
_POWERS = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
_LOWER = np.tril_indices(4)


class Consistent(NamedTuple):
    """Estimate of platform and drive parameters, constrained to a physically possible body."""

    theta: Array
    """(29,) parameters, constrained to a possible body."""
    smallest: float
    """Smallest eigenvalue of the unconstrained pseudo-inertia, lengths in radii, kg.

    If <= 0, no body has it, and `theta` is that of the nearest body.
    """
    shift: float
    """Largest change by the constraint along a shown direction, in standard errors."""


def consistent(estimate: Estimate, radius: float, carrier: Array | None = None) -> Consistent:
    """Least squares constrained to physically possible bodies.

    The pseudo-inertia is the carrier's plus L L^T, L lower triangular, so no constraint is needed (after C.
    Rucker and P. M. Wensing, IEEE Robotics and Automation Letters 7(2), 2022). Unobservable directions stay
    as configured, as far as a body permits. Friction and reflected masses are further unknowns without
    bounds: with an imperfect model, the estimate of a zero friction may be negative, and a bound would push
    that error into the inertia.

    estimate: unconstrained least squares. radius: m, makes the lengths of the pseudo-inertia comparable.
    carrier (10,): a known body; the rest on top of it must be a possible body by itself.
    """
    base = np.zeros(SIZE) if carrier is None else carrier
    own = (estimate.theta[:SIZE] - base) / radius**_POWERS
    smallest = float(np.linalg.eigvalsh(pseudo_inertia(own))[0])
    if smallest > 0.0:
        return Consistent(estimate.theta, smallest, 0.0)
    scale = estimate.scale
    unit = float(np.abs(own).max())
    H = estimate.hidden.T / scale

    def theta_of(x: Array) -> Array:
        theta, L = estimate.theta.copy(), np.zeros((4, 4))
        L[_LOWER] = x[:SIZE]
        theta[:SIZE] = base + unit * from_pseudo_inertia(L @ L.T) * radius**_POWERS
        theta[SIZE:] = x[SIZE:] * scale[SIZE:]
        return theta

    def residual(x: Array) -> Array:
        change = theta_of(x) - estimate.theta
        return np.concatenate([estimate.root @ change, H @ change])

    values, vectors = np.linalg.eigh(pseudo_inertia(own / unit))
    values = np.maximum(values, LEAST * np.abs(values).max())
    nearest = np.linalg.cholesky(vectors * values @ vectors.T)
    begin = np.concatenate([nearest[_LOWER], estimate.theta[SIZE:] / scale[SIZE:]])
    fit = least_squares(residual, begin, x_scale="jac", max_nfev=500)
    theta, to_shown = theta_of(fit.x), estimate.shown.T / scale
    variance = np.diag(to_shown @ estimate.covariance @ to_shown.T)
    shift = np.abs(to_shown @ (theta - estimate.theta)) / np.sqrt(np.maximum(variance, 1e-24))
    return Consistent(theta, smallest, float(shift.max(initial=0.0)))
