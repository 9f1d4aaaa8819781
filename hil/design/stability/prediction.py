"""A law that looks ahead, as a controller of the sampled loop: it answers where the axis will be.

What `hil.estimation.predictor.Predictor` does to the whole state, here of one linearised axis.
"""

from math import floor

import numpy as np

from drivers.arrays import Array
from hil.mathematics.linear_system import LinearSystem, exponential


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
    size = n + m + 2  # e, de, a, u[k], u[k-1], ..., u[k-m-1]

    def moved(acting: list[tuple[int, float]]) -> Array:
        """Return what time makes of these, while u[k-j] acts for so long, one after the other."""
        Phi = np.eye(size)
        for j, time_s in acting:
            F = np.zeros((size, size))
            F[0, 1] = 1.0
            if lag_s > 0.0:
                F[1, 2], F[2, 2], F[2, n + j] = -1.0, -1.0 / lag_s, 1.0 / lag_s
            else:
                F[1, n + j] = -1.0
            Phi = exponential(F * time_s) @ Phi
        return Phi

    ends = np.minimum([0.0, *(r + j * T for j in range(m)), horizon], horizon)
    ahead = moved([(m + 1 - j, float(time_s)) for j, time_s in enumerate(np.diff(ends))])
    K = np.array([K_P, K_D]) @ ahead[:2]
    C, D = np.delete(K, n)[None, 2:], K[None, :2]
    count = C.shape[1]
    A, B = np.eye(count, k=-1), np.zeros((count, 2))
    A[n - 2], B[n - 2] = C[0], D[0]
    if lag_s > 0.0:
        late = moved([(m + 1, r), (m, T - r)])[2]
        A[0] = np.delete(late, n)[2:] + late[n] * C[0]
        B[0] = late[n] * D[0]
    return LinearSystem(A, B, C, D, T)
