"""Weights of a synthesis from physical numbers: disturbance, noise, allowed error, allowed control."""

from math import pi

import numpy as np
from scipy.signal import tf2ss

from drivers.arrays import Array
from drivers.errors import SynthesisError
from hil.config.design import ControlWeight, Design, ErrorWeight, TransferFunction
from hil.mathematics.linear_system import LinearSystem, static

BEYOND = 2.0 * pi
"""Frequency, rad/s per Hz of the loop's rate, above which the control weight is flat, and so proper."""


def shelf(low: float, high: float, corner: float) -> LinearSystem:
    """Shelf high (s + corner) / (s + corner high / low): gain `low` at rest, `high` at infinity."""
    pole = corner * high / low
    A, C, D = (np.array([[x]]) for x in (-pole, high * (corner - pole), high))
    return LinearSystem(A, np.eye(1), C, D)


def rational(section: TransferFunction, what: str) -> LinearSystem:
    """Linear system of a rational function of s.

    Raises SynthesisError for an improper function or a zero denominator.
    """
    numerator, denominator = (np.trim_zeros(p, "f") for p in (section.numerator, section.denominator))
    if not len(denominator):
        raise SynthesisError(f"{what}: the denominator is zero")
    if len(numerator) > len(denominator):
        raise SynthesisError(
            f"{what}: improper, a numerator of degree {len(numerator) - 1} over a denominator of degree "
            f"{len(denominator) - 1}, allowed: at most the denominator's; add a fast pole"
        )
    if len(denominator) == 1:
        return static(np.array([[(numerator[0] if len(numerator) else 0.0) / denominator[0]]]))
    return LinearSystem(*tf2ss(numerator or [0.0], denominator))


def error_weight(section: ErrorWeight | TransferFunction) -> LinearSystem:
    """Error weight W_e with 1 / |W_e| = allowed error: (s + w_b) / (s + w_b low / peak) / peak.

    Raises SynthesisError for a rational function that is no weight.
    """
    if isinstance(section, TransferFunction):
        return _checked(section, "weights.error")
    return shelf(1.0 / section.low_m, 1.0 / section.peak_m, section.bandwidth_rad_s)


def control_weight(section: ControlWeight | TransferFunction, rate_Hz: float) -> LinearSystem:
    """Control weight W_u, 1 / |W_u| = allowed control: limit, falling above roll_off, flat above 2 pi rate.

    Without roll_off it is a constant: the noise alone causes the roll-off, and the controller has one state
    less.

    Raises SynthesisError for a roll-off above half Nyquist, where the controller must not act, and for an
    invalid rational function.
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
    """Amplitude (n,) of the noise of each controller input, m or m/s, equal at all frequencies."""
    given = design.weights.noise
    amplitudes = {"error": given.error_m, "rate_error": given.rate_error_m_s or 0.0}
    return np.array([amplitudes[name] for name in design.inputs])


def _checked(section: TransferFunction, what: str, *, biproper: bool = False) -> LinearSystem:
    weight = rational(section, what)
    if not weight.is_stable():
        raise SynthesisError(
            f"{what}: unstable, a pole at {max(weight.poles().real):.3g} rad/s, allowed: all below 0: "
            "no controller moves the poles of a weight; replace an integrator by a slow pole"
        )
    if biproper and not weight.D.any():
        raise SynthesisError(
            f"{what}: rolls off, which leaves high frequency without weight, allowed: a numerator of the "
            "denominator's degree"
        )
    return weight
