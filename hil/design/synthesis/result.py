"""Result of a synthesis: the controller in sampled form, analysed in the exact sampled loop."""

from math import pi
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import (
    matrix_balance,
    solve_continuous_lyapunov,
    solve_discrete_are,
    solve_discrete_lyapunov,
)

from drivers.arrays import Array, ComplexArray
from drivers.errors import SynthesisError
from hil.config.design import Design, DesignAxis
from hil.config.linear_controller import LinearController
from hil.design.stability.sampled_loop import Margins, margins
from hil.design.synthesis.axis import actuator, four_block, loop_axis, loop_gain, sampled_axis
from hil.mathematics.linear_system import LinearSystem

SLOW = 0.1
"""Slowest allowed pole of the closed loop, as a share of the crossover."""


class Judgement(NamedTuple):
    """Analysis of a controller on its axis, and the reasons against its use."""

    sampled: LinearSystem
    """Controller, sampled at the rate of the loop."""
    margins: Margins
    loop_poles: ComplexArray
    """Poles, rad/s, of the closed loop of rational axis and continuous controller."""
    reasons: tuple[str, ...]
    """Reasons why a loop cannot run the controller; empty for a usable controller."""


def judge(design: Design, axis: DesignAxis, K: LinearSystem) -> Judgement:
    """Sample a continuous controller, and analyse its loop with the axis.

    The map is Tustin's, without prewarping: it distorts above half Nyquist, where no pole may be.
    """
    h = 1.0 / design.rate_Hz
    path = actuator(loop_axis(design, axis), design.rate_Hz, design.delay_order)
    poles = four_block(path, design.inputs).closed_with(K).poles()
    sampled = K.sampled(h, "bilinear")
    legs = sampled_axis(axis, design.rate_Hz, design.inputs)
    found = margins(loop_gain(sampled, legs))
    reasons = []
    fastest, end = float(np.abs(K.poles()).max(initial=0.0)), pi * design.rate_Hz / 2.0
    if fastest > end:
        reasons.append(
            f"a pole of the controller at {fastest:.0f} rad/s, allowed: up to half the Nyquist frequency, "
            f"{end:.0f}; reduce the bandwidth, state more noise, or use a higher rate"
        )
    slowest = float(-poles.real.max())
    if slowest < SLOW * found.crossover_rad_s:
        reasons.append(
            f"a pole of the closed loop at {slowest:.3g} rad/s, allowed: at least {SLOW:g} of the crossover, "
            f"{SLOW * found.crossover_rad_s:.3g}; raise the error weight at low frequency"
        )
    if not K.is_stable():
        reasons.append(
            f"the controller itself is unstable, a pole at {K.poles().real.max():.3g} rad/s, and would "
            "diverge while a limit opens the loop; reduce the bandwidth"
        )
    if not legs.closed_with(sampled).is_stable():
        reasons.append(
            "the sampled loop is unstable: the rational model of delay and hold is too rough at this "
            "bandwidth; raise delay_order, or relax the weights"
        )
    return Judgement(sampled, found, poles, tuple(reasons))


def anti_windup(K: LinearSystem, bandwidth: float) -> Array:
    """Anti-windup gain L (n,) that makes A - L C as fast as `bandwidth`, rad/s, and not faster than needed.

    While a limit reduces u, the state changes by L times the reduction: an observer of the controller's own
    state from the applied u (Astrom and Rundqwist 1989). Poles slower than `bandwidth` are mirrored at it,
    the others stay: least energy with a prescribed degree of stability (B. D. O. Anderson and J. B. Moore,
    *Optimal Control*, 1990, section 3.5), by a Riccati equation without weight on the state.

    Raises SynthesisError if the equation has no solution.
    """
    assert K.period_s is not None
    n = K.order
    if not n:
        return np.zeros(0)
    faster = np.exp(bandwidth * K.period_s)
    A, C = faster * K.A, K.C
    try:
        X = solve_discrete_are(A.T, C.T, np.zeros((n, n)), np.eye(1))
    except np.linalg.LinAlgError:
        raise SynthesisError(
            "no anti-windup: a pole of the controller is exactly at the crossover, or a slow one is not "
            "observable in u; change a weight slightly"
        ) from None
    gain = A @ X @ C.T @ np.linalg.inv(C @ X @ C.T + np.eye(1))
    return np.asarray(gain[:, 0] / faster)


