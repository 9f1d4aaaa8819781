"""The loop of a sampled controller and the delayed axis that inverse dynamics leaves: the axis, and margins.

The axis is gain exp(-transport s) D(s) / s^2 behind a hold of one period, D the force loop of the drives,
from demanded acceleration to measured position and rate; it is sampled exactly, also where the transport is
no whole number of periods.
"""

from collections.abc import Callable, Iterator
from math import ceil, inf, pi
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray
from hil.config.linear_controller import LinearController
from hil.mathematics.linear_system import LinearSystem, held

SLOWEST = 1e-5
"""Of the Nyquist frequency: where margins are looked for from."""


class Margins(NamedTuple):
    """How much a stable loop can bear of one thing at a time; inf where it bears any amount."""

    gain_up: float
    """Times which the gain may grow."""
    gain_down: float
    """Times which it may become; 0 where it may become as small as it likes."""
    phase_deg: float
    delay_s: float
    """Further pure delay."""
    crossover_rad_s: float
    """The highest frequency at which the loop's gain is 1; 0 for none."""
    peak_S: float
    """Of |1 / (1 + L)|: the loop stays 1 over it away from -1."""
    peak_T: float
    """Of |L / (1 + L)|."""


def sampled_axis(
    transport_s: float,
    drive: LinearSystem,
    period_s: float,
    gain: float | Array = 1.0,
    stiffness: Array | None = None,
) -> LinearSystem:
    """Return axes at the samples: from held accelerations to positions and rates, their first states.

    `drive` is the force loop of each, continuous: `hil.mathematics.linear_system.lag`, or one of higher
    order. gain: of one axis, or (m, m): accelerations of m axes per force of each, then with a stiffness
    (m, m) of their own, which answers at once.
    """
    mobility = np.atleast_2d(gain)
    m = len(mobility)
    n = 2 * m + m * drive.order
    A, B, each = np.zeros((n, n)), np.zeros((n, m)), np.eye(m)  # of positions, rates, and the drives
    A[:m, m : 2 * m] = each
    if stiffness is not None:
        A[m : 2 * m, :m] = -mobility @ stiffness
    A[m : 2 * m, 2 * m :], B[m : 2 * m] = mobility @ np.kron(each, drive.C), mobility @ np.kron(each, drive.D)
    A[2 * m :, 2 * m :], B[2 * m :] = np.kron(each, drive.A), np.kron(each, drive.B)
    return late_states(A, B, 2 * m, transport_s, period_s)


def late_states(A: Array, B: Array, outputs: int, transport_s: float, period_s: float) -> LinearSystem:
    """Return dx/dt = A x + B u of held inputs, `transport_s` late, at the samples, to its first states.

    A (n, n), B (n, m); outputs: how many of the states.
    """
    whole = ceil(transport_s / period_s - 1e-9)
    late = max(whole * period_s - transport_s, 0.0)  # so long before the sample the newer input already acts
    n, m = B.shape
    _, newer = held(A, B, late)
    Phi, both = held(A, B, period_s)
    older = both - newer
    # the last inputs, the newest first
    size = n + whole * m
    F, G = np.zeros((size, size)), np.zeros((size, m))
    F[:n, :n] = Phi
    if whole == 0:
        G[:n] = both
    else:
        F[:n, size - m :] += older
        if whole == 1:
            G[:n] += newer
        else:
            F[:n, size - 2 * m : size - m] += newer
        F[n + m :, n : size - m] = np.eye((whole - 1) * m)
        G[n : n + m] = np.eye(m)
    return LinearSystem(F, G, np.eye(outputs, size), np.zeros((outputs, m)), period_s)


def disturbed(axis: LinearSystem) -> LinearSystem:
    """Return a `sampled_axis` with a second input: an acceleration that acts at once, held too."""
    T = axis.period_s
    assert T is not None
    push = np.zeros((axis.order, 1))
    push[:2, 0] = T * T / 2.0, T
    return axis._replace(B=np.hstack([axis.B, push]), D=np.zeros((2, 2)))


def sampled_controller(controller: LinearController) -> LinearSystem:
    """Return a file's controller as a system from [e, de] to u."""
    chosen = np.eye(2)[[("error", "rate_error").index(name) for name in controller.inputs]]
    n, m = len(controller.A), len(controller.inputs)
    B = np.array(controller.B, float).reshape(n, m) @ chosen
    A, C = np.array(controller.A, float).reshape(n, n), np.array(controller.C, float)
    return LinearSystem(A, B, C, np.array(controller.D, float) @ chosen, 1.0 / controller.rate_Hz)


def grid(period_s: float) -> Array:
    """Return frequencies up to Nyquist's, rad/s: dense in their logarithm, and in themselves at the end."""
    top = pi / period_s
    return np.unique(
        np.concatenate([np.geomspace(SLOWEST * top, top, 2500), np.linspace(1e-3 * top, top, 1500)])
    )


def root(f: Callable[[float], float], low: float, high: float) -> float:
    """Return where a function that has two signs at the ends of an interval is 0, by bisection."""
    begins = f(low) > 0.0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if (f(middle) > 0.0) == begins else (low, middle)
    return high


def crossings(loci: Callable[[Array], ComplexArray], omega: Array) -> Iterator[tuple[float, float]]:
    """Yield where a locus (n, k) of rising frequencies, rad/s, has magnitude 1, and its angle from -1."""
    size = np.abs(loci(omega))
    for i, k in np.argwhere(np.diff(np.sign(size - 1.0), axis=0) != 0):

        def at(w: float, k: int = k) -> complex:
            return complex(loci(np.array([w]))[0, k])

        w = root(lambda w: abs(at(w)) - 1.0, omega[i], omega[i + 1])
        yield w, float(np.angle(at(w))) + pi


def margins(loop: LinearSystem) -> Margins:
    """Return the margins of a stable loop, sampled, one input L one output: 1 + L(z) = 0 is its edge."""
    assert loop.period_s is not None

    def L(omega: Array) -> ComplexArray:
        return np.asarray(loop.response(omega)[:, :, 0], np.complex128)

    omega = grid(loop.period_s)
    value = L(omega)[:, 0]
    at_real = [value[-1].real]  # at half the rate the response is real
    for k in np.flatnonzero(np.diff(np.sign(value.imag[:-1])) != 0):
        w = root(lambda w: L(np.array([w]))[0, 0].imag, omega[k], omega[k + 1])
        at_real.append(L(np.array([w]))[0, 0].real)
    factors = [-1.0 / real for real in at_real if real < 0.0]
    met = list(crossings(L, omega))  # what may still be lost until -1 is in 0 .. 2 pi
    phase = min((min(left, 2.0 * pi - left) for _, left in met), default=inf)
    return Margins(
        min((f for f in factors if f > 1.0), default=inf),
        max((f for f in factors if f <= 1.0), default=0.0),
        float(np.degrees(phase)),
        min((left / w for w, left in met), default=inf),
        max((w for w, _ in met), default=0.0),
        float(np.abs(1.0 / (1.0 + value)).max()),
        float(np.abs(value / (1.0 + value)).max()),
    )
