"""A path from a CSV file: one cubic spline per pose coordinate through all rows."""

import csv
import io
import math
from functools import lru_cache
from pathlib import Path

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import OUT_MATRIX, OUT_VECTOR, VECTOR, kernel
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
MOST_CSV_BYTES = 32 << 20
"""Size limit of a CSV file of poses: some ten minutes at 1 kHz."""
LEAP = 10.0
"""Ratio of the fastest to the median rate between two rows above which both rows are reported."""
FEWEST, LEAST_NOISE = 20, 1e-8
"""Fewest rows in which noise is estimated, and the smallest noise that is reported, m or rad."""
ORDERS, WINDOWS = (4, 7, 10, 16), 5000
"""Orders of differences in which noise is looked for, and the largest number of places."""
NOISY = 1.0
"""Share of noise in the second derivative of a spline above which noise is reported."""


def read_poses(path: Path, at_least: int) -> tuple[Array, Array]:
    """Read a CSV of poses; return times (n,) s and chi (n, 6) m, rad.

    Columns are found by their names; other columns, and lines without a value, are skipped. Raises
    ConfigurationError with every problem as `file:line: ...`: unreadable file, missing column, value not
    finite, times not increasing, or fewer than `at_least` rows.
    """
    try:
        return _parsed(path, read_regular(path, MOST_CSV_BYTES), at_least)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read as a CSV file: {error.strerror}.") from error


@lru_cache(maxsize=1)
def _parsed(path: Path, content: bytes, at_least: int) -> tuple[Array, Array]:
    """Read-only arrays of `read_poses`. The last file is kept: one command builds its path several times."""
    rows: list[list[float]] = []
    problems: list[str] = []
    try:
        lines = csv.reader(io.StringIO(content.decode("utf-8-sig"), newline=""))
        header = [word.strip() for word in next(lines, [])]
        if any(header.count(name) != 1 for name in HEADER):
            given = ",".join(header)[:_QUOTED] or "nothing"
            other = next((name for sign, name in ((";", "semicolon"), ("\t", "tab")) if sign in given), "")
            hint = f"; the separator is a {other}: save with commas, and a point in numbers" * bool(other)
            raise ConfigurationError(
                f"{path}:1: the header must have each of {','.join(HEADER)} once; given: {given}{hint}."
            )
        places = [header.index(name) for name in HEADER]
        for words in lines:
            if any(word.strip() for word in words):
                if len(words) == len(header):
                    row, problem = _row([words[k] for k in places], rows[-1][0] if rows else -math.inf)
                else:
                    row = rows[-1] if rows else [-math.inf]
                    problem = f"{len(words)} values; {len(header)} are needed, as in the header."
                rows.append(row)
                if problem:
                    problems.append(f"{path}:{lines.line_num}: {problem}")
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigurationError(f"{path}: cannot be read as a CSV file: {error}.") from error
    if len(rows) < at_least:
        problems.append(f"{path}: {len(rows)} row(s) of poses; at least {at_least} are required.")
    if problems:
        raise ConfigurationError(*problems)
    table = np.array(rows)
    table[:, 4:] = np.deg2rad(table[:, 4:])
    table.flags.writeable = False
    return table[:, 0], table[:, 1:]


def _row(words: list[str], before: float) -> tuple[list[float], str]:
    """Numbers (7,) of a line and "", or a message about an invalid one. `before`: time of the last row, s."""
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


def roughness(t: Array, chi: Array) -> str:
    """Warning if a spline through rows t (n,) s, chi (n, 6) m, rad overshoots or amplifies noise; else "".

    Noise: the least of the scaled differences of several orders (`_differences`). Those of a smooth motion
    fall with the order, those of white noise stay at its deviation sigma. In the second derivative of a cubic
    spline, at distances h, the noise is 6 sigma / h^2.
    """
    h = np.diff(t)
    rates = np.abs(np.diff(chi, axis=0)) / h[:, None]
    k, axis = divmod(int(np.argmax(rates)), len(AXES))
    if rates[k, axis] > LEAP * np.median(rates.max(axis=1)) and h[k] < np.median(h) / LEAP:
        scale, unit = (1e3, "mm") if axis < 3 else (180.0 / math.pi, "deg")
        way = scale * abs(chi[k + 1, axis] - chi[k, axis])
        return (
            f"rows {k + 1} and {k + 2} are {1e6 * h[k]:.3g} us and, along {AXES[axis]}, {way:.3g} {unit} "
            "apart: a spline through them overshoots; remove one of them"
        )
    if len(t) < FEWEST:
        return ""
    step = float(np.median(h))
    found = [np.abs(_differences(t, chi, order)) for order in (2, *ORDERS) if 2 * order <= len(t)]
    sigma = np.min([np.median(each, axis=0) for each in found[1:]], axis=0) / 0.6745
    bends = np.sqrt(6.0 * (found[0] ** 2).mean(axis=0))
    axis = int(np.argmax(sigma / np.maximum(bends, LEAST_NOISE)))
    if 6.0 * sigma[axis] < NOISY * bends[axis] or sigma[axis] < LEAST_NOISE:
        return ""
    scale, unit = (1.0, "m") if axis < 3 else (180.0 / math.pi, "deg")
    noise, bent = scale * sigma[axis], scale * 6.0 * sigma[axis] / step**2
    return (
        f"{AXES[axis]} has noise of about {noise:.2g} {unit} in rows {1e3 * step:.3g} ms apart, which is "
        f"{bent:.2g} {unit}/s^2 in the second derivative of the spline, and so force: smooth the rows, or "
        "use fewer rows"
    )


def _differences(t: Array, chi: Array, order: int) -> Array:
    """Divided differences (m, 6) at up to WINDOWS places, scaled: that of white noise keeps its deviation.

    sum_j w_j chi_j / |w|, w_j = prod_k 1 / (t_j - t_k), k != j, over `order` + 1 rows in turn.
    """
    last = len(t) - 1 - order
    rows = np.linspace(0, last, min(last + 1, WINDOWS)).astype(int)[:, None] + np.arange(order + 1)
    x = (t[rows] - t[rows[:, :1]]) * (order / (t[rows[:, -1:]] - t[rows[:, :1]]))
    w = 1.0 / (x[:, :, None] - x[:, None, :] + np.eye(order + 1)).prod(axis=2)
    return np.asarray(np.einsum("mj,mja->ma", w / np.linalg.norm(w, axis=1)[:, None], chi[rows]), np.float64)


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
    if n > 2:
        _eliminate(h[:, 0].copy(), diagonal[:, 0].copy(), right, slopes)
    return slopes


@kernel(VECTOR, OUT_VECTOR, OUT_MATRIX, OUT_MATRIX)
def _eliminate(h: Array, diagonal: Array, right: Array, slopes: Array) -> None:
    """Solve the tridiagonal system for the inner slopes (n - 2, m); overwrites `diagonal` and `right`."""
    for i in range(1, len(diagonal)):
        factor = 1.0 / h[i] / diagonal[i - 1]
        diagonal[i] -= factor / h[i]
        for k in range(right.shape[1]):
            right[i, k] -= factor * right[i - 1, k]
    for i in range(len(diagonal) - 1, -1, -1):
        for k in range(right.shape[1]):
            slopes[i + 1, k] = (right[i, k] - slopes[i + 2, k] / h[i + 1]) / diagonal[i]


def spline_coefficients(t: Array, y: Array) -> Array:
    """Coefficients (n - 1, 6, m) [segment, power, axis], in normalised time, of the clamped cubic spline."""
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
