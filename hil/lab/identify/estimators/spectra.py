"""Spectra of a run, block by block: whole periods of an excitation that repeats, or windowed segments.

Behind a double integrator most of the position is slow, and must not leak into the other lines. An excitation
that repeats is cut into whole periods, less a drift; of any other, second differences are transformed and
divided by their gain for a sinusoid.
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray, Flags, Ints
from drivers.errors import IdentificationError
from hil.lab.identify.estimators.linearised import AxisSignals

FEWEST_BLOCKS = 4
"""With fewer, noise alone is coherent too often."""
SEGMENT_S = 2.0
"""Of a log whose excitation does not repeat."""
SEGMENT_LINES = 60
"""Of such a log, evenly spread on a logarithmic scale."""
HIGHEST = 0.3
"""Times the rate."""
BESIDE = np.array([-4, -2, 0, 2, 4])
"""Harmonics averaged for a line of such a log, up to 2 Hz beside it. A chirp passes a line within a segment
or two; its neighbours show the noise. The noise of harmonics two apart correlates by 1/6."""


class Spectra(NamedTuple):
    """Fourier coefficients of each block at each line, for six axes: all (blocks, lines, 6)."""

    period_s: float
    frequency_Hz: Array
    """(lines,)."""
    V: ComplexArray
    """Demanded acceleration."""
    Y: ComplexArray
    """Measured position."""
    R: ComplexArray
    """Acceleration of the reference."""


def periodic(signals: AxisSignals, length: int, harmonics: Ints) -> Spectra:
    """Return the spectra of whole periods of `length` ticks, at multiples of 1/(length T).

    A whole period of what repeats needs no window and leaks nothing. A drift may lie underneath, its speed
    changing steadily: it follows from the means of the periods and is taken off. Periods with a tick that
    does not count are left out.

    Raises IdentificationError: fewer than four whole periods.
    """
    starts = _starts(signals.good, length, length)
    if len(starts) < FEWEST_BLOCKS:
        raise IdentificationError(
            f"too short: {len(starts)} whole periods of {length * signals.period_s:g} s at full speed and "
            f"without a missing tick, allowed: at least {FEWEST_BLOCKS}; excite longer"
        )
    blocks = _blocks(starts, length)
    y = signals.y[blocks]
    # The means of blocks on a parabola have its curvature, and at each block's middle its slope.
    middle = np.array(starts, float)
    slope = np.gradient(y.mean(axis=1), middle, axis=0, edge_order=2)[:, None, :]
    curvature = np.gradient(slope, middle, axis=0, edge_order=2)
    tau = (np.arange(length) - 0.5 * (length - 1))[None, :, None]
    drift = tau * (slope + 0.5 * tau * curvature)

    def spectrum(x: Array) -> ComplexArray:
        return np.asarray(2.0 / length * np.fft.rfft(x, axis=1)[:, harmonics], np.complex128)

    V, R = spectrum(signals.v[blocks]), spectrum(signals.r[blocks])
    return Spectra(signals.period_s, harmonics / (length * signals.period_s), V, spectrum(y - drift), R)


def segmented(signals: AxisSignals) -> Spectra:
    """Return the spectra of half-overlapping segments under a Hann window, for any excitation.

    P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio
    Electroacoust. 15, 1967.

    Raises IdentificationError: fewer than four segments.
    """
    length = round(SEGMENT_S / signals.period_s)
    whole = signals.good.copy()  # second differences want both neighbours
    whole[1:] &= signals.good[:-1]
    whole[:-1] &= signals.good[1:]
    whole[[0, -1]] = False
    starts = _starts(whole, length, length // 2)
    if len(starts) < FEWEST_BLOCKS:
        raise IdentificationError(
            f"too short: {len(starts)} segments of {SEGMENT_S:g} s of tracking without a missing tick, "
            f"allowed: {FEWEST_BLOCKS}; {SEGMENT_S * (FEWEST_BLOCKS + 1) / 2:g} s of tracking have them"
        )
    T, blocks = signals.period_s, _blocks(starts, length)
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length)[:, None] ** 2
    lines = np.unique(np.geomspace(2, HIGHEST * length, SEGMENT_LINES).round().astype(np.int64))
    # Both sides or none, for the phase changes from one to the other; below the second is the mean's.
    there = lines[None, :] - np.abs(BESIDE)[:, None] >= 2
    harmonics = np.where(there, lines[None, :] + BESIDE[:, None], 0)
    second = np.zeros_like(signals.y)
    second[1:-1] = signals.y[2:] - 2.0 * signals.y[1:-1] + signals.y[:-2]

    def spectrum(x: Array) -> ComplexArray:
        cut = x[blocks]
        X = np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * window, axis=1)
        return np.asarray(4.0 / length * X[:, harmonics] * there[:, :, None], np.complex128)

    frequency_Hz = lines / (length * T)
    # That of the line for those beside it, too: an axis changes far less than 1/s^2 from one to the other.
    difference = 2.0 * np.cos(2.0 * np.pi * frequency_Hz * T) - 2.0
    V, Y, R = spectrum(signals.v), spectrum(second) / difference[:, None], spectrum(signals.r)
    # The stronger side weighs what the weaker does: else the line would have the phase of another frequency.
    power = (np.abs(R) ** 2).sum(axis=(0, 3))
    even = np.sqrt(np.minimum(power, power[::-1]) / np.where(power == 0.0, 1.0, power))[:, :, None]
    V, Y, R = ((even * x).reshape(-1, len(lines), 6) for x in (V, Y, R))
    return Spectra(T, frequency_Hz, V, Y, R)


def _blocks(starts: list[int], length: int) -> Ints:
    """Return the ticks of each block (blocks, length)."""
    return np.array(starts, np.int64)[:, None] + np.arange(length)


def _starts(good: Flags, length: int, step: int) -> list[int]:
    """Return where blocks begin that are good throughout, as many as fit, `step` apart but for gaps."""
    starts, k = [], 0
    bad = np.flatnonzero(~good)
    while k + length <= len(good):
        at = int(np.searchsorted(bad, k))
        if at < len(bad) and bad[at] < k + length:
            k = int(bad[at]) + 1
            continue
        starts.append(k)
        k += step
    return starts
