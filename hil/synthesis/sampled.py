"""The axis as the loop meets it: sampled, behind a hold, with its delay to the fraction of a period.

Rule of the room: no approximation; the rational model of the synthesis is judged by it.

Between ticks the drives see a piecewise constant demand, shifted by the transport delay. With
T = (m + f) periods the demand of m + 1 ticks ago acts for the fraction f, that of m ticks ago for the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import floor

import numpy as np
from scipy.linalg import expm

from hil.config.design import Design, DesignAxis
from hil.linear_system import LinearSystem, static
from hil.signals import Array
from hil.synthesis.axis import body, drive
from hil.synthesis.weights import control_weight, disturbance_weight, error_weight, noise_weight


def sampled_axis(axis: DesignAxis, rate_Hz: float, inputs: Sequence[str]) -> LinearSystem:
    """Return the axis from [d, u] to [e, measured inputs], d held for a period like u."""
    h = 1.0 / rate_Hz
    late = 1e-3 * axis.transport_ms * rate_Hz
    whole = floor(late + 1e-9)
    f = max(late - whole, 0.0)
    loop, legs = drive(axis), body(inputs)
    # [drive, e, de]' = F x + G a, and d straight to the body
    F = np.block([[loop.A, np.zeros((loop.order, 2))], [axis.gain * legs.B @ loop.C, legs.A]])
    G = np.vstack([loop.B, axis.gain * legs.B @ loop.D])
    E = np.vstack([np.zeros((loop.order, 1)), legs.B])
    over, (new, of_d) = _held(F, h, G, E)
    _, (last,) = _held(F, f * h, G)
    rest, (now,) = _held(F, (1.0 - f) * h, G)
    del new
    n, kept = len(F), whole + 1
    A = np.zeros((n + kept, n + kept))  # the state, then u[k-1], u[k-2], ...
    A[:n, :n] = over
    A[n + 1 :, n:-1] = np.eye(kept - 1)
    B = np.zeros((n + kept, 2))
    B[:n, 0] = of_d[:, 0]
    B[n, 1] = 1.0
    A[:n, n + whole] = (rest @ last)[:, 0]
    if whole:
        A[:n, n + whole - 1] += now[:, 0]
    else:
        B[:n, 1] = now[:, 0]
    C = np.hstack([np.zeros((len(legs.C), loop.order)), legs.C, np.zeros((len(legs.C), kept))])
    return LinearSystem(A, B, C, np.zeros((len(C), 2)), h)


def _held(F: Array, time_s: float, *inputs: Array) -> tuple[Array, list[Array]]:
    """Return exp(F t) and, for each input, what holding it for t adds."""
    n, m = len(F), len(inputs)
    M = np.zeros((n + m, n + m))
    M[:n, :n], M[:n, n:] = F * time_s, np.hstack(inputs) * time_s
    whole = expm(M)
    return whole[:n, :n], [whole[:n, n + k : n + k + 1] for k in range(m)]


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
