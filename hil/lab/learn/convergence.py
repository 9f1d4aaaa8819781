"""Condition under which iterative learning converges, and the widest learning filter that meets it.

With u_{k+1} = Q (u_k + L e_k) and e = e_0 - P u, frequency by frequency,

::

    e_{k+1} = (1 - Q) e_0 + Q (1 - L P) e_k

The error falls monotonically in the 2-norm if |Q (1 - L P)| < 1 at each frequency for each P (D. A. Bristow,
M. Tharayil and A. G. Alleyne, A survey of iterative learning control, IEEE Control Systems Magazine 26(3),
2006, pp. 96-114; M. Norrlof and S. Gunnarsson, Time and frequency domain convergence properties in iterative
learning control, International Journal of Control 75(14), 2002, pp. 1114-1126). Here L = 1/P_0 of the nominal
axis G_0. For axes G_0 (1 + Delta), |Delta| <= W, Delta a full matrix if the axes couple,

::

    1 - L P = -S_0 Delta (1 + T_0 Delta)^-1,   |1 - L P| <= c = W |S_0| / (1 - W |T_0|)

as long as W |T_0| < 1. Q has zero phase and an end frequency beyond which nothing is learned.

The axis G of `stability.sampled_loop` goes from demanded acceleration to position and rate at the samples;
the law demands u = C [e; de], and the learned acceleration a is added:

::

    e = -P a,   P = G_p / (1 + C G),   S = 1 / (1 + C G),   T = 1 - S

A law with look-ahead counts all demanded accelerations, a included, among the commands under way. Of its
controller from [e; de] to u only the direct part D acts on the measurement, and P = G_p / (1 + C G) C_p/D_p.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray
from drivers.errors import ModelError
from hil.mathematics.linear_system import LinearSystem

CONTRACTION = 0.8
"""Largest factor from run to run for which the filter is chosen: ten runs leave 11 % of the error."""
FLAT = 0.6
"""Share of the filter's band at which its edge begins, half a cosine."""
LEAST_HZ = 2.0
"""Lowest end of a filter; below, it learns nothing of a motion that takes a second."""
STEPS = 400
"""Number of filter ends tried."""
NEAR_ZERO = 1e-3
"""Frequency in place of 0, where the axis is infinite, as a share of the first frequency above 0."""


class AxisLoop(NamedTuple):
    """Closed-loop transfer functions of one leg axis, arrays (m,) at the frequencies of `frequencies`."""

    P: ComplexArray
    """s^2, from a learned acceleration to the reduction of the error."""
    S: ComplexArray
    """Sensitivity."""
    T: ComplexArray
    """Complementary sensitivity."""
    by_rate: ComplexArray
    """s, from an error of the measured rate to the tracking error."""


def frequencies(samples: int, period_s: float) -> Array:
    """Frequencies (m,) Hz of a real Fourier transform of `samples` samples."""
    return np.asarray(np.fft.rfftfreq(samples, period_s), np.float64)


def axis_loop(axis: LinearSystem, controller: LinearSystem, f_Hz: Array, *, looks_ahead: bool) -> AxisLoop:
    """Closed loop of a sampled axis and a controller from [e m, de m/s] to u m/s^2, both of one period.

    looks_ahead: the controller knows the commands under way (`hil.design.stability.sampled_loop`).
    """
    omega = 2.0 * np.pi * np.asarray(f_Hz, float)
    omega[0] = NEAR_ZERO * omega[1]
    G = axis.response(omega)[:, :, 0]
    C = controller.response(omega)[:, 0, :]
    S = 1.0 / (1.0 + (C * G).sum(axis=1))
    P = G[:, 0] * S
    by_rate = P * C[:, 1]
    if looks_ahead:
        P = P * C[:, 0] / controller.D[0, 0]
    return AxisLoop(P, S, 1.0 - S, by_rate)


class Uncertainty(NamedTuple):
    """Bound of the relative plant error |P/P_0 - 1| of all axes over frequency."""

    f_Hz: Array
    """(m,), rising; unknown beyond the last."""
    bound: Array
    """(m,) relative plant error."""

    def at(self, f_Hz: Array) -> Array:
        """Bound at frequencies (n,) Hz: the first value below the first frequency, inf beyond the last."""
        return np.where(f_Hz <= self.f_Hz[-1], np.interp(f_Hz, self.f_Hz, self.bound), np.inf)


def stated(gain_error: float, delay_error_s: float, up_to_Hz: float) -> Uncertainty:
    """Bound of the plant error for a relative gain error and a delay error, s, of either sign.

    |(1 + g) exp(j w d) - 1| <= sqrt(g^2 + 4 (1 + g) sin^2(w d / 2)), from w d = pi on 2 + g; up to up_to_Hz.
    """
    f = np.linspace(0.0, up_to_Hz, 512)
    half = np.minimum(np.pi * f * delay_error_s, np.pi / 2.0)
    return Uncertainty(f, np.sqrt(gain_error**2 + 4.0 * (1.0 + gain_error) * np.sin(half) ** 2))


class Filter(NamedTuple):
    """A zero-phase low-pass: 1 up to FLAT of its end, half a cosine down to it, 0 beyond."""

    end_Hz: float

    def at(self, f_Hz: Array) -> Array:
        """Gain Q (n,) at frequencies (n,) Hz, 0 to 1."""
        edge = np.clip((f_Hz / self.end_Hz - FLAT) / (1.0 - FLAT), 0.0, 1.0)
        return np.asarray(0.5 + 0.5 * np.cos(np.pi * edge), np.float64) * (f_Hz < self.end_Hz)


class Choice(NamedTuple):
    """The chosen learning filter and the largest error ratio from run to run under it."""

    Q: Filter
    contraction: float
    """Largest |Q| c over frequency: bound of the error ratio from run to run."""
    at_Hz: float
    """Frequency of this maximum."""


def contraction(loops: Sequence[AxisLoop], f_Hz: Array, uncertainty: Uncertainty) -> Array:
    """Bound c (n,) of |1 - L P|, the error ratio from run to run, over all axes; inf where unknown."""
    W = uncertainty.at(f_Hz)
    S = np.max([np.abs(loop.S) for loop in loops], axis=0)
    T = np.max([np.abs(loop.T) for loop in loops], axis=0)
    with np.errstate(invalid="ignore"):
        left = 1.0 - W * T
    return np.where(left > 0.0, W * S / np.where(left > 0.0, left, 1.0), np.inf)


def choose(c: Array, f_Hz: Array, most: float = CONTRACTION) -> Choice:
    """Widest filter with |Q| c <= most at each frequency. Raises ModelError if no filter qualifies."""
    finite = np.where(np.isfinite(c), c, 1e300)
    top = float(f_Hz[-1])
    for end in np.geomspace(top, min(LEAST_HZ, top), STEPS):
        Q = Filter(float(end))
        share = Q.at(f_Hz) * finite
        if share.max() <= most:
            worst = int(share.argmax())
            return Choice(Q, float(share[worst]), float(f_Hz[worst]))
    low = f_Hz <= LEAST_HZ
    worst = int(np.where(low, c, 0.0).argmax())
    raise ModelError(
        f"no filter makes the error fall: from run to run it may be multiplied by {c[worst]:.3g} at "
        f"{f_Hz[worst]:.3g} Hz, allowed: at most {most:g} from 0 to {LEAST_HZ:g} Hz. The uncertainty is too "
        "large for this loop: identify the axes (hil identify), and learn with --axes"
    )