def balanced(K: LinearSystem) -> LinearSystem:
    """Stable sampled system in balanced coordinates: both Gramians equal and diagonal.

    B. C. Moore (1981). All states have a similar size, and the realisation is unique up to signs. The signs
    make the first column of B positive. A system with a nearly uncontrollable or unobservable state has no
    such coordinates and is returned unchanged.
    """
    right, left, s = _balancing(K)
    if not K.order or s[-1] <= 1e-14 * s[0]:
        return K
    sign = np.where((left.T @ K.B)[:, 0] < 0.0, -1.0, 1.0)
    right, left = right * sign, left * sign
    return LinearSystem(left.T @ K.A @ right, left.T @ K.B, K.C @ right, K.D, K.period_s)


def reduced(K: LinearSystem, inputs: Array, share: float) -> LinearSystem:
    """System without the states whose Hankel singular value is below `share` of the largest.

    D-K iteration gives controllers with nearly cancelling poles and zeros. In balanced coordinates a state is
    as controllable as observable, and its Hankel singular value measures its effect. Balanced truncation (B.
    C. Moore 1981; K. Glover 1984): the error of the response, from inputs of the sizes `inputs` (m,), is at
    no frequency larger than twice the sum of the omitted values. An unstable system has no Gramians and is
    returned unchanged.
    """
    if not K.is_stable():
        return K
    A, T = matrix_balance(K.A)
    B, C = np.linalg.solve(T, K.B) * inputs, K.C @ T
    right, left, s = _balancing(LinearSystem(A, B, C, K.D))
    n = int((s > share * s[0]).sum())
    right, left = right[:, :n], left[:, :n]
    return LinearSystem(left.T @ A @ right, left.T @ B / inputs, C @ right, K.D)


def _balancing(K: LinearSystem) -> tuple[Array, Array, Array]:
    """Coordinate maps x = right z, z = left^T x to balanced coordinates, and the Hankel singular values."""
    A, B, C, _, sampled = K
    solve = solve_discrete_lyapunov if sampled else lambda A, Q: solve_continuous_lyapunov(A, -Q)
    L_c, L_o = (_factor(solve(F, G @ G.T)) for F, G in ((A, B), (A.T, C.T)))
    U, s, Vt = np.linalg.svd(L_o.T @ L_c)
    root = np.sqrt(np.maximum(s, 1e-300))
    return L_c @ Vt.T / root, L_o @ U / root, s


def _factor(gramian: Array) -> Array:
    """L with L L' = gramian; small negative eigenvalues from rounding count as 0."""
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def linear_controller(
    design: Design, method: str, judged: Judgement, figures: dict[str, Any]
) -> LinearController:
    """Content of a controller file: the sampled controller in balanced coordinates, and the figures."""
    K = balanced(judged.sampled)
    return LinearController.model_validate(
        {
            "kind": "linear-controller",
            "method": method,
            "axes": design.axes,
            "rate_Hz": design.rate_Hz,
            "inputs": list(design.inputs),
            "A": K.A.tolist(),
            "B": K.B.tolist(),
            "C": K.C.tolist(),
            "D": K.D.tolist(),
            "anti_windup": anti_windup(K, judged.margins.crossover_rad_s).tolist(),
            "design": figures,
        }
    )


def described(design: Design, axis: DesignAxis, judged: Judgement, K: LinearSystem) -> dict[str, Any]:
    """Axis, weights, margins and poles of a design, by names with units, for the controller file."""
    m = judged.margins
    return {
        "crossover_rad_s": m.crossover_rad_s,
        "phase_margin_deg": m.phase_deg,
        "delay_margin_ms": 1e3 * m.delay_s,
        "gain_margin": [m.gain_down, m.gain_up],
        "peak_S": m.peak_S,
        "peak_T": m.peak_T,
        "controller_poles_rad_s": _pairs(K.poles()),
        "closed_loop_poles_rad_s": _pairs(judged.loop_poles),
        "axis": axis.model_dump(mode="json", exclude_none=True),
        "delay_order": design.delay_order,
        "weights": design.weights.model_dump(mode="json", exclude_none=True),
    }


def _pairs(poles: ComplexArray) -> list[list[float]]:
    """[real, imaginary] of the poles with imaginary part >= 0, the slowest first, for a file."""
    return [[float(p.real), abs(float(p.imag))] for p in sorted(poles, key=abs) if p.imag >= 0.0]
