"""The closed loop of one axis as a learned acceleration meets it.

The axis G of `stability.sampled_loop` goes from the acceleration that is asked for to position and rate
at the samples; the law asks for u = C [e; de], and the learned acceleration a comes on top of it:

::

    e = -P a,   P = G_p / (1 + C G),   S = 1 / (1 + C G),   T = 1 - S

A law that looks ahead counts all that was asked for among the commands under way, a included. Of its
controller from [e; de] to u only the direct part D answers the measurement, and P = G_p / (1 + C G) C_p/D_p.
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray
from hil.mathematics.linear_system import LinearSystem

NEAR_ZERO = 1e-3
"""Share of the first frequency above 0 at which what belongs to 0 is taken: the axis is infinite there."""


class AxisLoop(NamedTuple):
    """One axis in closed loop, each (m,) at the frequencies of `frequencies`."""

    P: ComplexArray
    """s^2, from a learned acceleration to what it takes off the error."""
    S: ComplexArray
    """Sensitivity."""
    T: ComplexArray
    """Complementary sensitivity."""
    by_rate: ComplexArray
    """s, from what a rate is measured wrong by to the error."""


def frequencies(samples: int, period_s: float) -> Array:
    """Return the frequencies (m,) Hz of a real transform of so many samples."""
    return np.asarray(np.fft.rfftfreq(samples, period_s), np.float64)


def axis_loop(axis: LinearSystem, controller: LinearSystem, f_Hz: Array, *, looks_ahead: bool) -> AxisLoop:
    """Return the loop of a sampled axis and a controller from [e, de] to u, both of one period.

    looks_ahead: the controller knows the commands under way (`hil.design.stability.prediction`).
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
