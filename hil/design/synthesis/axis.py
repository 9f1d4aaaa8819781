"""The axis of the linearised loop, and the four-block problem around it.

Model and feed-forward turn each leg or pose axis into a double integrator. The law's correction u acts on it
with delay, the disturbance d (model error) without:

    e'' = -(gain a + d),  a = exp(-T s) / (lag s + 1) u,  T = transport + half a period.

The synthesis uses this rational model; its result is judged on the exact axis with hold and delay.
"""

from collections.abc import Sequence

import numpy as np
from scipy.signal import tf2ss
from scipy.special import comb, factorial

from drivers.errors import SynthesisError
from hil.config.design import Design, DesignAxis
from hil.design.stability.sampled_loop import disturbed
from hil.design.stability.sampled_loop import sampled_axis as exact_axis
from hil.design.synthesis.weights import control_weight, error_weight, noise, rational
from hil.mathematics.linear_system import LinearSystem, lag, static

ROWS = {"error": 0, "rate_error": 1}
"""Row of position and rate that each input of a controller measures."""


def pade(delay_s: float, order: int) -> LinearSystem:
    """Pade approximation of a delay, exp(-s T): all-pass, sum over k of c_k (-+ s T)^k."""
    if delay_s == 0.0:
        return static(np.eye(1))
    k = np.arange(order, -1, -1)
    c = comb(order, k) * factorial(2 * order - k) / factorial(order)
    A, B, C, D = tf2ss(c * (-1.0) ** k, c)  # of s T
    return LinearSystem(A / delay_s, B / delay_s, C, D)


def drive(axis: DesignAxis) -> LinearSystem:
    """Force loop of the drives: the lag, and the rational function `drive`, if any.

    Raises SynthesisError for a function that is improper, unstable, or without gain 1 at rest.
    """
    first = lag(1e-3 * axis.lag_ms)
    if axis.drive is None:
        return first
    further = rational(axis.drive, "nominal.drive")
    if not further.is_stable():
        raise SynthesisError(
            f"nominal.drive: unstable, a pole at {max(further.poles().real):.3g} rad/s, allowed: below 0"
        )
    at_rest = further.response(np.zeros(1))[0, 0, 0].real
    if abs(at_rest - 1.0) > 1e-3:
        raise SynthesisError(
            f"nominal.drive: gain {at_rest:.4g} at rest, allowed: 1; set the gain by key gain of the axis"
        )
    return further.after(first)


def actuator(axis: DesignAxis, rate_Hz: float, order: int) -> LinearSystem:
    """Rational system from u to the axis' acceleration: delay plus half a period, lag, gain."""
    delay = pade(1e-3 * axis.transport_ms + 0.5 / rate_Hz, order)
    path = drive(axis).after(delay)
    return path._replace(C=axis.gain * path.C, D=axis.gain * path.D)


def four_block(path: LinearSystem, inputs: Sequence[str]) -> LinearSystem:
    """Unweighted problem from [d, noise, u] to [e, u, y] of a 1/s^2 axis behind `path`, u to acceleration."""
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [-1.0]])
    C = np.eye(2)[[0, *(ROWS[name] for name in inputs)]]
    body = LinearSystem(A, B, C, np.zeros((len(C), 1)))
    acting = static(np.ones((1, 2))).after(static(np.eye(1)).beside(path))
    return around(body.after(acting))


def around(axis: LinearSystem) -> LinearSystem:
    """Synthesis problem from [d, noise, u] to [e, u, y] around an axis from [d, u] to [e, y]."""
    noise = [1] * (len(axis.C) - 1)
    B, C = np.insert(axis.B, noise, 0.0, axis=1), np.insert(axis.C, 1, 0.0, axis=0)
    D = np.insert(np.insert(axis.D, 1, 0.0, axis=0), noise, 0.0, axis=1)
    D[1, -1], D[2:, 1:-1] = 1.0, np.eye(len(noise))
    return LinearSystem(axis.A, B, C, D, axis.period_s)


def weighted(design: Design, core: LinearSystem) -> LinearSystem:
    """Weighted problem from [d, noise, u] to [W_e e, W_u u, y]; `core` leads from [d, noise, u] to [e, u, y].

    For a sampled axis weights are mapped bilinearly: they matter far below the Nyquist frequency.

    Raises SynthesisError for an invalid weight.
    """
    h = core.period_s

    def at(weight: LinearSystem) -> LinearSystem:
        return weight.sampled(h, "bilinear") if h and weight.order else weight._replace(period_s=h)

    error, control = design.weights.error, design.weights.control
    into = np.array([design.weights.disturbance.amplitude_m_s2, *noise(design), 1.0])
    out = at(error_weight(error)).beside(at(control_weight(control, design.rate_Hz)))
    core = core._replace(B=core.B * into, D=core.D * into)
    return out.beside(static(np.eye(len(design.inputs)), h)).after(core)


def loop_axis(design: Design, axis: DesignAxis) -> DesignAxis:
    """Axis for the synthesis; `lump_lag` replaces its lag by a dead time of similar phase."""
    if not design.lump_lag:
        return axis
    return axis.model_copy(update={"transport_ms": axis.transport_ms + axis.lag_ms, "lag_ms": 0.0})


def generalised_plant(design: Design, axis: DesignAxis) -> LinearSystem:
    """Weighted problem from [d, noise, u] to [W_e e, W_u u, y].

    Plain mixed sensitivity has no d. On 1/s^2 no input would excite the two modes at 0, and no gamma would
    bound their response. In this problem d excites them without a change of the axis.

    Raises SynthesisError for an invalid axis or weight.
    """
    path = actuator(loop_axis(design, axis), design.rate_Hz, design.delay_order)
    return weighted(design, four_block(path, design.inputs))


def sampled_axis(axis: DesignAxis, rate_Hz: float, inputs: Sequence[str]) -> LinearSystem:
    """Sampled axis from [d, u], held for a period, to [e, inputs of the controller]."""
    behind = exact_axis(1e-3 * axis.transport_ms, drive(axis), 1.0 / rate_Hz, axis.gain)
    legs = disturbed(behind)
    y = -legs.C[[0, *(ROWS[name] for name in inputs)]]
    return LinearSystem(legs.A, legs.B[:, [1, 0]], y, np.zeros((len(y), 2)), legs.period_s)


def loop_gain(K: LinearSystem, axis: LinearSystem) -> LinearSystem:
    """Loop L, opened at u, of a sampled controller and a `sampled_axis`; the closed loop has 1 + L."""
    return K.after(axis._replace(B=axis.B[:, 1:], C=-axis.C[1:], D=-axis.D[1:, 1:]))


def sampled_problem(design: Design, axis: DesignAxis) -> LinearSystem:
    """Weighted problem of `generalised_plant`, but around the exactly sampled axis."""
    return weighted(design, around(sampled_axis(axis, design.rate_Hz, design.inputs)))
