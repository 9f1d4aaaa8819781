"""Metrics of a run: peaks, RMS, step response, bandwidth, and terms of the leg forces."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.mathematics.rotations import relative_rotation
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian, jacobian_rate
from hil.trajectory.path import PoseSample


def peak(x: Array) -> Array:
    """Largest absolute value of each column of x (n, m): (m,), in the unit of x; 0 without rows."""
    largest: Array = np.abs(x).max(axis=0, initial=0.0)
    return largest


def rms(x: Array) -> Array:
    """Root mean square of each column of x (n, m): (m,), unit of x; nan without rows."""
    if not len(x):
        return np.full(x.shape[1:], np.nan)
    root: Array = np.sqrt((x**2).mean(axis=0))
    return root


def rotation_errors(R_d: Array, R: Array) -> Array:
    """Rotation vectors of R_d R^T, row by row: the rotation from the pose to the reference.

    R_d, R : (n, 3, 3) or (n, 9), x_base = p + R x_platform. Result: (n, 3) rad, base frame.
    """
    demanded, measured = (np.ascontiguousarray(x, np.float64).reshape(-1, 3, 3) for x in (R_d, R))
    rows = [relative_rotation(m, d) for m, d in zip(measured, demanded, strict=True)]
    return np.array(rows).reshape(-1, 3)


class StepResponse(NamedTuple):
    """Rise time, overshoot and settling of a signal after a step of its set-point."""

    initial: float
    """Value before the step."""
    final: float
    """Mean of the last tenth of the record."""
    rise_s: float
    """Time from 10 to 90 % of the way from `initial` to `final`; nan if these are not reached."""
    overshoot: float
    """Largest excess beyond `final`, as a share of the way; 0 without overshoot."""
    settled: bool
    """True if the last tenth stays within 2 % of the way of `final`; else the figures are of a transient."""


def step_response(t: Array, y: Array, initial: float) -> StepResponse:
    """Rise time and overshoot of y (n,) at times t (n,) s after a step; y is `initial` before it.

    The way runs from the initial value to the final value, not to the set-point. A law with a steady-state
    error therefore has a rise time, too. Crossings are interpolated between samples.
    """
    tail = y[-max(1, len(y) // 10) :]
    final = float(tail.mean())
    way = final - initial
    if way == 0.0:
        return StepResponse(initial, final, np.nan, np.nan, False)
    share = (y - initial) / way
    rise = _first_above(t, share, 0.9) - _first_above(t, share, 0.1)
    settled = bool(np.abs((tail - final) / way).max() <= 0.02)
    return StepResponse(initial, final, rise, max(0.0, float(share.max()) - 1.0), settled)


def bandwidth_Hz(t: Array, y: Array, initial: float) -> float:
    """Closed-loop bandwidth, Hz: the gain falls to 1 / sqrt(2) of its low-frequency value.

    t (n,) s, equally spaced after a step of the set-point at t = 0; y (n,) response, `initial` before the
    step. The frequency response is the Fourier transform of the increments, G(f) = sum (y_k - y_{k-1}) exp(-2
    pi i f t_k). The bandwidth is the first frequency where |G(f)| < |G(0)| / sqrt(2).

    The result is the bandwidth of the *feedback* for a step of the set-point; for a nonlinear law, of a step
    of this size. nan without such a frequency below half the sampling rate. Inaccurate if the response has
    not settled within the record.
    """
    increments = np.diff(y, prepend=initial)
    gain = abs(float(increments.sum()))
    if len(t) < 3 or gain == 0.0:
        return float("nan")
    period = float(t[-1] - t[0]) / (len(t) - 1)

    def response(f: float) -> float:
        return float(abs((increments * np.exp(-2j * np.pi * f * t)).sum())) / gain

    lowest = 0.01 / (len(t) * period)
    grid = np.geomspace(lowest, 0.5 / period, 600)
    below = next((k for k, f in enumerate(grid) if response(f) < np.sqrt(0.5)), None)
    if not below:
        return float("nan")
    low, high = grid[below - 1], grid[below]
    for _ in range(40):
        middle_f = (low + high) / 2
        low, high = (low, middle_f) if response(middle_f) < np.sqrt(0.5) else (middle_f, high)
    return float(high)


def _first_above(t: Array, share: Array, level: float) -> float:
    above = share >= level
    if not above.any():
        return float("nan")
    k = int(np.argmax(above))
    if k == 0:
        return float(t[0])
    weight = (level - share[k - 1]) / (share[k] - share[k - 1])
    return float(t[k - 1] + weight * (t[k] - t[k - 1]))


class Share(NamedTuple):
    """How much one term of the equation of motion contributes to the leg forces along a path."""

    share: float
    """Largest leg force of the term over the largest leg force at the same instant; the worst instant."""
    force_N: float
    """Largest leg force of the term along the whole path, N."""


def force_shares(model: Model, samples: Iterable[PoseSample]) -> dict[str, Share]:
    """Shares of H, (dJ/dt) twist and G in the leg forces that a motion needs.

    With ddq = J dtwist + (dJ/dt) twist the forces are J^-T (M J^-1 (ddq - (dJ/dt) twist) + H + G). The terms:
    `H` J^-T H, `J_dot` J^-T M J^-1 (dJ/dt) twist, `G` J^-T G. Printed laws omit the first two; whether that
    is acceptable depends on robot and path. Samples without leg forces do not count.

    Raises KinematicsError where J is singular.
    """
    worst = dict.fromkeys(TERMS, Share(0.0, 0.0))
    for p, R, twist, dtwist in samples:
        whole = float(np.abs(model.inverse_dynamics(p, R, twist, dtwist)).max())
        J = jacobian(model.platform, p, R)
        J_dot = jacobian_rate(model.platform, p, R, twist)
        M = model.mass_matrix(p, R)
        loads = {
            "H": model.coriolis(p, R, twist),
            "J_dot": M @ np.linalg.solve(J, J_dot @ twist),
            "G": model.gravity(p, R),
        }
        for name, load in loads.items():
            force = float(np.abs(np.linalg.solve(J.T, load)).max())
            share = force / whole if whole > 0.0 else 0.0
            worst[name] = Share(max(worst[name].share, share), max(worst[name].force_N, force))
    return worst


TERMS = ("H", "J_dot", "G")
"""Keys of `force_shares`."""
