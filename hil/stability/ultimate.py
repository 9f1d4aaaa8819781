"""The ultimate bound of a linearised robot: from a load in N and a model's error to mm of each axis.

::

    e'' + Gamma (K_D de + K_P e) = -d      (hil.stability.disturbance)

- Gamma = gamma I: six axes with the gains gamma K_P and gamma K_D, |e_i| <= error_gain_i max |d_i| by the
  reachable ellipsoid of each (hil.stability.error_dynamics).
- What Gamma differs from gamma I by is a disturbance of its own, S |u|, S = max |Gamma - gamma I|. With g_i
  the peak gain from d_i to u_i, |d + (Gamma - gamma I) u| <= (I - S diag(g))^-1 |d|, if all eigenvalues of
  the non-negative S diag(g) are below 1 (small gain; C. A. Desoer and M. Vidyasagar, Feedback Systems, 1975).
- d and Gamma are those of where the robot is, not of where it should be. So they are taken in a tube around
  the reference, too, which is enlarged until the bound that follows is no larger than the tube: what begins
  without error can then not leave it. The errors that occur are convolutions of the disturbances that
  occur. Where all axes have the same gains, they are in error_gain times the convex hull of these, and its
  extremes along the reference are the tube; else it is the box |e_i| <= bound_i. Both are looked at in
  their corners at the worst instants, to first order: a survey, no enclosure.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.stability.disturbance import Linearised, Survey, along, around, summary
from hil.stability.error_dynamics import Certificate, certificate
from hil.stability.reachable import peak_gain
from hil.trajectory.path import PoseSample

ROUNDS = 12
"""Most enlargements of the tube."""
EXACT = 1e-9
"""What Gamma may differ from gamma I by and count as rounding."""
INSTANTS = 5
"""Of the reference, at which the disturbances are taken that make the tube."""
_SIGNS = np.array([[1.0 if k >> i & 1 else -1.0 for i in range(6)] for k in range(64)])


class Ultimate(NamedTuple):
    """What holds along a reference, of each axis."""

    certificate: Certificate
    """Of the gains that the robot really has, gamma K_P and gamma K_D."""
    gamma: float
    exact: bool
    """Whether Gamma = gamma I, so that the certificate's decay is the robot's."""
    d: Array
    """(6,) m/s^2 or rad/s^2, all that disturbs the axis."""
    error: Array
    """(6,) m or rad: |e| never exceeds it from a start without error, and from anywhere near in the end."""
    rate: Array
    """(6,) m/s or rad/s, likewise."""
    least_error: Array
    """(6,) m or rad, what some disturbance of this size brings about: no bound for all is smaller."""
    condition: float
    """Of J, the largest in the tube."""


def ultimate(
    linearised: Linearised, path: Sequence[PoseSample], K_P: Array, K_D: Array, *, condition: float
) -> Ultimate | str:
    """Return the bound along a path sampled in `path`, K_P (6,) 1/s^2 and K_D (6,) 1/s; or why there is none.

    condition: of J, what the tube may not exceed.
    """
    found_along = along(linearised, path)
    reference = summary(found_along)
    worst = {int(np.argmax([local.d[i] for local in found_along])) for i in range(6)}
    samples = [path[k] for k in sorted(worst)]
    every = max(1, len(path) // INSTANTS)
    extremes = np.vstack([local.extremes for local in found_along[::every]])
    equal = len(set(K_P)) == len(set(K_D)) == 1
    found = _bound(reference, K_P, K_D)
    for _ in range(ROUNDS):
        if isinstance(found, str) or not found.d.max() > 1e-9:
            return found
        if found.condition > condition:
            return (
                f"the bound, {1e3 * found.error.max():.3g} mm or mrad, reaches poses where the condition of "
                f"J is {found.condition:.3g}, allowed: {condition:g}"
            )
        shape = _normalised(extremes) if equal else _SIGNS
        before = found
        tube = around(linearised, samples, 1.02 * before.error * shape, 1.02 * before.rate * shape)
        found = _bound(_both(reference, summary(tube)), K_P, K_D)
        if not isinstance(found, str) and (found.error <= 1.02 * before.error).all():
            return found
    return "the disturbance grows with the error as fast as the law answers it"


def _normalised(extremes: Array) -> Array:
    """Return each column over its largest magnitude; zero where nothing disturbs."""
    largest = np.abs(extremes).max(axis=0)
    shape = np.divide(extremes, largest, out=np.zeros_like(extremes), where=largest > 1e-9)
    return np.asarray(shape, float)


def _bound(s: Survey, K_P: Array, K_D: Array) -> Ultimate | str:
    if not np.isfinite(s.d).all():
        return "the bound reaches a singularity of J"
    if s.gamma <= 0.0:
        return "the believed inertia is so wrong that forces push the wrong way"
    proved = certificate(s.gamma * K_P, s.gamma * K_D)
    d, exact = s.d, bool(s.spread.max() <= EXACT)
    if not exact:
        pairs = list(zip(proved.K_P, proved.K_D, K_P, K_D, strict=True))
        g = np.array([peak_gain(*(float(v) for v in pair)) for pair in pairs])
        loop = s.spread * g
        size = float(np.abs(np.linalg.eigvals(loop)).max())
        if size >= 1.0:
            return (
                f"the believed inertia differs too much for the gains: small gain {size:.2g}, allowed below 1"
            )
        d = np.linalg.solve(np.eye(6) - loop, d)
    error, rate = proved.error_gain() * d, proved.rate_gain() * d
    least = np.array([peak_gain(float(p), float(v)) for p, v in zip(proved.K_P, proved.K_D, strict=True)])
    return Ultimate(proved, s.gamma, exact, d, error, rate, least * d, s.condition)


def _both(a: Survey, b: Survey) -> Survey:
    """Return what covers both surveys."""
    gamma = (a.gamma + b.gamma) / 2.0
    shift = abs(a.gamma - b.gamma) / 2.0
    spread = np.maximum(a.spread, b.spread) + (shift if shift > 1e-12 else 0.0) * np.eye(6)
    return Survey(np.maximum(a.d, b.d), gamma, spread, max(a.condition, b.condition))
