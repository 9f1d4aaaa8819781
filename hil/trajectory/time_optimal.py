"""Way-points in the shortest time within limits of velocity, acceleration and jerk, at rest at each.

Ruckig plans while the trajectory is built; the cycle evaluates the resulting polynomials.
"""

import io
from itertools import pairwise
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, LogError
from hil.config.reference import LONGEST_S, TimeOptimalReference
from hil.trajectory.path import axis_limits, coordinates_of_points
from hil.trajectory.piecewise import DEGREE, PiecewisePolynomial
from hil.trajectory.waypoints import SAME, require_closed

APART = 1e-12
"""s: instants of two axes that are closer than this become one knot."""
LONGEST_MOVE_S = 7600.0
"""Longest move that Ruckig plans: beyond it, polynomials of time lose too many digits."""


def time_optimal_path(settings: TimeOptimalReference) -> tuple[Array, Array]:
    """Knots (n + 1,) s and coefficients (n, 6, 6) of the path, as for `PiecewisePolynomial`.

    Each move from rest to rest takes the time of its slowest axis. The other axes move in proportion, on a
    straight line of the pose coordinates, if their limits allow that; otherwise they only take the same time.
    Raises ConfigurationError for two equal points in sequence, or a repeated path that does not close.
    """
    chi = coordinates_of_points(settings.points)
    for k, (a, b) in enumerate(pairwise(chi)):
        if np.abs(b - a).max() <= SAME:
            raise ConfigurationError(
                f"reference.points[{k + 1}]: the same pose as the previous point; a move needs another one."
            )
    require_closed(chi, settings.periods, "reference.points")
    limits = axis_limits(settings.limits)
    knots, pieces = [0.0], []
    for k, (start, end) in enumerate(pairwise(chi)):
        least_s = _least_s(np.abs(end - start), limits)
        if least_s >= LONGEST_MOVE_S:
            raise ConfigurationError(
                f"reference.limits: the move from point {k} to {k + 1} takes {least_s:.0f} s or more, "
                f"allowed: less than {LONGEST_MOVE_S:.0f} s; raise the limits, or insert points between."
            )
        t, coefficients = _move(start, end, limits)
        pieces.append(coefficients)
        knots += (knots[-1] + t[1:]).tolist()
    if knots[-1] > LONGEST_S:
        raise ConfigurationError(
            f"reference.limits: the moves take {knots[-1]:.0f} s, allowed: {LONGEST_S:.0f} s; raise the "
            "limits or leave out points."
        )
    return np.array(knots), np.concatenate(pieces)


def plan(settings: TimeOptimalReference) -> bytes:
    """Planned path as a file in NumPy's format: a row (37,) for each polynomial, knot first.

    A log carries its plan, because another C library may plan with another last bit. Raises
    ConfigurationError as `time_optimal_path`.
    """
    knots, coefficients = time_optimal_path(settings)
    file = io.BytesIO()
    np.save(file, np.column_stack([knots[1:], coefficients.reshape(len(coefficients), -1)]))
    return file.getvalue()


def planned_trajectory(file: bytes, periods: int | None) -> PiecewisePolynomial:
    """Trajectory from the bytes of `plan`. Raises LogError for invalid bytes, as logs are untrusted."""
    table = _table(file)
    knots = np.concatenate([[0.0], table[:, 0]])
    if not np.isfinite(table).all() or not (np.diff(knots) > 0.0).all():
        raise LogError("the plan of the reference in the log: numbers must be finite, times must increase")
    return PiecewisePolynomial(knots, table[:, 1:].reshape(len(table), DEGREE + 1, 6), periods)


def _table(file: bytes) -> Array:
    """Rows (n, 37) of a plan; allocates at most the size of the file."""
    stream, width = io.BytesIO(file), 1 + 6 * (DEGREE + 1)
    try:
        np.lib.format.read_magic(stream)
        shape, fortran, kind = np.lib.format.read_array_header_1_0(stream)
        numbers = np.frombuffer(file, np.float64, offset=stream.tell())
    except (ValueError, TypeError, SyntaxError, EOFError, RecursionError) as error:
        raise LogError(f"the plan of the reference in the log cannot be read: {error}") from None
    if kind != np.float64 or shape != (len(numbers) // width, width) or not shape[0]:
        raise LogError(
            f"the plan of the reference in the log: {shape} of {kind} with {len(numbers)} numbers, allowed: "
            f"(n, {width}) of float64"
        )
    return np.ascontiguousarray(numbers.reshape(shape, order="F" if fortran else "C"))


def _least_s(way: Array, limits: Array) -> float:
    """Lower bound, s, on the time of a move over way (6,) m, rad: the slowest of each limit (3, 6) alone."""
    v, a, j = limits
    return float(max((way / v).max(), (2.0 * np.sqrt(way / a)).max(), np.cbrt(32.0 * way / j).max()))


def _move(start: Array, end: Array, limits: Array) -> tuple[Array, Array]:
    """Knots (n + 1,) from 0 and coefficients (n, 6, 6) of one move from rest to rest."""
    try:
        from ruckig import InputParameter, Ruckig, Synchronization  # noqa: PLC0415 - not on every platform
        from ruckig import Trajectory as Plan  # noqa: PLC0415
    except ModuleNotFoundError:
        raise ConfigurationError(
            "reference: time-optimal moves need ruckig, which has no binary package for this platform: "
            "pip install ruckig, with a C++ compiler; or reference.type: waypoints"
        ) from None
    request = InputParameter(6)
    request.current_position, request.target_position = start.tolist(), end.tolist()
    request.max_velocity, request.max_acceleration, request.max_jerk = limits.tolist()
    request.synchronization = Synchronization.Phase
    planned = Plan(6)
    try:
        result = str(Ruckig(6).calculate(request, planned).name)
    except ValueError as error:  # the binding knows no name for some results
        result = str(error)
    if result not in {"Working", "Finished"}:
        raise ConfigurationError(
            f"reference.limits: no move from {start} to {end} was found within them ({result}); a move takes "
            f"less than {LONGEST_MOVE_S:.0f} s and its limits are of similar size."
        )
    axes = [_states(profile) for profile in planned.profiles[0]]
    instants = np.unique(np.concatenate([t for t, _ in axes]))
    t = instants[np.concatenate([[True], np.diff(instants) > APART])]
    h = np.diff(t)
    coefficients = np.zeros((len(h), DEGREE + 1, 6))
    for axis, (own, states) in enumerate(axes):
        k = np.minimum(np.searchsorted(own, t[:-1] + APART, side="right") - 1, len(own) - 1)
        x, v, a, j = states[k].T
        s = t[:-1] - own[k]
        coefficients[:, 0, axis] = x + s * (v + s * (a / 2 + s * j / 6))
        coefficients[:, 1, axis] = h * (v + s * (a + s * j / 2))
        coefficients[:, 2, axis] = h * h * (a + s * j) / 2
        coefficients[:, 3, axis] = h * h * h * j / 6
    return t, coefficients


def _states(profile: Any) -> tuple[Array, Array]:
    """Instants (n,) s of an axis; (n, 4): position, velocity, acceleration and the jerk from there on."""
    instants = np.concatenate([[0.0], np.cumsum(profile.t)])
    jerk = [*profile.j, 0.0]
    return instants, np.array([profile.p, profile.v, profile.a, jerk]).T
