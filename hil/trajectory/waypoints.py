"""Paths through way-points at given times, without LAPACK, whose last bit depends on the processor."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.config.reference import WaypointReference
from hil.trajectory.path import coordinates_of_points
from hil.trajectory.piecewise import DEGREE, PiecewisePolynomial

CUBIC = (0.0, 0.0, 3.0, -2.0, 0.0, 0.0)
QUINTIC = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)
"""Coefficients of the scaling function s(u), s(0) = 0, s(1) = 1, with speed 0 at both ends."""
SAME = 1e-9
"""Largest distance, m or rad, between first and last point of a repeated path."""


def rest_to_rest(s: tuple[float, ...], t: Array, chi: Array) -> Array:  # noqa: ARG001
    """Coefficients (n - 1, 6, 6) of straight segments with rest at each of chi (n, 6); s: path share s(u)."""
    coefficients = np.array(s)[None, :, None] * np.diff(chi, axis=0)[:, None, :]
    coefficients[:, 0, :] = chi[:-1]
    return coefficients


def knot_motion(t: Array, y: Array) -> tuple[Array, Array]:
    """Velocities and accelerations (n, m) of the minimum-jerk path through y (n, m) at t (n,).

    The path minimises the integral of the squared third derivative, at rest at both ends. Stationarity makes
    it quintic between the knots, with continuous third and fourth derivative at the inner ones (T. Flash, N.
    Hogan, The coordination of arm movements, J. Neuroscience 5(7), 1985, appendix). A quintic of length h and
    rise D with end motion (v0, a0), (v1, a1) has the third derivative times h^3, the fourth times h^4,

    - 60 D - 36 v0 h - 24 v1 h - 9 a0 h^2 + 3 a1 h^2 and -360 D + 192 v0 h + 168 v1 h + 36 a0 h^2 - 24 a1 h^2
      at its start,
    - 60 D - 24 v0 h - 36 v1 h - 3 a0 h^2 + 9 a1 h^2 and 360 D - 168 v0 h - 192 v1 h - 24 a0 h^2 + 36 a1 h^2
      at its end.

    The conditions at the inner knots are a symmetric positive definite block tridiagonal system in (v, a)
    with 2 x 2 blocks. The system is solved by block elimination, which needs no pivoting.
    """
    n = len(t)
    v, a = np.zeros_like(y), np.zeros_like(y)
    h, D = np.diff(t), np.diff(y, axis=0)
    blocks: list[Array] = []
    rights: list[Array] = []
    for k in range(1, n - 1):
        i, j = 1.0 / float(h[k - 1]), 1.0 / float(h[k])
        off = 36.0 * (j * j - i * i)
        block = np.array([[192.0 * (i * i * i + j * j * j), off], [off, 9.0 * (i + j)]])
        before, after = i * i * i * D[k - 1], j * j * j * D[k]
        right = np.array([360.0 * (i * before + j * after), 60.0 * (after - before)])
        if k > 1:  # the knot before is eliminated: its block is C, ours to it C^T
            C = _coupling(float(h[k - 1]))
            factor = _times(C.T, _inverse(blocks[-1]))
            block = block - _times(factor, C)
            right = right - _times(factor, rights[-1])
        blocks.append(block)
        rights.append(right)
    found = np.zeros((2, y.shape[1]))
    for k in range(n - 2, 0, -1):
        right = rights[k - 1] - _times(_coupling(float(h[k])), found)
        found = _times(_inverse(blocks[k - 1]), right)
        v[k], a[k] = found
    return v, a


def _coupling(h: float) -> Array:
    """Block of the linear system that couples a knot with (v, a) of the next knot, h seconds later."""
    i = 1.0 / h
    return np.array([[168.0 * i * i * i, -24.0 * i * i], [24.0 * i * i, -3.0 * i]])


def _inverse(A: Array) -> Array:
    determinant = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    adjugate = np.array([[A[1, 1], -A[0, 1]], [-A[1, 0], A[0, 0]]])
    return np.asarray(adjugate / determinant)


def _times(A: Array, B: Array) -> Array:
    """Product of A (2, 2) and B (2, m), summed in a fixed order so that all processors round alike."""
    return np.stack([A[i, 0] * B[0] + A[i, 1] * B[1] for i in range(2)])


def minimum_jerk_coefficients(t: Array, y: Array) -> Array:
    """Coefficients (n - 1, 6, m) [segment, power, axis], in normalised time, of the minimum-jerk path."""
    v, a = knot_motion(t, y)
    h = np.diff(t)[:, None]
    D, v0, v1 = np.diff(y, axis=0), v[:-1] * h, v[1:] * h
    a0, a1 = a[:-1] * (h * h), a[1:] * (h * h)
    coefficients = np.empty((len(t) - 1, DEGREE + 1, y.shape[1]))
    coefficients[:, 0] = y[:-1]
    coefficients[:, 1] = v0
    coefficients[:, 2] = 0.5 * a0
    coefficients[:, 3] = 10.0 * D - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    coefficients[:, 4] = -15.0 * D + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
    coefficients[:, 5] = 6.0 * D - 3.0 * (v0 + v1) - 0.5 * (a0 - a1)
    return coefficients


INTERPOLATIONS: dict[str, Callable[[Array, Array], Array]] = {
    "cubic": partial(rest_to_rest, CUBIC),
    "quintic": partial(rest_to_rest, QUINTIC),
    "minimum_jerk": minimum_jerk_coefficients,
}
"""Name -> coefficients [segment, power, axis] from times (n,) and points (n, 6)."""


def require_closed(chi: Array, periods: int | None, where: str) -> None:
    """Raise ConfigurationError, at key `where`, if a repeated path chi (n, 6) does not end at its start."""
    gap = float(np.max(np.abs(chi[-1] - chi[0])))
    if periods != 1 and gap > SAME:
        raise ConfigurationError(
            f"{where}: periods is {'null' if periods is None else periods}, but the path ends {gap:.3g} m or "
            "rad away from its start, so a repeat would jump. Let it end where it starts, or set periods: 1."
        )


def waypoint_trajectory(settings: WaypointReference) -> PiecewisePolynomial:
    """Path through the points; it holds until the first point's time.

    Cubic and quintic rest at every point: chi_k + (chi_k+1 - chi_k) s(u). Minimum jerk rests at the first
    and the last one. The rotation vector is interpolated like the position. Raises ConfigurationError if the
    times do not increase, or a repeated path does not close.
    """
    times = [point.t_s for point in settings.points]
    for k, (t0, t1) in enumerate(pairwise(times)):
        if not t1 > t0:
            raise ConfigurationError(
                f"reference.points[{k + 1}].t_s: {t1:g} s is not after the previous point ({t0:g} s); "
                "the times of the points must increase."
            )
    chi = coordinates_of_points(settings.points)
    require_closed(chi, settings.periods, "reference.points")
    coefficients = INTERPOLATIONS[settings.interpolation](np.array(times), chi)
    if times[0] > 0.0:
        times.insert(0, 0.0)
        wait = np.zeros_like(coefficients[:1])
        wait[0, 0] = chi[0]
        coefficients = np.concatenate([wait, coefficients])
    return PiecewisePolynomial(np.array(times), coefficients, settings.periods)
