"""A law that looks ahead, as a controller of the sampled loop: it answers where the axis will be.

What `hil.estimation.predictor.Predictor` does to the whole state, here of one linearised axis.
"""

from math import floor

import numpy as np

from hil.mathematics.linear_system import LinearSystem, held


def predicting(
    K_P: float, K_D: float, period_s: float, *, bus_s: float, lag_s: float, hold_s: float
) -> LinearSystem:
    """Return u[k] = K_P e + K_D de of the instant bus + lag + hold after the measurement, from [e, de].

    What happens until then follows from the commands under way, the last of which is taken to go on:
    e'' = -a, a the acceleration of the force, which follows the commands by its lag. States: a where there
    is a lag, and the last commands u[k-1], u[k-2], ...
    """
    T, horizon = period_s, bus_s + lag_s + hold_s
    m = floor(bus_s / T + 1e-9)
    r = max(bus_s - m * T, 0.0)
    n = 3 if lag_s > 0.0 else 2
    F, g = np.zeros((n, n)), np.zeros((n, 1))
    F[0, 1] = 1.0
    if lag_s > 0.0:
        F[1, 2], F[2, 2], g[2, 0] = -1.0, -1.0 / lag_s, 1.0 / lag_s
    else:
        g[1, 0] = -1.0
    count = m + 1
    first = n - 2  # of the commands among the states
    # x ahead = ahead [e, de, a] + by_command [u[k-1], ..., u[k-m-1]]
    ahead, by_command, t = np.eye(n), np.zeros((n, count)), 0.0
    ends = [r + j * T for j in range(m)] + [horizon]
    for j, end in enumerate(ends):
        Phi, push = held(F, g, max(min(end, horizon) - t, 0.0))
        ahead, by_command = Phi @ ahead, Phi @ by_command
        by_command[:, m - j] += push[:, 0]
        t = min(end, horizon)
    K = np.array([[K_P, K_D]])
    C = np.hstack([K @ ahead[:2, 2:], K @ by_command[:2]])
    D = K @ ahead[:2, :2]
    size = first + count
    A, B = np.zeros((size, size)), np.zeros((size, 2))
    if lag_s > 0.0:
        late, rest = np.exp(-r / lag_s), np.exp(-(T - r) / lag_s)
        A[0, 0] = late * rest
        A[0, first + m] += rest * (1.0 - late)
        if m > 0:
            A[0, first + m - 1] += 1.0 - rest
        else:
            A[0] += (1.0 - rest) * C[0]
            B[0] += (1.0 - rest) * D[0]
    A[first] += C[0]
    B[first] += D[0]
    for j in range(1, count):
        A[first + j, first + j - 1] = 1.0
    return LinearSystem(A, B, C, D, T)
