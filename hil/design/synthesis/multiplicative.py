"""Uncertainty of measured axes: relative error from the nominal axis, and robustness of a loop to it.

|P / P0 - 1| <= w(omega) for each axis. One axis is stable for every such P if and only if |w T| < 1
everywhere, T of the nominal loop (J. C. Doyle, B. A. Francis, A. R. Tannenbaum, *Feedback Control Theory*,
1992, 4.2). Six axes that an inertia error Gamma couples are stable if the spectral radius of |w T_6| is below
1, element by element, T_6 = L Gamma (I + L Gamma)^-1 (S. Skogestad and I. Postlethwaite, *Multivariable
Feedback Control*, 2nd edition, 2005, 8.7 and A.3).
"""

from collections.abc import Iterable, Sequence
from itertools import product
from math import pi
from typing import NamedTuple, TypeVar

import numpy as np

from drivers.arrays import Array, ComplexArray
from hil.config.axis_model import AxisModel
from hil.config.design import Design, TransferFunction
from hil.design.synthesis.weights import control_weight
from hil.mathematics.linear_system import LinearSystem

Key = TypeVar("Key")
SPARE = 1.01
"""Factor by which a cover exceeds the values below it."""
CORNER = 0.4
"""Highest pole of a cover, as a share of the Nyquist frequency. A controller inherits this pole."""
BEYOND = 0.5
"""Share of the Nyquist frequency up to which the bound is extrapolated in proportion; constant above."""


class Relative(NamedTuple):
    """Bound w(omega) at rising frequencies: constant below the first, rising as omega above the last."""

    omega: Array
    """(n,) rad/s, frequencies in rising order."""
    bound: Array
    """(n,) bound w on the relative error."""
    flat_rad_s: float
    """Frequency, rad/s, above which the bound is constant."""

    def at(self, omega: Array) -> Array:
        """Bound w (n,), interpolated at the frequencies omega (n,) rad/s."""
        beyond = np.clip(omega, self.omega[-1], max(self.flat_rad_s, self.omega[-1])) / self.omega[-1]
        return np.asarray(np.interp(np.log(omega), np.log(self.omega), self.bound) * beyond, float)


class Margin(NamedTuple):
    """Robustness of a loop to the uncertainty of the measured axes."""

    norm: float
    """Largest |w T|, or spectral radius of |w T_6|; below 1 the loop is robustly stable."""
    at_rad_s: float


def relative(model: AxisModel, gain: float) -> Relative:
    """Largest relative error of all six measured axes from an axis of this gain.

    |g_i / g (1 + w_i) - 1| <= |g_i / g - 1| + g_i / g |w_i|.
    """
    profile = model.uncertainty
    ratio = np.array(model.nominal.gain)[:, None] / gain
    bound = (np.abs(ratio - 1.0) + ratio * np.array(profile.bound)).max(axis=0)
    return Relative(2.0 * pi * np.array(profile.frequency_Hz), bound, BEYOND * pi * model.rate_Hz)


def frequencies(rate_Hz: float) -> Array:
    """Frequencies up to the Nyquist frequency, rad/s, for the analysis of loops."""
    return np.asarray(np.geomspace(1e-4, 1.0, 1200) * pi * rate_Hz)


def tightest(
    omega: Array, values: Array, corner: float, shapes: Iterable[tuple[Key, Array]], least: float = 0.0
) -> tuple[float, Key]:
    """Factor k and key of the shape (n,) that covers all values most tightly, with margin SPARE.

    Tightest: smallest mean of log(k shape / value) up to the corner. A later shape must be better by `least`.
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
    """Tightest k ((s / z + 1) / (s / p + 1))^n above `values` at `omega`; n 1 or 2, z and p to `corner`."""
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
    """Design whose control weight also covers the uncertainty: |W_u W_d| >= gain w.

    W_u T W_d / gain is a path of the problem, divided by the response of lag and drive, which is at most 1.
    Therefore gamma < 1 implies |w T| < 1.
    """
    omega = frequencies(design.rate_Hz)
    amplitude = design.weights.disturbance.amplitude_m_s2
    stated = np.abs(control_weight(design.weights.control, design.rate_Hz).response(omega)[:, 0, 0])
    least = gain * measured.at(omega) / amplitude
    if (stated >= least).all():
        return design
    weight = cover(omega, np.maximum(stated, least), CORNER * pi * design.rate_Hz)
    return design.model_copy(update={"weights": design.weights.model_copy(update={"control": weight})})


def margin(
    measured: Relative, L: LinearSystem, rate_Hz: float, Gammas: Sequence[Array] = (np.eye(1),)
) -> Margin:
    """Largest |w T| of a sampled loop L, opened at u, and its frequency.

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
