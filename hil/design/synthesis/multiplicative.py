"""Axes that were measured: by how much they differ from the nominal one, and what a loop makes of that.

|P / P0 - 1| <= w(omega) of each axis. One axis is stable whatever P is if and only if |w T| < 1 everywhere, T
of the nominal loop (J. C. Doyle, B. A. Francis, A. R. Tannenbaum, *Feedback Control Theory*, 1992, 4.2). Six
that a wrong inertia Gamma couples are if the spectral radius of |w T_6| is below 1, element by element,
T_6 = L Gamma (I + L Gamma)^-1 (S. Skogestad and I. Postlethwaite, *Multivariable Feedback Control*, 2nd
edition, 2005, 8.7 and A.3).
"""

from collections.abc import Iterable, Sequence
from itertools import product
from math import pi
from typing import NamedTuple, TypeVar

import numpy as np

from drivers.arrays import Array, ComplexArray
from hil.config.axis_model import AxisModel
from hil.config.design import Design, TransferFunction
from hil.design.synthesis.weights import control_weight, rational
from hil.mathematics.linear_system import LinearSystem

Key = TypeVar("Key")
SPARE = 1.01
"""A cover is wider by this factor than what it has to cover."""
CORNER = 0.4
"""Times the Nyquist frequency: highest pole of a cover. A controller takes it over."""
BEYOND = 0.5
"""Times the Nyquist frequency: up to there the bound goes on in proportion, beyond it stays."""


class Relative(NamedTuple):
    """w(omega), at rising frequencies. Below the first as there, beyond the last rising in proportion."""

    omega: Array
    """(n,) rad/s."""
    bound: Array
    """(n,)"""
    flat_rad_s: float
    """From here on it rises no more."""

    def at(self, omega: Array) -> Array:
        """Return w at other frequencies, rad/s."""
        beyond = np.clip(omega, self.omega[-1], max(self.flat_rad_s, self.omega[-1])) / self.omega[-1]
        return np.asarray(np.interp(np.log(omega), np.log(self.omega), self.bound) * beyond, float)


class Margin(NamedTuple):
    """How near a loop comes to what it stands."""

    norm: float
    """Largest |w T|, or spectral radius of |w T_6|; the loop stands the uncertainty below 1."""
    at_rad_s: float


def relative(model: AxisModel, gain: float) -> Relative:
    """Return what all six measured axes differ by, at most, from one of this gain.

    |g_i / g (1 + w_i) - 1| <= |g_i / g - 1| + g_i / g |w_i|.
    """
    profile = model.uncertainty
    ratio = np.array(model.nominal.gain)[:, None] / gain
    bound = (np.abs(ratio - 1.0) + ratio * np.array(profile.bound)).max(axis=0)
    return Relative(2.0 * pi * np.array(profile.frequency_Hz), bound, BEYOND * pi * model.rate_Hz)


def frequencies(rate_Hz: float) -> Array:
    """Return the frequencies, rad/s, at which loops are looked at: to the Nyquist frequency."""
    return np.asarray(np.geomspace(1e-4, 1.0, 1200) * pi * rate_Hz)


def tightest(
    omega: Array, values: Array, corner: float, shapes: Iterable[tuple[Key, Array]], least: float = 0.0
) -> tuple[float, Key]:
    """Return k and which of the shapes (n,) is the tightest above all values, with some to spare.

    Tightest is the least mean of log(k shape / value) up to the corner; a later one by more than `least`.
    """
    below = omega <= corner
    best: tuple[float, float, Key] | None = None
    for key, shape in shapes:
        k = SPARE * float((values / shape).max())
        excess = float(np.log(k * shape[below] / values[below]).mean())
        if best is None or excess < best[0] - least:
            best = excess, k, key
    assert best is not None
    return best[1:]


def cover(omega: Array, values: Array, corner: float) -> TransferFunction:
    """Return the tightest k ((s / z + 1) / (s / p + 1))^n above all values; n up to 2, z, p to `corner`."""
    s = 1j * omega
    corners = np.geomspace(max(omega[0], 1e-3 * corner), corner, 60)
    shapes = (
        ((n, z, p), np.abs((s / z + 1.0) / (s / p + 1.0)) ** n)
        for n, z, p in product((1, 2), corners, corners)
    )
    k, (n, z, p) = tightest(omega, values, corner, shapes, 1e-6)
    top, bottom = (np.poly1d([1.0 / x, 1.0]) ** n for x in (z, p))
    return TransferFunction(numerator=list(k * top.coeffs), denominator=list(bottom.coeffs))


def covered(design: Design, measured: Relative, gain: float) -> Design:
    """Return the design with a control weight that covers the uncertainty, too: |W_u W_d| >= gain w.

    W_u T W_d / gain is a path of the problem, over what lag and drive leave of it, which is no more than 1:
    where gamma is below 1, so is |w T|.
    """
    omega = frequencies(design.rate_Hz)
    amplitude = design.weights.disturbance.amplitude_m_s2
    asked = np.abs(control_weight(design.weights.control, design.rate_Hz).response(omega)[:, 0, 0])
    least = gain * measured.at(omega) / amplitude
    if (asked >= least).all():
        return design
    weight = cover(omega, np.maximum(asked, least), CORNER * pi * design.rate_Hz)
    return design.model_copy(update={"weights": design.weights.model_copy(update={"control": weight})})


def cover_system(measured: Relative, rate_Hz: float) -> LinearSystem:
    """Return a stable system whose gain is w or more, as a weight of a structured problem."""
    omega = frequencies(rate_Hz)
    return rational(cover(omega, measured.at(omega), CORNER * pi * rate_Hz), "cover of the measured axes")


def margin(
    measured: Relative, L: LinearSystem, rate_Hz: float, Gammas: Sequence[Array] = (np.eye(1),)
) -> Margin:
    """Return the largest |w T| of a sampled loop L, opened at u, and where it is.

    Gammas (6, 6): couplings; then the spectral radius of |w T_6|, L times each of them.
    """
    omega = frequencies(rate_Hz)
    L_w: ComplexArray = L.response(omega)
    worst = np.zeros(len(omega))
    for Gamma in Gammas:
        T = np.linalg.solve(np.eye(len(Gamma)) + L_w * Gamma, L_w * Gamma)
        worst = np.maximum(worst, np.abs(np.linalg.eigvals(np.abs(T))).max(axis=1))
    worst *= measured.at(omega)
    k = int(np.argmax(worst))
    return Margin(float(worst[k]), float(omega[k]))
