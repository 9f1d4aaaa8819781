"""Calibration of one sensor against the motion of the legs, by weighted nonlinear least squares.

Gauss-Newton steps in the directions of the unknowns that the motion determines; the others keep the values
of a perfect sensor. Standard errors allow for coloured residuals (`body_fit.coloured_covariance`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import IdentificationError
from hil.lab.identify.estimators.body_fit import coloured_covariance
from hil.lab.identify.estimators.leg_motion import PlatformMotion, all_under
from hil.lab.identify.estimators.sensor_models import SensorModel, motion_at

FEWEST_SAMPLES = 200
OUTLIER = 5.0
"""Standard deviations beyond which a sample is left out."""
MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
FAINT = 0.3
"""Standard error, in sizes of the unknowns, above which a direction is not determined."""
ROUNDS = 8
STEP = 1e-4
"""Step of the differences, in sizes of the unknowns."""
SETTLED = 1e-6
"""Last step, in sizes of the unknowns."""
FINEST = 1e-9
"""Least standard deviation of a residual, SI: below it are errors of the forward kinematics."""


class Samples(NamedTuple):
    """Samples of one role, a row each."""

    values: Array
    """(m, k) SI, NaN for a quantity that the device does not give."""
    t_s: Array
    """(m, 1), or (m, 6) for a device a leg: stated instants, s after the first row; NaN: no sample."""


class Fit(NamedTuple):
    """Identified parameters of a sensor, in SI, in the order of the model."""

    x: Array
    std: Array
    """Standard errors."""
    unknown: Array
    """Share of each parameter, 0 to 1, in directions that the motion does not determine."""
    used: int
    left_out: int
    """Outliers."""


def fit(model: SensorModel, motion: PlatformMotion, period_s: float, samples: Samples, gravity: Array) -> Fit:
    """Fit the unknowns of a model to samples. Raises IdentificationError for too few samples."""
    row = np.rint(samples.t_s / period_s)
    inside = (row >= 1) & (row <= len(motion.p) - 2)
    near = inside & all_under(1, motion.good)[np.where(inside, row, 0).astype(np.int64)]
    kept = near.any(axis=1)
    if kept.sum() < FEWEST_SAMPLES:
        raise IdentificationError(
            f"{int(kept.sum())} samples with open brakes and fresh legs, allowed: at least {FEWEST_SAMPLES}"
        )
    y, near = samples.values[kept], near[kept]
    t = np.where(near, samples.t_s[kept], 0.0)

    def residual(z: Array) -> Array:
        x = model.start + model.size * z
        return model.residual(motion_at(motion, t - x[0], period_s), y, x[1:], gravity)

    z = np.zeros(len(model.size))
    r = residual(z)
    every = near & np.isfinite(r)
    good = every
    for _ in range(ROUNDS):
        there = good
        spread = MAD * np.nanmedian(np.where(there, np.abs(r), np.nan), axis=0)
        weight = np.where(there, 1.0 / np.fmax(spread, FINEST), 0.0)
        A, e = _jacobian(residual, z, weight), (np.where(there, r, 0.0) * weight).ravel()
        size, V = np.linalg.eigh(A.T @ A)
        shown, hidden = V[:, size > FAINT**-2], V[:, size <= FAINT**-2]
        step = shown @ np.linalg.lstsq(A @ shown, e, rcond=None)[0]
        z = z - step
        r = residual(z)
        usual = np.abs(r) * weight.max(axis=0) < OUTLIER
        good = every & (usual if t.shape[1] > 1 else (usual | ~every).all(axis=1, keepdims=True))
        if np.abs(step).max() < SETTLED:
            break
    flat = there.ravel()
    T = model.size[:, None] * shown
    instant = np.repeat(np.arange(len(r)), r.shape[1])[flat]
    covariance = T @ coloured_covariance(A[flat] @ shown, e[flat], instant) @ T.T
    used = int(there.any(axis=1).sum())
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Fit(model.start + model.size * z, std, (hidden**2).sum(axis=1), used, len(r) - used)


def _jacobian(residual: Callable[[Array], Array], z: Array, weight: Array) -> Array:
    """Derivatives (m k, n) of the weighted residual, by central differences."""
    steps = STEP * np.eye(len(z))
    columns = [(residual(z + h) - residual(z - h)) / (2.0 * STEP) for h in steps]
    return np.stack([np.where(weight > 0.0, c, 0.0) * weight for c in columns], axis=-1).reshape(-1, len(z))
