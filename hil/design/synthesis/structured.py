"""The axis with bounded uncertainty of inertia, delay and drives: M, and Delta around it.

    e'' = -(v + d) / (1 + r delta)
    v = gain (1 + W_lag Delta_lag + W Delta (1 + W_lag Delta_lag)) drive (1 + W_delay Delta_delay) delay u

W Delta is the relative error of measured axes from the nominal one, if there are any (module multiplicative).
delta is the inertia's relative error over its range r. It enters exactly, but the bounds treat delta as
complex. A disc around the nominal value covers delay and lag at every frequency: a multiplicative weight (S.
Skogestad and I. Postlethwaite, *Multivariable Feedback Control*, 2nd edition, 2005, section 7.4). Delta
contains more than the real axes: a property of all of Delta holds for them, too.
"""

from math import pi
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import SynthesisError
from hil.config.design import Design, DesignAxis, UncertaintyRanges
from hil.design.synthesis import multiplicative
from hil.design.synthesis.axis import drive, pade
from hil.design.synthesis.mu import Block
from hil.design.synthesis.multiplicative import CORNER, Relative, tightest
from hil.design.synthesis.weights import control_weight, error_weight, noise, rational
from hil.mathematics.linear_system import LinearSystem, static

Sum = dict[str, float]
"""Signals and their factors; a signal is an external input, or the output of the part of that name."""


class Structured(NamedTuple):
    """Weighted problem from [w of each block of Delta, d, noise, u] to [z of each block, W_e e, W_u u, y]."""

    plant: LinearSystem
    blocks: list[Block]
    """Inertia, delay, lag, then the error of measured axes, if any; the last is performance, from
    [d, noise] to [W_e e, W_u u].
    """
    n_y: int


def transport_error(
    omega: Array, transport_ms: tuple[float, float], nominal_ms: float, rate_Hz: float, order: int
) -> Array:
    """Largest |hold exp(-j omega T) / nominal - 1| over all T of a range, at each omega.

    The hold of one period is exact, (1 - exp(-s h)) / (s h); nominal is the Pade approximation of the nominal
    delay and half a period. Over the range of T one number turns around the origin. Its largest distance from
    1 is at an end of the range, or opposite to 1.
    """
    h = 1.0 / rate_Hz
    nominal = pade(1e-3 * nominal_ms + 0.5 * h, order).response(omega)[:, 0, 0]
    hold = np.sinc(omega * h / (2.0 * pi)) * np.exp(-0.5j * omega * h)
    ends = [hold * np.exp(-1e-3j * omega * T) / nominal for T in transport_ms]
    start = -np.angle(ends[0])
    opposite = start + np.mod(pi - start, 2.0 * pi)
    passed = opposite <= start + 1e-3 * omega * (transport_ms[1] - transport_ms[0])
    farthest = np.maximum(np.abs(ends[0] - 1.0), np.abs(ends[1] - 1.0))
    return np.asarray(np.where(passed, np.abs(hold) + 1.0, farthest), float)


def lag_error(omega: Array, lag_ms: tuple[float, float], nominal_ms: float) -> Array:
    """Largest |(tau0 s + 1) / (tau s + 1) - 1| over all tau of a range, at each omega.

    |tau0 - tau| omega / |1 + j tau omega| grows with the distance from tau0 on either side, to the ends.
    """
    errors = [1e-3 * abs(nominal_ms - tau) * omega / np.abs(1.0 + 1e-3j * tau * omega) for tau in lag_ms]
    return np.asarray(np.max(errors, axis=0))


def cover(omega: Array, error: Array, corner: float) -> LinearSystem:
    """Tightest W with |W| >= `error` at all omega, with a margin of 1 %; both poles at `corner`.

        W = k s (s / z + 1) / (s / corner + 1)^2

    k fits the initial slope of the error, z its end. Tightest: smallest mean of log(|W| / error) below the
    corner, where the loop acts.
    """
    s = 1j * omega
    shapes = (
        (float(z), np.abs(s * (s / z + 1.0) / (s / corner + 1.0) ** 2))
        for z in np.geomspace(0.1, 0.99, 100) * corner
    )
    (k, z), c = tightest(omega, error, corner, shapes), corner
    # k (c^2 / z) s (s + z) / (s + c)^2, less its feed-through
    A, B = np.array([[-2.0 * c, -c], [c, 0.0]]), np.array([[1.0], [0.0]])
    end = k * c * c / z
    return LinearSystem(A, B, end * np.array([[z - 2.0 * c, -c]]), np.array([[end]]))


