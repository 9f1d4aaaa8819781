"""A controller without the states that do nothing.

D-K iteration makes controllers whose poles and zeros all but cancel. In balanced coordinates, where a state
is as easy to move by the inputs as to see in the outputs, its Hankel singular value says what it is worth.
"""

import numpy as np
from scipy.linalg import matrix_balance, solve_continuous_lyapunov

from drivers.arrays import Array
from hil.mathematics.linear_system import LinearSystem


def reduced(K: LinearSystem, inputs: Array, share: float) -> tuple[LinearSystem, float]:
    """Return a system without the states below `share` of the largest, and how far it is off at most.

    Balanced truncation (B. C. Moore 1981; K. Glover 1984): the response, from inputs of the sizes `inputs`
    (m,), is off at no frequency by more than twice the sum of the values left out: returned as a share of the
    largest. An unstable system has no Gramians and is returned as it is.
    """
    if not K.is_stable():
        return K, 0.0
    A, T = matrix_balance(K.A)
    B, C = np.linalg.solve(T, K.B) * inputs, K.C @ T
    L_c = _factor(solve_continuous_lyapunov(A, -B @ B.T))
    L_o = _factor(solve_continuous_lyapunov(A.T, -C.T @ C))
    U, s, Vt = np.linalg.svd(L_o.T @ L_c)
    n = int((s > share * s[0]).sum())
    right, left = L_c @ Vt[:n].T / np.sqrt(s[:n]), L_o @ U[:, :n] / np.sqrt(s[:n])
    kept = LinearSystem(left.T @ A @ right, left.T @ B / inputs, C @ right, K.D)
    return kept, 2.0 * float(s[n:].sum() / s[0])


def _factor(gramian: Array) -> Array:
    """Return L with L L' = gramian, also where rounding has made it a little indefinite."""
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
