"""Weights from physical numbers: what the loop has to stand, and what it may do."""

from math import pi

import numpy as np
from scipy.signal import tf2ss

from drivers.arrays import Array
from drivers.errors import SynthesisError
from hil.config.design import ControlWeight, Design, ErrorWeight, TransferFunction
from hil.mathematics.linear_system import LinearSystem, static

BEYOND = 2.0 * pi
"""Times the rate in Hz, rad/s: the control weight is flat from there, so that it is proper."""


def shelf(low: float, high: float, corner: float) -> LinearSystem:
    """Return high (s + corner) / (s + corner high / low): gain `low` at rest, `high` at infinity."""
    pole = corner * high / low
    A, C, D = (np.array([[x]]) for x in (-pole, high * (corner - pole), high))
    return LinearSystem(A, np.eye(1), C, D)


def rational(section: TransferFunction, what: str) -> LinearSystem:
    """Return a rational function as a system.

    Raises SynthesisError: it is improper, or no function at all.
    """
    numerator, denominator = (np.trim_zeros(p, "f") for p in (section.numerator, section.denominator))
    if not len(denominator):
        raise SynthesisError(f"{what}: the denominator is zero")
    if len(numerator) > len(denominator):
        raise SynthesisError(
            f"{what}: improper, a numerator of degree {len(numerator) - 1} over a denominator of degree "
            f"{len(denominator) - 1}, allowed: no higher than the denominator's; close it by a pole far out"
        )
    if len(denominator) == 1:
        return static(np.array([[(numerator[0] if len(numerator) else 0.0) / denominator[0]]]))
    return LinearSystem(*tf2ss(numerator or [0.0], denominator))


def error_weight(section: ErrorWeight | TransferFunction) -> LinearSystem:
    """Return W_e with 1 / |W_e| = the error allowed: (s + w_b) / (s + w_b low / peak) / peak.

    Raises SynthesisError for a rational function that is no weight.
    """
    if isinstance(section, TransferFunction):
        return _checked(section, "weights.error")
    return shelf(1.0 / section.low_m, 1.0 / section.peak_m, section.bandwidth_rad_s)


def control_weight(section: ControlWeight | TransferFunction, rate_Hz: float) -> LinearSystem:
    """Return W_u with 1 / |W_u| = the demand allowed: limit, falling above roll_off, flat above 2 pi rate.

    Without roll_off it is a constant: the roll-off is left to the noise, and the controller has a state less.

    Raises SynthesisError where it rolls off above half Nyquist, since nothing of the controller may act
    there, and for a rational function that is no weight.
    """
    if isinstance(section, TransferFunction):
        return _checked(section, "weights.control", biproper=True)
    corner = section.roll_off_rad_s
    if corner is None:
        return static(np.array([[1.0 / section.limit_m_s2]]))
    if corner > pi * rate_Hz / 2.0:
        raise SynthesisError(
            f"weights.control.roll_off_rad_s: {corner:g}, allowed: up to half the Nyquist frequency, "
            f"{pi * rate_Hz / 2:.0f} rad/s at {rate_Hz:g} Hz"
        )
    return shelf(1.0 / section.limit_m_s2, BEYOND * rate_Hz / corner / section.limit_m_s2, corner)


def noise(design: Design) -> Array:
    """Return the amplitude of the noise of each input (n,), at every frequency."""
    given = design.weights.noise
    amplitudes = {"error": given.error_m, "rate_error": given.rate_error_m_s or 0.0}
    return np.array([amplitudes[name] for name in design.inputs])


def _checked(section: TransferFunction, what: str, *, biproper: bool = False) -> LinearSystem:
    weight = rational(section, what)
    if not weight.is_stable():
        raise SynthesisError(
            f"{what}: unstable, a pole at {max(weight.poles().real):.3g} rad/s, allowed: all left of 0, "
            "since no controller moves the poles of a weight; instead of an integrator take a slow pole"
        )
    if biproper and not weight.D.any():
        raise SynthesisError(
            f"{what}: rolls off, so that high frequency would cost nothing, allowed: a numerator of the "
            "denominator's degree"
        )
    return weight
