"""The problem of a design at the ticks, around the axis as the loop meets it: held, late, exact.

No approximation of the axis; the rational model of the synthesis is judged by it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.config.design import Design, DesignAxis
from hil.mathematics.linear_system import LinearSystem, static
from hil.stability.sampled_loop import disturbed
from hil.stability.sampled_loop import sampled_axis as exact_axis
from hil.synthesis.axis import drive
from hil.synthesis.weights import control_weight, disturbance_weight, error_weight, noise_weight


def sampled_axis(axis: DesignAxis, rate_Hz: float, inputs: Sequence[str]) -> LinearSystem:
    """Return the axis from [d, u] to [e, measured inputs], d held for a period like u."""
    behind = exact_axis(1e-3 * axis.transport_ms, drive(axis), 1.0 / rate_Hz, axis.gain)
    legs = disturbed(behind)
    rows = {"error": 0, "rate_error": 1}
    y = -legs.C[[0, *(rows[name] for name in inputs)]]
    return LinearSystem(legs.A, legs.B[:, [1, 0]], y, np.zeros((len(y), 2)), legs.period_s)


def loop_gain(K: LinearSystem, axis: LinearSystem) -> LinearSystem:
    """Return L, opened at u, of a sampled controller and `sampled_axis`: the loop is closed by 1 + L."""
    return K.after(axis._replace(B=axis.B[:, 1:], C=-axis.C[1:], D=-axis.D[1:, 1:]))


def sampled_problem(design: Design, axis: DesignAxis) -> LinearSystem:
    """Return the weighted problem of `generalised_plant`, around the sampled axis.

    From [d, noise, u] to [W_e e, W_u u, y] at the ticks. Weights are mapped bilinearly: they matter far below
    the Nyquist frequency.
    """
    n, h, weights = len(design.inputs), 1.0 / design.rate_Hz, design.weights
    legs = sampled_axis(axis, design.rate_Hz, design.inputs)
    # [d, noise, u] -> [d, u, noise, u] -> [e, y without noise, noise, u] -> [e, u, y]
    order = static(np.eye(n + 2)[[0, n + 1, *range(1, n + 2)]], h)
    out = np.zeros((n + 2, 2 * n + 2))
    out[0, 0] = out[1, -1] = 1.0
    out[2:, 1 : n + 1] = out[2:, n + 1 : 2 * n + 1] = np.eye(n)
    core = static(out, h).after(legs.beside(static(np.eye(n + 1), h))).after(order)
    into = (
        _at(disturbance_weight(design), h).beside(_at(noise_weight(design), h)).beside(static(np.eye(1), h))
    )
    outer = _at(error_weight(weights.error), h).beside(
        _at(control_weight(weights.control, design.rate_Hz), h)
    )
    return outer.beside(static(np.eye(n), h)).after(core).after(into)


def _at(weight: LinearSystem, period_s: float) -> LinearSystem:
    return weight.sampled(period_s, "bilinear") if weight.order else static(weight.D, period_s)
