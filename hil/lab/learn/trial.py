"""One run as a period of learning: error and learned acceleration over one stretch of time, and the update.

Signals begin some time before the reference and end some time behind it, so that a filter without phase has
room on both sides. Behind the run the error goes on as the loop lets it decay.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len

from drivers.arrays import Array, ComplexArray
from hil.lab.learn.convergence import AxisLoop, Filter

BEFORE_S, BEHIND_S, HELD_S = 0.5, 1.0, 0.4
"""Of a trial, before and behind the reference; so long behind it what was there in the end goes on."""
LEAD_S, RISE_S = 0.45, 0.2
"""What is learned begins so long before the reference, and rises from 0 in this time: a law without integral
action comes to the start with an error, and only what was there before can take it away."""
FIRST_STEP = 0.5
"""Share of the first update: nothing has been measured yet of what a learned acceleration does. Of the wrong
sign it makes the error half as large again, and the next call refuses to go on."""


class Trial(NamedTuple):
    """A run."""

    period_s: float
    first: int
    """Sample at which the reference begins."""
    length: int
    """Samples of the reference."""
    lead: int
    """Samples before it in which something learned may act."""
    e: Array
    """(n, 6) m, demanded less measured length."""
    a: Array
    """(n, 6) m/s^2, learned acceleration that acted."""

    @property
    def tracked(self) -> Array:
        """The error (length, 6) m along the reference."""
        return self.e[self.first : self.first + self.length]

    @property
    def rms_m(self) -> float:
        """Root of the mean square over time and legs: the norm that learning makes fall."""
        return float(np.sqrt((self.tracked**2).mean()))

    @property
    def peak_m(self) -> float:
        """Largest error of a leg."""
        return float(np.abs(self.tracked).max())


def trial(period_s: float, lead: int, e: Array, de: Array, a: Array, wn: Array) -> Trial:
    """Return the trial of a run; the first `lead` rows are before the reference.

    e (n, 6) m, its rate de (n, 6) m/s, a (n, 6) m/s^2; wn (6,) rad/s. Behind the run the rate of the error
    dies away as exp(-wn t), the rest stays for HELD_S.
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
    """Return the share (samples, 1) of what there was in the end: 1 for HELD_S, then down to 0."""
    t = period_s * np.arange(1, samples + 1)[:, None]
    return np.asarray(1.0 - risen((t - HELD_S) / (t[-1] - HELD_S)), np.float64)


def risen(x: Array) -> Array:
    """Return 10 x^3 - 15 x^4 + 6 x^5 of x (n,) clamped to 0 .. 1."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 + x * (6.0 * x - 15.0)), np.float64)


def spectra(x: Array) -> ComplexArray:
    """Return the real transform of the columns of x (n, 6)."""
    return np.asarray(np.fft.rfft(x, axis=0), np.complex128)


def updated(run: Trial, loops: Sequence[AxisLoop], Q: Filter, f_Hz: Array, share: float = 1.0) -> Array:
    """Return the next learned acceleration (lead + length, 6) m/s^2: Q (a + share e / P_0), 0 at its start.

    A share below 1 keeps the condition: |1 - share L P| <= 1 - share + share |1 - L P|.
    The inverse is taken where Q passes, so that it needs no other regularisation.
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
    """Return the errors (length, 6) m with a (lead + length, 6) m/s^2: e_k - P_0 (a - a_k)."""
    more = -run.a
    begun, end = run.first - run.lead, run.first + run.length
    more[begun:end] += a
    more[end:] += a[-1] * _going(run.period_s, len(run.a) - end)
    P = np.array([loop.P for loop in loops]).T
    return run.tracked - np.fft.irfft(P * spectra(more), len(run.e), axis=0)[run.first : end]
