"""Exact axes with delay, lag and hold in closed form, many at once, independent of hil.design.synthesis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

PAST = 3
"""Number of periods in the longest delay."""


class Axes(NamedTuple):
    """x[k+1] = A x + B [u, d], position and rate in rows 2 and 1 of x = [drive, rate, position, u[k-1] ..]."""

    A: np.ndarray
    B: np.ndarray


def true_axes(gain, transport_s, lag_s, h):
    """N axes: drive' = (u(t - T) - drive) / lag, rate' = gain (drive + d), u and d held for a period h."""
    g, T, tau = (np.asarray(x, float) for x in np.broadcast_arrays(gain, transport_s, lag_s))
    N = len(g)

    def free(t):
        E, F = np.exp(-t / tau), np.zeros((N, 3, 3))
        F[:, 0, 0], F[:, 1, 0], F[:, 2, 0] = E, g * tau * (1 - E), g * tau * (t - tau * (1 - E))
        F[:, 1, 1] = F[:, 2, 2] = 1.0
        F[:, 2, 1] = t
        return F

    def step(t):
        E = np.exp(-t / tau)
        return np.stack(
            [1 - E, g * (t - tau * (1 - E)), g * (t * t / 2 - tau * t + tau**2 * (1 - E))], axis=1
        )

    m = np.floor(T / h + 1e-9).astype(int)
    f = np.maximum(T - m * h, 0.0)
    A, B = np.zeros((N, 3 + PAST, 3 + PAST)), np.zeros((N, 3 + PAST, 2))
    A[:, :3, :3] = free(np.full(N, h))
    whole = np.zeros((N, 3, PAST + 1))  # what u[k], u[k-1] .. add
    whole[np.arange(N), :, m] = step(h - f)
    late = np.einsum("nij,nj->ni", free(h - f), step(f))
    whole[np.arange(N), :, np.minimum(m + 1, PAST)] += np.where((f > 0.0)[:, None], late, 0.0)
    B[:, :3, 0], A[:, :3, 3:] = whole[:, :, 0], whole[:, :, 1:]
    B[:, 3, 0] = 1.0
    A[:, range(4, 3 + PAST), range(3, 2 + PAST)] = 1.0
    B[:, 1, 1], B[:, 2, 1] = g * h, g * h**2 / 2
    return Axes(A, B)


def response(axes, omega, h):
    """(N, len(omega), 2, 2) from [u, d] to [position, rate]."""
    resolvent = np.exp(1j * omega * h)[:, None, None] * np.eye(3 + PAST) - axes.A[:, None]
    return np.linalg.solve(resolvent, axes.B[:, None].astype(complex))[:, :, [2, 1], :]


def closed(axes, K):
    """Loop matrix (N, n, n) with a sampled controller u = K [e; de]."""
    N, n, _ = axes.A.shape
    C = np.zeros((2, n))
    C[0, 2] = C[1, 1] = -1.0
    loop = np.zeros((N, n + len(K.A), n + len(K.A)))
    loop[:, :n, :n] = axes.A + axes.B[:, :, :1] @ (K.D @ C)
    loop[:, :n, n:] = axes.B[:, :, :1] @ K.C
    loop[:, n:, :n], loop[:, n:, n:] = K.B @ C, K.A
    return loop
