"""One run as a learning trial: error and learned acceleration over one stretch of time, and the update.

Signals begin before the reference and end after it, so that a zero-phase filter has room on both sides. After
the run the error decays at the rate of the closed loop.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len

from drivers.arrays import Array, ComplexArray
from hil.lab.learn.convergence import AxisLoop, Filter

BEFORE_S, BEHIND_S, HELD_S = 0.5, 1.0, 0.4
"""Duration of a trial before and after the reference; the last values are held for HELD_S after it."""
LEAD_S, RISE_S = 0.45, 0.2
"""The learned acceleration begins LEAD_S before the reference and rises from 0 within RISE_S. A law without
integral action arrives at the start with an error, which only an earlier action can remove.
"""
FIRST_STEP = 0.5
"""Share of the first update, before any effect of a learned acceleration was measured. With a wrong sign the
error grows by half, and the next call refuses to go on.
"""


class Trial(NamedTuple):
    """Signals of a run for learning, n samples from before to after the reference."""

    period_s: float
    first: int
    """Sample at which the reference begins."""
    length: int
    """Samples of the reference."""
    lead: int
    """Samples before the reference in which a learned acceleration may act."""
    e: Array
    """(n, 6) m, demanded minus measured leg length."""
    a: Array
    """(n, 6) m/s^2, learned acceleration that acted."""

    @property
    def tracked(self) -> Array:
        """Tracking error (length, 6) m along the reference."""
        return self.e[self.first : self.first + self.length]

    @property
    def rms_m(self) -> float:
        """Root mean square of the tracking error over time and legs, m: the norm that learning reduces."""
        return float(np.sqrt((self.tracked**2).mean()))

    @property
    def peak_m(self) -> float:
        """Largest tracking error of any leg, m."""
        return float(np.abs(self.tracked).max())


def trial(period_s: float, lead: int, e: Array, de: Array, a: Array, wn: Array) -> Trial:
    """The trial of a run; the first `lead` rows are before the reference.

    Errors e (n, 6) m, their rates de (n, 6) m/s, learned accelerations a (n, 6) m/s^2; wn (6,) rad/s. After
    the run the rate of the error decays as exp(-wn t), the other values are held for HELD_S.
    """
    room, behind = round(BEFORE_S / period_s), round(BEHIND_S / period_s)
    count = len(e) - lead
    total = int(next_fast_len(room + count + behind, real=True))
    t = period_s * np.arange(1, total - room - count + 1)[:, None]
    going = _going(period_s, len(t))
    errors, inputs = np.zeros((total, 6)), np.zeros((total, 6))
    begun = room - lead
    comes = risen(np.arange(lead) / max(lead / 4.0, 1.0))[:, None]
    errors[begun:room], inputs[begun:room] = e[:lead] * comes, a[:lead]
    errors[room : room + count], inputs[room : room + count] = e[lead:], a[lead:]
    errors[room + count :] = (e[-1] + de[-1] * (1.0 - np.exp(-wn * t)) / wn) * going
    inputs[room + count :] = a[-1] * going
    return Trial(period_s, room, count, lead, errors, inputs)


def _going(period_s: float, samples: int) -> Array:
    """Weight (samples, 1) of the values held after the run: 1 for HELD_S, then smoothly down to 0."""
    t = period_s * np.arange(1, samples + 1)[:, None]
    return np.asarray(1.0 - risen((t - HELD_S) / (t[-1] - HELD_S)), np.float64)


def risen(x: Array) -> Array:
    """Smooth step 10 x^3 - 15 x^4 + 6 x^5 of x (n,) clamped to 0 .. 1."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 + x * (6.0 * x - 15.0)), np.float64)


def spectra(x: Array) -> ComplexArray:
    """Real Fourier transform (f, 6) of the columns of x (n, 6)."""
    return np.asarray(np.fft.rfft(x, axis=0), np.complex128)


def updated(run: Trial, loops: Sequence[AxisLoop], Q: Filter, f_Hz: Array, share: float = 1.0) -> Array:
    """Next learned acceleration (lead + length, 6) m/s^2: Q (a + share e / P_0), 0 at its start.

    A share below 1 keeps the condition of convergence: |1 - share L P| <= 1 - share + share |1 - L P|. The
    inverse is taken in the band of Q only, so it needs no other regularisation.
    """
    P = np.array([loop.P for loop in loops]).T
    A = Q.at(f_Hz)[:, None] * (spectra(run.a) + share * spectra(run.e) / P)
    begun = run.first - run.lead
    whole = np.fft.irfft(A, len(run.a), axis=0)[begun : run.first + run.length]
    rise_s = min(RISE_S, run.lead * run.period_s)
    t = run.period_s * np.arange(len(whole), dtype=np.float64)
    rises = risen(t / rise_s) if run.lead else np.ones(len(whole))
    return np.asarray(whole * rises[:, None], np.float64)


def predicted(run: Trial, a: Array, loops: Sequence[AxisLoop]) -> Array:
    """Predicted errors (length, 6) m under a (lead + length, 6) m/s^2: e_k - P_0 (a - a_k)."""
    more = -run.a
    begun, end = run.first - run.lead, run.first + run.length
    more[begun:end] += a
    more[end:] += a[-1] * _going(run.period_s, len(run.a) - end)
    P = np.array([loop.P for loop in loops]).T
    return run.tracked - np.fft.irfft(P * spectra(more), len(run.e), axis=0)[run.first : end]
