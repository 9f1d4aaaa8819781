"""The problem of a design at the ticks, around the axis as the loop meets it: held, late, exact.

No approximation of the axis; the rational model of the synthesis is judged by it.
"""

from collections.abc import Sequence

import numpy as np

from hil.config.design import Design, DesignAxis
from hil.design.stability.sampled_loop import disturbed
from hil.design.stability.sampled_loop import sampled_axis as exact_axis
from hil.design.synthesis.axis import around, drive, weighted
from hil.mathematics.linear_system import LinearSystem


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
    """Return the weighted problem of `generalised_plant`, around the sampled axis."""
    return weighted(design, around(sampled_axis(axis, design.rate_Hz, design.inputs)))
