"""The nominal axis: frequency response of a double integrator behind lag, delay and hold."""

from math import ceil

import numpy as np

from drivers.arrays import Array, ComplexArray


def axis_response(frequency_Hz: Array, period_s: float, transport_s: float, lag_s: float) -> ComplexArray:
    """Return the response (n,) s^2 of P(s) = exp(-transport s) / (lag s + 1) / s^2 behind a zero-order hold.

    From the samples of the demanded acceleration to those of the position, exactly: the hold makes steps of
    the samples, the step response of P without its delay is y(t) = t^2/2 - lag t + lag^2 (1 - exp(-t/lag)),
    and G(z) = (1 - 1/z) sum y(k T - transport) z^-k. That is the modified z-transform of a plant whose delay
    is no multiple of the period T (E. I. Jury, Theory and Application of the z-Transform Method, 1964). Far
    below the rate it is (1 - exp(-s T)) / (s T) P(s): at 30 Hz and 1 kHz within 0.001 %.
    """
    T, tau = period_s, lag_s
    w = np.exp(-2j * np.pi * np.asarray(frequency_Hz, float) * T)  # 1/z
    d = max(ceil(transport_s / T - 1e-12), 0)
    delta = d * T - transport_s  # of a period, what the first sample after the delay sees
    s0 = 1.0 / (1.0 - w)
    s1 = w * s0**2  # sum k w^k
    s2 = w * (1.0 + w) * s0**3  # sum k^2 w^k
    total = 0.5 * (T * T * s2 + 2.0 * T * delta * s1 + delta * delta * s0) - tau * (T * s1 + delta * s0)
    if tau > 1e-9 * T:
        total += tau * tau * (s0 - np.exp(-delta / tau) / (1.0 - np.exp(-T / tau) * w))
    return np.asarray((1.0 - w) * w**d * total, np.complex128)
