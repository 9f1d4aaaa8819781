"""Tests a run against the condition of convergence, and estimates the error that cannot be learned.

In each third-octave band the error of each axis is bounded by the prediction of the nominal axis plus the
uncertain part of the change, see `hil.lab.learn.convergence`:

::

    |E_k| <= |E_{k-1} - P_0 (A_k - A_{k-1})| + c ||P_0 (A_k - A_{k-1})||
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray, Flags
from hil.lab.learn.convergence import AxisLoop, Filter
from hil.lab.learn.trial import Trial, spectra

MARGIN = 1.5
"""Factor on the bound: axes change along the path, and a band leaks into the next."""
NO_BETTER = 0.2
"""A band that falls to this share in one run is no contradiction."""
COUNTS = 0.05
"""Least error of a band that counts, as a share of the first run's error."""
FALLS = 0.9
"""Learning has reached its floor if more than this share of the last error is left."""
NEAR_NOISE = 1.5
"""Errors below this many standard deviations of the measurement count as zero."""
LOWEST_HZ = 1.0
SIGMAS = 3.0


class Contradiction(NamedTuple):
    """A frequency band in which the error fell less from run to run than the convergence bound requires."""

    axis: int
    f_Hz: float
    factor: float
    """Ratio of the error to that of the run before."""
    allowed: float


def bands(f_Hz: Array, end_Hz: float) -> list[Flags]:
    """Masks (m,) of the frequencies in each non-empty third-octave band, 0 and LOWEST_HZ to end_Hz."""
    edges = LOWEST_HZ * 2.0 ** (np.arange(1, 60) / 3.0)
    members = [(f_Hz >= low) & (f_Hz < high) for low, high in pairwise([0.0, *edges[edges < end_Hz], end_Hz])]
    return [inside for inside in members if inside.any()]


def rms_in(X: ComplexArray, inside: Flags, samples: int, count: int) -> Array:
    """Rms (m,), over `count` samples, of the part inside a band of signals with real transform X (f, m)."""
    total = 2.0 * (np.abs(X[inside]) ** 2).sum(axis=0)
    if inside[0]:
        total = total - np.abs(X[0]) ** 2
    return np.asarray(np.sqrt(total / samples / count), np.float64)


def contradiction(
    before: Trial,
    now: Trial,
    loops: Sequence[AxisLoop],
    c: Array,
    Q: Filter,
    f_Hz: Array,
    *,
    first_rms_m: float,
    noise_m: float,
) -> Contradiction | None:
    """The band that violates the convergence bound most; None if all bands meet the bound.

    c (f,): `hil.lab.learn.convergence.contraction`; first_rms_m: error of the very first run, m; noise_m:
    standard deviation of a measured error, m.
    """
    samples, count = len(now.e), now.length
    P = np.array([loop.P for loop in loops]).T
    change = P * spectra(now.a - before.a)
    E0, E1 = spectra(before.e), spectra(now.e)
    changed = np.linalg.norm(change, axis=1)
    left = np.multiply(c, changed, out=np.zeros_like(changed), where=changed > 0.0)[:, None]
    found: list[Contradiction] = []
    for inside in bands(f_Hz, Q.end_Hz):
        was, is_ = (rms_in(E, inside, samples, count) for E in (E0, E1))
        bound = rms_in(np.abs(E0 - change) + left, inside, samples, count)
        share = float(inside.sum()) / len(f_Hz)
        noise = SIGMAS * noise_m * np.sqrt(share * samples / count)
        most = np.maximum(MARGIN * bound, NO_BETTER * was) + noise
        for axis in np.flatnonzero((is_ > most) & (is_ > COUNTS * first_rms_m)).tolist():
            f, of = float(f_Hz[inside].mean()), was[axis]
            found.append(Contradiction(axis, f, float(is_[axis] / of), float(most[axis] / of)))
    return max(found, key=lambda each: each.factor / each.allowed, default=None)


State = Literal["learned", "floor", "contradicted"]
"""State of learning: it goes on, its floor is reached, or a run contradicts the condition of convergence."""


def state(contradicted: bool, in_band_m: float, contraction: float | None, noise_m: float) -> State:
    """State of learning after a run: learned, floor or contradicted.

    in_band_m: error within the filter, m; contraction: its ratio to that of the run before, None for the
    first; noise_m: standard deviation of a measured error, m.
    """
    if contradicted:
        return "contradicted"
    if in_band_m <= NEAR_NOISE * noise_m or (contraction is not None and contraction > FALLS):
        return "floor"
    return "learned"


class Floor(NamedTuple):
    """Parts of the tracking error that cannot be learned, each rms over the legs, m."""

    encoder_m: float
    rate_m: float
    not_repeating_m: float
    beyond_filter_m: float


def in_band(run: Trial, Q: Filter, f_Hz: Array) -> Array:
    """Tracking error (count, 6) m after the learning filter."""
    passed = np.fft.irfft(Q.at(f_Hz)[:, None] * spectra(run.e), len(run.e), axis=0)
    return np.asarray(passed[run.first : run.first + run.length], np.float64)


def floor(
    run: Trial,
    unexplained: Array | None,
    loops: Sequence[AxisLoop],
    Q: Filter,
    f_Hz: Array,
    length_m: float,
    rate_m_s: float,
) -> Floor:
    """Parts of a run's error that cannot be learned.

    length_m, rate_m_s: standard deviations of measured lengths and rates. unexplained (count, 6) m: measured
    minus predicted error; None before run 2. Two runs differ by sqrt(2) times the non-repeating error.
    """
    rate = rate_m_s * float(np.sqrt(np.mean([np.mean(np.abs(loop.by_rate) ** 2) for loop in loops])))
    beyond = run.tracked - in_band(run, Q, f_Hz)
    share = float(np.mean((1.0 - Q.at(f_Hz)) ** 2))
    out = max(float((beyond**2).mean()) - share * length_m**2, 0.0)
    apart = 0.0 if unexplained is None else float((unexplained**2).mean()) / 2.0
    apart = max(apart - length_m**2 - rate**2, 0.0)
    return Floor(length_m, rate, float(np.sqrt(apart)), float(np.sqrt(out)))
