"""How far the sampled loop is from the edge: margins at the plant's input.

Rule of the room: of the exact sampled loop, on a grid dense enough to interpolate.
"""

from __future__ import annotations

from math import inf, pi
from typing import NamedTuple

import numpy as np

from hil.linear_system import ComplexArray, LinearSystem
from hil.signals import Array

POINTS = 8000
"""From 1e-4 of the Nyquist frequency to it, evenly in its logarithm: 0.12 % apart."""


class Margins(NamedTuple):
    """Of the loop opened at u; L = K P, 1 + L returns."""

    crossover_rad_s: float
    """The highest frequency at which |L| = 1."""
    phase_deg: float
    delay_ms: float
    """What the loop stands on top of the delay it has."""
    gain_up: float
    """Factor by which L may grow ..."""
    gain_down: float
    """... and the one down to which it may fall."""
    peak_S: float
    peak_T: float


def grid(period_s: float) -> Array:
    """Return the frequencies, rad/s."""
    return np.asarray(np.geomspace(1e-4, 1.0, POINTS) * pi / period_s)


def loop_gain(K: LinearSystem, axis: LinearSystem, omega: Array) -> ComplexArray:
    """Return L (len(omega),) of a controller and `sampled_axis`, in which e falls by what u does."""
    y = axis.response(omega)[:, 1:, 1:]
    return np.asarray(-(K.response(omega) @ y)[:, 0, 0])


def margins(K: LinearSystem, axis: LinearSystem) -> Margins:
    """Return the margins of a sampled controller with `sampled_axis`; the loop has to be stable."""
    assert axis.period_s is not None
    omega = grid(axis.period_s)
    L = loop_gain(K, axis, omega)
    size = np.log(np.abs(L))
    at = _crossings(size)
    phases = [(w, float(np.angle(-value))) for w, value in _values(omega, L, size, at)]  # from -1 to L
    crossover = max((w for w, _ in phases), default=0.0)
    real = _crossings(L.imag)
    gains = [value.real for _, value in _values(omega, L, L.imag, real) if value.real < 0.0]
    up = min((-1.0 / g for g in gains if g > -1.0), default=inf)
    down = max((-1.0 / g for g in gains if g < -1.0), default=0.0)
    return Margins(
        crossover,
        float(np.rad2deg(min((abs(p) for _, p in phases), default=pi))),
        1e3 * min((p % (2.0 * pi) / w for w, p in phases), default=inf),
        up,
        down,
        float(np.abs(1.0 / (1.0 + L)).max()),
        float(np.abs(L / (1.0 + L)).max()),
    )


def _crossings(values: Array) -> list[int]:
    return [int(k) for k in np.nonzero(np.diff(np.sign(values)))[0]]


def _values(omega: Array, L: ComplexArray, zero: Array, at: list[int]) -> list[tuple[float, complex]]:
    """Interpolate frequency and L to where `zero` passes through 0."""
    found = []
    for k in at:
        share = zero[k] / (zero[k] - zero[k + 1])
        w = omega[k] * (omega[k + 1] / omega[k]) ** share
        found.append((float(w), complex(L[k] + share * (L[k + 1] - L[k]))))
    return found