def covers(design: Design, axis: DesignAxis, ranges: UncertaintyRanges) -> tuple[LinearSystem, LinearSystem]:
    """Weights that cover the ranges of delay and lag; a controller inherits their corners.

    Raises SynthesisError if the nominal axis lies outside the ranges.
    """
    for name, value, (low, high) in (
        ("transport_ms", axis.transport_ms, ranges.transport_ms),
        ("lag_ms", axis.lag_ms, ranges.lag_ms),
    ):
        if not low <= value <= high:
            raise SynthesisError(
                f"nominal.{name}: {value:g}, allowed: within its range in uncertainty, {low:.4g} to "
                f"{high:.4g}; best near the middle"
            )
    omega = np.geomspace(0.1, 40.0 * pi * design.rate_Hz, 4000)
    corner = CORNER * pi * design.rate_Hz
    delay = transport_error(omega, ranges.transport_ms, axis.transport_ms, design.rate_Hz, design.delay_order)
    return cover(omega, delay, corner), cover(omega, lag_error(omega, ranges.lag_ms, axis.lag_ms), corner)


def structured_plant(
    design: Design, axis: DesignAxis, ranges: UncertaintyRanges, measured: Relative | None = None
) -> Structured:
    """Axis with its uncertainty and its weights.

    Raises SynthesisError for an invalid axis or weight.
    """
    W_delay, W_lag = covers(design, axis, ranges)
    W_d, W_n = design.weights.disturbance.amplitude_m_s2, noise(design)
    weights, names = design.weights, list(design.inputs)
    integrator = LinearSystem(np.zeros((1, 1)), np.eye(1), np.eye(1), np.zeros((1, 1)))
    acceleration: Sum = {"v": axis.gain, "w_lag": axis.gain, "d": W_d, "w_inertia": -ranges.inertia}
    parts: dict[str, tuple[LinearSystem, Sum]] = {
        "delayed": (pade(1e-3 * axis.transport_ms + 0.5 / design.rate_Hz, design.delay_order), {"u": 1.0}),
        "z_delay": (W_delay, {"delayed": 1.0}),
        "v": (drive(axis), {"delayed": 1.0, "w_delay": 1.0}),
        "z_lag": (W_lag, {"v": 1.0}),
        "rate": (integrator, acceleration),
        "position": (integrator, {"rate": 1.0}),
        "z_e": (error_weight(weights.error), {"position": -1.0}),
        "z_u": (control_weight(weights.control, design.rate_Hz), {"u": 1.0}),
    }
    causes, effects = ["w_inertia", "w_delay", "w_lag"], [acceleration, {"z_delay": 1.0}, {"z_lag": 1.0}]
    if measured is not None:
        omega = multiplicative.frequencies(design.rate_Hz)
        w = multiplicative.cover(omega, measured.at(omega), CORNER * pi * design.rate_Hz)
        parts["z_measured"] = rational(w, "cover of the measured axes"), {"v": 1.0, "w_lag": 1.0}
        acceleration["w_measured"] = axis.gain
        causes, effects = [*causes, "w_measured"], [*effects, {"z_measured": 1.0}]
    measured_signal = {"error": "position", "rate_error": "rate"}
    inputs = [*causes, "d", *(f"n_{name}" for name in names), "u"]
    y: list[Sum] = [{measured_signal[name]: -1.0, f"n_{name}": W} for name, W in zip(names, W_n, strict=True)]
    outputs: list[Sum] = [*effects, {"z_e": 1.0}, {"z_u": 1.0}, *y]
    blocks = [*(Block() for _ in causes), Block(1 + len(names), 2)]
    return Structured(wired(parts, inputs, outputs), blocks, len(names))


def wired(parts: dict[str, tuple[LinearSystem, Sum]], inputs: list[str], outputs: list[Sum]) -> LinearSystem:
    """System from `inputs` to `outputs`; each part has one input, a sum, and one output, its name.

    Raises ModelError for a ring of parts without states that has no solution.
    """
    names, m = list(parts), len(inputs)
    body = static(np.eye(m))
    for system, _ in parts.values():
        body = body.beside(system)

    def rows(sums: list[Sum], signals: list[str]) -> Array:
        return np.array([[one.get(signal, 0.0) for signal in signals] for one in sums])

    feeds = [feed for _, feed in parts.values()]
    # from [inputs; fed] to [outputs; parts' outputs], then parts' outputs back to what they feed
    E, F, n = rows(feeds, inputs), rows(feeds, names), len(names)
    into = static(np.block([[np.eye(m), np.zeros((m, n))], [E, np.eye(n)]]))
    out = static(np.block([[rows(outputs, inputs), rows(outputs, names)], [np.zeros((n, m)), np.eye(n)]]))
    return out.after(body).after(into).closed_with(static(F))
