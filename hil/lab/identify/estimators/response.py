"""Frequency response of each axis, its coherence and its standard deviation.

In a closed loop the noise of the measurement comes back in the demanded acceleration, and the quotient of
their spectra is biased towards the inverse of the law. The reference is not correlated with any noise, so

    G = S_yr / S_vr,    S_ab = sum over blocks of A conj(R),

reference to position over reference to demanded acceleration, is not (joint input-output method; R. Pintelon
and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., Wiley, 2012, ch. 2 and 9). With
an excitation that repeats this is the quotient of the means over the periods. What is left in each block,
E = Y - G V, has the variance that the standard deviation follows from.

Blocks are weighted by the power of the reference in them: a chirp passes a line in one or two, the others
hold noise alone. h = |R|^2 / sum |R|^2 is the leverage of a block; it draws the estimate towards itself, so
that its own |E|^2 is too small by 1 - h (D. V. Hinkley, Technometrics 19, 1977). The effective number of
blocks is 1 / sum h^2, which is their number if they are equal.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import f as fisher

from drivers.arrays import Array, ComplexArray, Flags
from hil.lab.identify.estimators.spectra import Spectra

OWN = 0.3
"""An axis counts as excited at a line where its reference has this share of the axis that has most."""
SURE = 0.95
FEWEST_COUNTING = 3.0
"""Least 1 / sum h^2. A line with fewer blocks counts as not excited: its noise is not known."""


class Response(NamedTuple):
    """Estimates for each line and axis, all (lines, 6)."""

    period_s: float
    frequency_Hz: Array
    """(lines,)."""
    G: ComplexArray
    """Position over demanded acceleration, s^2."""
    std: Array
    """Of |G| / |true G|: of the magnitude, relative, and of the phase in rad."""
    radius: Array
    """Around G, relative to it, with 95 % confidence."""
    coherence: Array
    """Of the reference with position and demanded acceleration, the smaller one, 0 .. 1."""
    excited: Flags
    V: ComplexArray
    """Mean demanded acceleration, in phase with the reference: the direction of each line."""
    Y: ComplexArray
    """Mean position."""


def estimate(spectra: Spectra) -> Response:
    """Return the frequency responses of six axes, each by itself.

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
    """Return |S_ar|^2 / (S_aa S_rr) over the blocks, 0 where there is nothing."""
    both = (np.abs(A) ** 2).sum(axis=0) * (np.abs(R) ** 2).sum(axis=0)
    return np.asarray(
        np.minimum(np.abs((A * R.conj()).sum(axis=0)) ** 2 / np.where(both == 0.0, np.inf, both), 1.0)
    )
