"""Paths through way-points at given times."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.config.reference import WaypointReference
from hil.trajectory.minimum_jerk import minimum_jerk_coefficients
from hil.trajectory.path import words_of_points
from hil.trajectory.piecewise import PiecewisePolynomial

CUBIC = (0.0, 0.0, 3.0, -2.0, 0.0, 0.0)
QUINTIC = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)
"""Coefficients of the scaling function s(u), s(0) = 0, s(1) = 1, with no speed at either end."""
SAME = 1e-9
"""m and rad: how far the last point may lie from the first one when the list is repeated."""


def rest_to_rest(s: tuple[float, ...], t: Array, chi: Array) -> Array:  # noqa: ARG001
    """Coefficients (n - 1, 6, 6) of straight segments through chi (n, 6), scaled by s(u)."""
    coefficients = np.array(s)[None, :, None] * np.diff(chi, axis=0)[:, None, :]
    coefficients[:, 0, :] = chi[:-1]
    return coefficients


INTERPOLATIONS: dict[str, Callable[[Array, Array], Array]] = {
    "cubic": partial(rest_to_rest, CUBIC),
    "quintic": partial(rest_to_rest, QUINTIC),
    "minimum_jerk": minimum_jerk_coefficients,
}
"""Name -> coefficients [segment, power, word] from times (n,) and points (n, 6)."""


def require_closed(chi: Array, periods: int | None, where: str) -> None:
    """Refuse to repeat a path chi (n, 6) that does not end where it starts. Raises ConfigurationError."""
    gap = float(np.max(np.abs(chi[-1] - chi[0])))
    if periods != 1 and gap > SAME:
        raise ConfigurationError(
            f"{where}: periods is {'null' if periods is None else periods}, but the path ends {gap:.3g} m or "
            "rad away from its start, so a repeat would jump. Let it end where it starts, or set periods: 1."
        )


def waypoint_trajectory(settings: WaypointReference) -> PiecewisePolynomial:
    """Return the path through the points; before the first point it holds.

    Cubic and quintic rest at every point: chi_k + (chi_k+1 - chi_k) s(u). Minimum jerk rests at the first
    and the last one. The rotation vector is interpolated like the position. Raises ConfigurationError when
    the times do not increase, or when a repeated path does not close.
    """
    times = [point.t_s for point in settings.points]
    for k, (t0, t1) in enumerate(pairwise(times)):
        if not t1 > t0:
            raise ConfigurationError(
                f"reference.points[{k + 1}].t_s: {t1:g} s is not after the point before it ({t0:g} s); "
                "the times of the points must increase."
            )
    chi = words_of_points(settings.points)
    require_closed(chi, settings.periods, "reference.points")
    coefficients = INTERPOLATIONS[settings.interpolation](np.array(times), chi)
    if times[0] > 0.0:
        times.insert(0, 0.0)
        wait = np.zeros_like(coefficients[:1])
        wait[0, 0] = chi[0]
        coefficients = np.concatenate([wait, coefficients])
    return PiecewisePolynomial(np.array(times), coefficients, settings.periods)
