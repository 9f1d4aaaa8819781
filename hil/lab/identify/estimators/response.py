"""Frequency response of each axis, its coherence and its standard deviation.

In a closed loop, measurement noise returns in the demanded acceleration, so the quotient of the two spectra
is biased towards the inverse of the law. The reference is uncorrelated with any noise, so the quotient

    G = S_yr / S_vr,    S_ab = sum over blocks of A conj(R),

from reference to position over reference to demanded acceleration, has no such bias (joint input-output
method; R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., Wiley,
2012, ch. 2 and 9). For a periodic excitation this is the quotient of the means over the periods. The
standard deviation follows from the variance of the remainder in each block, E = Y - G V.

Blocks are weighted by the power of the reference in them: a chirp passes a line in one or two blocks, the
others contain noise only. h = |R|^2 / sum |R|^2 is the leverage of a block; it draws the estimate towards
itself, so its own |E|^2 is too small by 1 - h (D. V. Hinkley, Technometrics 19, 1977). The effective number
of blocks is 1 / sum h^2, which is their number if they are equal.

After a double integrator most of the position is slow and must not leak into the other lines. A periodic
excitation is cut into whole periods, less a drift. For any other excitation, second differences are
transformed and divided by their gain for a sinusoid.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import f as fisher

from drivers.arrays import Array, ComplexArray, Flags, Ints
from drivers.errors import IdentificationError

FEWEST_BLOCKS = 4
"""With fewer blocks, noise alone is coherent too often."""
SEGMENT_S = 2.0
"""Length of a segment if the excitation is not periodic."""
SEGMENT_LINES = 60
"""Lines of such a log, evenly spread on a logarithmic scale."""
HIGHEST = 0.3
"""Highest line, as a share of the rate."""
BESIDE = np.array([-4, -2, 0, 2, 4])
"""Harmonics averaged for a line of such a log, up to 2 Hz on either side.

A chirp passes a line within a segment or two; its neighbours show the noise. The noise of harmonics two apart
correlates by 1/6.
"""


class AxisSignals(NamedTuple):
    """Signals of six axes of a run, one row per consecutive tick."""

    period_s: float
    v: Array
    """(n, 6) m/s^2, rad/s^2: acceleration demanded by the sent forces."""
    y: Array
    """(n, 6) m, rad: measured position."""
    r: Array
    """(n, 6) m/s^2, rad/s^2: acceleration of the reference."""
    good: Flags
    """(n,): tracking, recorded, and all six legs fresh."""


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
    """Spectra of whole periods of `length` ticks, at multiples of 1 / (length period_s), in Hz.

    Whole periods of a periodic signal need no window and do not leak. A drift with a steadily changing speed
    may be superposed; it follows from the means of the periods and is subtracted. Periods with a bad tick are
    left out.

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
    """Spectra of half-overlapping segments under a Hann window, for any excitation.

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
    # The line's gain also for its neighbours: between them an axis changes far less than 1/s^2.
    difference = 2.0 * np.cos(2.0 * np.pi * frequency_Hz * T) - 2.0
    V, Y, R = spectrum(signals.v), spectrum(second) / difference[:, None], spectrum(signals.r)
    # Equal weights on both sides; otherwise the line would have the phase of another frequency.
    power = (np.abs(R) ** 2).sum(axis=(0, 3))
    even = np.sqrt(np.minimum(power, power[::-1]) / np.where(power == 0.0, 1.0, power))[:, :, None]
    V, Y, R = ((even * x).reshape(-1, len(lines), 6) for x in (V, Y, R))
    return Spectra(T, frequency_Hz, V, Y, R)


def _blocks(starts: list[int], length: int) -> Ints:
    return np.array(starts, np.int64)[:, None] + np.arange(length)


def _starts(good: Flags, length: int, step: int) -> list[int]:
    """First ticks of the blocks of `length` good ticks, `step` ticks apart except at gaps."""
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


OWN = 0.3
"""An axis is excited at a line if its reference has at least this share of the strongest axis."""
SURE = 0.95
FEWEST_COUNTING = 3.0
"""Least 1 / sum h^2. A line with fewer effective blocks is not excited, since its noise is unknown."""


class Response(NamedTuple):
    """Estimated frequency responses of six axes, arrays (lines, 6)."""

    period_s: float
    frequency_Hz: Array
    """(lines,)."""
    G: ComplexArray
    """Position over demanded acceleration, s^2."""
    std: Array
    """Standard deviation of |G| / |true G|: of the relative magnitude, and of the phase in rad."""
    radius: Array
    """Radius of the 95 % circle around G, relative to |G|."""
    coherence: Array
    """Coherence of the reference with position or demanded acceleration, the smaller one, 0 .. 1."""
    excited: Flags
    V: ComplexArray
    """Mean demanded acceleration, in phase with the reference: the direction of each line."""
    Y: ComplexArray
    """Mean position."""


def estimate(spectra: Spectra) -> Response:
    """Frequency response, coherence and standard deviation of six axes, each axis by itself.

    The 95 % circle is that of a complex normal with variance estimated from m blocks: |error|^2 / variance is
    distributed as F(2, 2 m - 2), m = 1 / sum h^2.
    """
    V, Y, R = spectra.V, spectra.Y, spectra.R
    power = np.sqrt((np.abs(R) ** 2).mean(axis=0))
    strongest = power.max(axis=1, keepdims=True)
    total = (np.abs(R) ** 2).sum(axis=0)
    h = np.abs(R) ** 2 / np.where(total == 0.0, np.inf, total)
    m = 1.0 / np.maximum((h**2).sum(axis=0), 1.0 / len(R))
    known = (m >= FEWEST_COUNTING) & (total > 0.0)
    excited = (power >= OWN * strongest) & (strongest > 1e-3 * strongest.max()) & known
    S_yr, S_vr = (Y * R.conj()).sum(axis=0), (V * R.conj()).sum(axis=0)
    G = S_yr / np.where(S_vr == 0.0, np.nan, S_vr)
    E = Y - G * V
    left = np.where(known, (np.abs(E) ** 2 * np.abs(R) ** 2 / np.maximum(1.0 - h, 1e-9)).sum(axis=0), np.nan)
    variance = left / np.where(S_yr == 0.0, np.nan, np.abs(S_yr) ** 2)
    coherence = np.minimum(_coherence(Y, R), _coherence(V, R))
    # The reference of the axis that has most gives the phase that blocks are averaged in.
    lead = np.take_along_axis(R, power.argmax(axis=1)[None, :, None], axis=2)
    turn = lead.conj() / np.where(lead == 0.0, 1.0, np.abs(lead))
    return Response(
        spectra.period_s,
        spectra.frequency_Hz,
        np.asarray(G, np.complex128),
        np.sqrt(variance / 2.0),
        np.sqrt(variance * fisher.ppf(SURE, 2, 2.0 * np.where(known, m, 2.0) - 2.0)),
        coherence,
        excited,
        np.asarray((V * turn).mean(axis=0), np.complex128),
        np.asarray((Y * turn).mean(axis=0), np.complex128),
    )


def _coherence(A: ComplexArray, R: ComplexArray) -> Array:
    """|S_ar|^2 / (S_aa S_rr) over the blocks; 0 if a spectrum is zero."""
    both = (np.abs(A) ** 2).sum(axis=0) * (np.abs(R) ** 2).sum(axis=0)
    return np.asarray(
        np.minimum(np.abs((A * R.conj()).sum(axis=0)) ** 2 / np.where(both == 0.0, np.inf, both), 1.0)
    )
