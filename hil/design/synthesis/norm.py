"""H-infinity norm of a linear system, computed independently of the synthesis."""

import numpy as np

from drivers.arrays import Array
from drivers.errors import SynthesisError
from hil.mathematics.linear_system import LinearSystem

TOLERANCE = 1e-6
"""Relative accuracy: the norm lies between the returned value and this value times 1 + 2e-6."""
AXIS = 1e-8
"""Real part, relative to the modulus, below which an eigenvalue counts as on the imaginary axis."""


def norm(system: LinearSystem) -> float:
    """Supremum over frequency of the largest singular value of the response.

    N. A. Bruinsma and M. Steinbuch (1990): for gamma below the norm, the Hamiltonian of gamma has
    eigenvalues j w at the frequencies at which a singular value equals gamma. Between these frequencies the
    gain is larger, and the largest gain at their middles is the next gamma. A sampled system is mapped to a
    continuous one of the same norm, z = (1 + s) / (1 - s).

    Raises SynthesisError for an unstable system, which has no norm.
    """
    if not system.is_stable():
        raise SynthesisError("the system is not stable, so it has no H-infinity norm")
    if system.period_s is not None:
        inverse = np.linalg.inv(system.A + np.eye(system.order))
        A, C = inverse @ (system.A - np.eye(system.order)), system.C @ inverse
        B = np.sqrt(2.0) * inverse @ system.B
        system = LinearSystem(A, B, np.sqrt(2.0) * C, system.D - C @ system.B)
    best = float(np.linalg.norm(system.D, 2))  # at infinity
    if not system.order:
        return best
    best = max(best, float(gains(system, np.concatenate([[0.0], np.abs(system.poles())])).max()))
    for _ in range(60 if best > 0.0 else 0):
        gamma = (1.0 + TOLERANCE) * best
        eigenvalues = np.linalg.eigvals(_hamiltonian(system, gamma))
        near = np.abs(eigenvalues.real) <= AXIS * np.abs(eigenvalues).max() + 1e-6 * np.abs(eigenvalues)
        crossings = np.unique(np.abs(eigenvalues[near].imag))
        middles = np.concatenate([crossings, 0.5 * (crossings[1:] + crossings[:-1])])
        largest = float(gains(system, middles).max(initial=0.0))
        if largest <= gamma:
            break
        best = largest
    return best


def gains(system: LinearSystem, omega: Array) -> Array:
    """Largest singular value (n,) of the response at each frequency of omega (n,), rad/s."""
    return np.asarray(np.linalg.svd(system.response(omega), compute_uv=False)[:, 0])


def _hamiltonian(system: LinearSystem, gamma: float) -> Array:
    A, B, C, D = system[:4]
    R = D.T @ D - gamma**2 * np.eye(D.shape[1])
    S = D @ D.T - gamma**2 * np.eye(D.shape[0])
    RD, RB = np.linalg.solve(R, D.T @ C), np.linalg.solve(R, B.T)
    SC = np.linalg.solve(S, C)
    return np.block([[A - B @ RD, -gamma * B @ RB], [gamma * C.T @ SC, -A.T + C.T @ D @ RB]])
