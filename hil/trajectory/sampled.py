"""A path from a CSV file: one cubic spline per pose coordinate through all rows."""

import csv
import io
import math
from pathlib import Path

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.files import read_regular
from hil.config.number import ALLOWED, is_allowed, plain_number
from hil.config.reference import LONGEST_S, SampledReference
from hil.config.values import AXES
from hil.trajectory.path import require_half_turn
from hil.trajectory.piecewise import DEGREE, PiecewisePolynomial
from hil.trajectory.waypoints import require_closed

HEADER = ("t_s", *AXES)
_QUOTED = 200
"""Largest number of characters of a wrong header in a message."""


def read_poses(path: Path, at_least: int) -> tuple[Array, Array]:
    """Read a CSV of poses; return times (n,) s and chi (n, 6) m, rad.

    Blank lines are skipped. Raises ConfigurationError with every problem as `file:line: ...`: unreadable
    file, wrong header, value not finite, times not increasing, or fewer than `at_least` rows.
    """
    rows: list[list[float]] = []
    problems: list[str] = []
    try:
        lines = csv.reader(io.StringIO(read_regular(path).decode("utf-8-sig"), newline=""))
        header = tuple(word.strip() for word in next(lines, []))
        if header != HEADER:
            given = ",".join(header)[:_QUOTED] or "nothing"
            raise ConfigurationError(f"{path}:1: the header must be {','.join(HEADER)}; given: {given}.")
        for words in lines:
            if words:
                row, problem = _row(words, rows[-1][0] if rows else -math.inf)
                rows.append(row)
                if problem:
                    problems.append(f"{path}:{lines.line_num}: {problem}")
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read as a CSV file: {error.strerror}.") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigurationError(f"{path}: cannot be read as a CSV file: {error}.") from error
    if len(rows) < at_least:
        problems.append(f"{path}: {len(rows)} row(s) of poses; at least {at_least} are required.")
    if problems:
        raise ConfigurationError(*problems)
    table = np.array(rows)
    chi = table[:, 1:].copy()
    chi[:, 3:] = np.deg2rad(chi[:, 3:])
    return table[:, 0].copy(), chi


def _row(words: list[str], before: float) -> tuple[list[float], str]:
    """Seven numbers of a line, and a problem with them or "". `before`: time of the previous row."""
    if len(words) != len(HEADER):
        return [before], f"{len(words)} values; {len(HEADER)} are needed: {','.join(HEADER)}."
    numbers = []
    for name, word in zip(HEADER, words, strict=True):
        number = plain_number(word)
        if not math.isfinite(number):
            return [before], f"{name} must be a finite number; given: {word.strip()!r:.60}."
        if name in AXES and not is_allowed(number):
            return [before], f"{name} must have a magnitude of {ALLOWED}; given: {number:g}."
        numbers.append(number)
    if not numbers[0] > before:
        return numbers, f"t_s {numbers[0]:g} is not after {before:g} of the row above; times must increase."
    return numbers, ""


def clamped_slopes(t: Array, y: Array) -> Array:
    """Slopes (n, m) at the knots of the cubic spline through y (n, m) at t (n,), with slope 0 at both ends.

    Continuity of the second derivative (de Boor, A Practical Guide to Splines, ch. IV): with chords c_i over
    h_i, m_{i-1}/h_{i-1} + 2 m_i (1/h_{i-1} + 1/h_i) + m_{i+1}/h_i = 3 (c_{i-1}/h_{i-1} + c_i/h_i). Solved by
    tridiagonal elimination without LAPACK, which differs in the last bit between processors.
    """
    h = np.diff(t)[:, None]
    chord = np.diff(y, axis=0) / h
    slopes = np.zeros_like(y)
    n = len(t)
    diagonal = 2.0 * (1.0 / h[:-1] + 1.0 / h[1:])
    right = 3.0 * (chord[:-1] / h[:-1] + chord[1:] / h[1:])
    for i in range(1, n - 2):
        factor = 1.0 / h[i] / diagonal[i - 1]
        diagonal[i] -= factor / h[i]
        right[i] -= factor * right[i - 1]
    for i in range(n - 3, -1, -1):
        slopes[i + 1] = (right[i] - slopes[i + 2] / h[i + 1]) / diagonal[i]
    return slopes


def spline_coefficients(t: Array, y: Array) -> Array:
    """Coefficients (n - 1, 6, m) [segment, power, axis] in normalised time of the clamped cubic spline."""
    h = np.diff(t)[:, None]
    slopes = clamped_slopes(t, y)
    m0, m1, rise = slopes[:-1] * h, slopes[1:] * h, np.diff(y, axis=0)
    coefficients = np.zeros((len(t) - 1, DEGREE + 1, y.shape[1]))
    coefficients[:, 0] = y[:-1]
    coefficients[:, 1] = m0
    coefficients[:, 2] = 3.0 * rise - 2.0 * m0 - m1
    coefficients[:, 3] = m0 + m1 - 2.0 * rise
    return coefficients


def sampled_trajectory(settings: SampledReference, folder: Path) -> PiecewisePolynomial:
    """Spline through the rows of `settings.path` (relative to `folder`), at rest at both ends.

    The first row's time counts as 0. Raises ConfigurationError as `read_poses` does, for a path longer
    than LONGEST_S, and for a repeated path that does not close.
    """
    path = folder / settings.path
    t, chi = read_poses(path, at_least=2)
    first, last = float(t[0]), float(t[-1])
    if last - first > LONGEST_S:
        raise ConfigurationError(
            f"{path}: t_s goes from {first:.15g} to {last:.15g}, allowed: a path of {LONGEST_S:g} s at most."
        )
    t = t - first
    require_half_turn(float(np.linalg.norm(chi[:, 3:], axis=1).max()), str(path))
    require_closed(chi, settings.periods, str(path))
    return PiecewisePolynomial(t, spline_coefficients(t, chi), settings.periods)
