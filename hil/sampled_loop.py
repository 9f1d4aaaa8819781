"""The loop of a sampled controller and the delayed axis that inverse dynamics leaves: poles and margins.

Rule of the room: values and pure functions, offline (LAPACK is used); nothing of it runs inside the cycle.

The axis is gain exp(-transport s) / (lag s + 1) / s^2 behind a hold of one period, from demanded acceleration
to measured position and rate; it is sampled exactly, also where the transport is no whole number of periods.
"""

from __future__ import annotations

from math import ceil, inf
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from hil.config.linear_controller import LinearController
from hil.linear_system import LinearSystem
from hil.signals import Array

GRID = 4000
"""Frequencies looked at, evenly in their logarithm, over five decades below half the rate."""


class Margins(NamedTuple):
    """What is left of a loop."""

    pole_radius: float
    """Largest magnitude of the closed loop's poles; below 1 it is stable."""
    cross_over_rad_s: float
    """The highest frequency at which the loop has gain 1."""
    phase_deg: float
    """The least distance of the loop's phase from half a turn, over all frequencies of gain 1."""
    sensitivity: float
    """The peak of 1 / |1 + L|: the loop stays 1 over it away from -1. inf where it is unstable."""


def sampled_axis(transport_s: float, lag_s: float, period_s: float, gain: float = 1.0) -> LinearSystem:
    """Return the axis at the samples: from held acceleration to [position, rate] (2,)."""
    whole = ceil(transport_s / period_s - 1e-9)
    late = max(whole * period_s - transport_s, 0.0)  # so long before the sample the newer input already acts
    # position, rate, and the drives' acceleration where they lag
    if lag_s > 0.0:
        A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / lag_s]])
        B = np.array([[0.0], [0.0], [gain / lag_s]])
    else:
        A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [gain]])
    n = len(A)
    _, newer = _held(A, B, late)
    Phi, both = _held(A, B, period_s)
    older = both - newer
    # the last inputs, the newest first
    F, G = np.zeros((n + whole, n + whole)), np.zeros((n + whole, 1))
    F[:n, :n] = Phi
    if whole == 0:
        G[:n] = both
    else:
        F[:n, n + whole - 1 :] += older
        if whole == 1:
            G[:n] += newer
        else:
            F[:n, n + whole - 2 : n + whole - 1] += newer
        F[n + 1 :, n:-1] = np.eye(whole - 1)
        G[n] = 1.0
    return LinearSystem(F, G, np.eye(2, n + whole), np.zeros((2, 1)), period_s)


def _held(A: Array, B: Array, time_s: float) -> tuple[Array, Array]:
    """Return exp(A t) and the integral of exp(A s) B over it."""
    n = len(A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n:] = A, B
    e = expm(block * time_s)
    return e[:n, :n], e[:n, n:]


def sampled_controller(controller: LinearController) -> LinearSystem:
    """Return a file's controller as a system from [e, de] to u."""
    columns = {"error": 0, "rate_error": 1}
    chosen = np.zeros((len(controller.inputs), 2))
    for row, name in enumerate(controller.inputs):
        chosen[row, columns[name]] = 1.0
    n, m = len(controller.A), len(controller.inputs)
    B = np.array(controller.B, float).reshape(n, m) @ chosen
    A, C = np.array(controller.A, float).reshape(n, n), np.array(controller.C, float)
    return LinearSystem(A, B, C, np.array(controller.D, float) @ chosen, 1.0 / controller.rate_Hz)


def margins(controller: LinearSystem, axis: LinearSystem) -> Margins:
    """Return what the loop of u = controller [e, de] around an axis leaves, [e, de] = -axis u."""
    assert axis.period_s is not None
    loop = controller.after(axis)
    radius = float(np.abs(np.linalg.eigvals(loop.A - loop.B @ loop.C / (1.0 + loop.D[0, 0]))).max())
    nyquist = np.pi / axis.period_s
    omega = np.geomspace(1e-5 * nyquist, nyquist, GRID)
    L = loop.response(omega)[:, 0, 0]
    size = np.log(np.abs(L))
    crossed = np.flatnonzero(np.sign(size[:-1]) != np.sign(size[1:]))
    share = size[crossed] / (size[crossed] - size[crossed + 1])
    at = omega[crossed] * (omega[crossed + 1] / omega[crossed]) ** share
    phase = np.angle(-loop.response(at)[:, 0, 0], deg=True)  # from half a turn
    return Margins(
        radius,
        float(at.max()) if at.size else 0.0,
        float(np.abs(phase).min()) if at.size else inf,
        float((1.0 / np.abs(1.0 + L)).max()) if radius < 1.0 else inf,
    )
