"""H-infinity synthesis: the controller that keeps the norm from w to z below gamma, by two Riccati equations.

State-space solution of Doyle, Glover, Khargonekar and Francis (1989), in the general form of Glover and
Doyle (1988), here in the notation of Zhou, Doyle and Glover, *Robust and Optimal Control* (1996), section
17.1: D12 and D21 are brought to [0; I] and [0 I] by scaling; D22 is 0.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance, solve_continuous_are

from drivers.arrays import Array
from drivers.errors import SynthesisError
from hil.mathematics.linear_system import LinearSystem

RANK = 1e-9
"""Smallest singular value, relative to the largest, that counts as nonzero."""
REACH = 1e-14
"""Singular value, relative to A, below which a mode counts as uncontrollable: rounding of 0."""
AXIS = 1e-9
"""Real part of an eigenvalue, relative to the matrix, below which it counts as on the imaginary axis."""
TOLERANCE = 1e-6
"""Relative accuracy of gamma_opt."""


class Synthesis(NamedTuple):
    """H-infinity controller u = K y, and the norm from w to z that it keeps."""

    K: LinearSystem
    gamma: float
    """Upper bound on the norm from w to z."""
    gamma_opt: float
    """Infimum of the norm over all controllers."""


class _Normal(NamedTuple):
    """A plant with D12 = [0; I], D21 = [0 I], D22 = 0, and the maps back to the original u and y."""

    A: Array
    B1: Array
    B2: Array
    C1: Array
    C2: Array
    D11: Array
    of_u: Array
    """u = of_u u'."""
    to_y: Array
    """y' = to_y y."""


def hinf(P: LinearSystem, n_y: int, n_u: int, ratio: float = 1.1) -> Synthesis:
    """Central H-infinity controller at gamma = `ratio` times the smallest possible gamma.

    `P` is continuous, from [w; u] to [z; y]; the last `n_u` inputs are u, the last `n_y` outputs y. At the
    optimum itself poles of the controller go to infinity; a `ratio` above 1 avoids this.

    Raises SynthesisError if P is sampled or cannot be stabilised, or if the problem is ill posed; the message
    states the assumption that fails.
    """
    plant = _normal(P, n_y, n_u)
    gamma_opt = _optimum(plant)
    gamma = ratio * gamma_opt
    found = _central(plant, gamma)
    if found is None:
        raise SynthesisError(
            f"no controller found at gamma {gamma:g}, {ratio:g} times the optimum: the plant is badly scaled"
        )
    return Synthesis(found, gamma, gamma_opt)


def _normal(P: LinearSystem, n_y: int, n_u: int) -> _Normal:
    """Plant, balanced and normalised. Raises SynthesisError for a plant that violates the assumptions."""
    if P.period_s is not None:
        raise SynthesisError("the plant is sampled, allowed: a continuous one")
    if not all(np.isfinite(matrix).all() for matrix in P[:4]):
        raise SynthesisError("the plant contains numbers that are not finite")
    n_z, n_w = P.C.shape[0] - n_y, P.B.shape[1] - n_u
    A, T = matrix_balance(P.A)
    B, C = np.linalg.solve(T, P.B), P.C @ T
    B1, B2, C1, C2 = B[:, :n_w], B[:, n_w:], C[:n_z], C[n_z:]
    D11, D12, D21 = P.D[:n_z, :n_w], P.D[:n_z, n_w:], P.D[n_z:, :n_w]
    if P.D[n_z:, n_w:].any():
        raise SynthesisError("u acts on y directly (D22 is not zero), allowed: only through the axis")
    _require(A, B2, lambda real: real > -AXIS, "does not decay and is not controllable by u")
    unseen = "does not decay and is not observable in y; check for a weight that integrates"
    _require(A.T, C2.T, lambda real: real > -AXIS, unseen)
    U, s, Vt = np.linalg.svd(D12)
    if n_z < n_u or s[-1] <= RANK * s[0]:
        raise SynthesisError(
            "D12 has no full column rank: some u has no weight at high frequency and could become unbounded; "
            "weight every u, with a weight that does not roll off"
        )
    U = np.hstack([U[:, n_u:], U[:, :n_u]])  # z = U z', D12 = U [0; I] diag(s) Vt
    of_u = Vt.T / s
    V, t, Wt = np.linalg.svd(D21)
    if n_w < n_y or t[-1] <= RANK * t[0]:
        raise SynthesisError(
            "D21 has no full row rank: some y has no noise at high frequency, so its gain could become "
            "unbounded; add noise to every y, with a weight that does not roll off"
        )
    Wt = np.vstack([Wt[n_y:], Wt[:n_y]])  # w' = Wt w, D21 = V diag(t) [0 I] Wt
    to_y = (V / t).T
    plant = _Normal(A, B1 @ Wt.T, B2 @ of_u, U.T @ C1, to_y @ C2, U.T @ D11 @ Wt.T, of_u, to_y)
    _well_posed(plant, n_z - n_u, n_w - n_y)
    return plant


def _well_posed(plant: _Normal, p: int, m: int) -> None:
    """Raise SynthesisError for a zero on the imaginary axis from u to z or w to y, which voids gamma."""
    A, B1, B2, C1, C2, *_ = plant

    def axis(real: float) -> bool:
        return abs(real) < AXIS

    remedy = (
        "An axis 1/s^2 needs a disturbance at its input and noise in its measurement; "
        "a plain mixed sensitivity has no such disturbance"
    )
    _require((A - B2 @ C1[p:]).T, C1[:p].T, axis, f"ill posed: not observable in z without u. {remedy}")
    _require(A - B1[:, m:] @ C2, B1[:, :m], axis, f"ill posed: not excited by w without noise in y. {remedy}")


def _require(A: Array, B: Array, poles: Callable[[float], bool], what: str) -> None:
    """Raise SynthesisError for a mode of A that B does not control (Hautus test), if `poles` selects it."""
    scale = max(float(np.linalg.norm(A)), 1e-300)
    size = np.linalg.norm(B, axis=0)
    B = scale * B / np.where(size > 0.0, size, 1.0)
    found = np.linalg.eigvals(A)
    fastest = np.abs(found).max(initial=1e-300)
    for pole in found:
        if poles(pole.real / fastest):
            reach = np.linalg.svd(np.hstack([A - pole * np.eye(len(A)), B]), compute_uv=False)
            if reach[-1] <= REACH * scale:
                raise SynthesisError(
                    f"the mode of the weighted plant at {abs(pole):.3g} rad/s makes the synthesis {what}"
                )


def _optimum(plant: _Normal) -> float:
    """Smallest gamma for which `_riccati` has a solution, by bisection; every larger gamma has one, too."""
    m2, p2 = len(plant.of_u), len(plant.to_y)
    top, left = plant.D11[: len(plant.D11) - m2], plant.D11[:, : plant.D11.shape[1] - p2]
    low = max([0.0, *(float(np.linalg.norm(M, 2)) for M in (top, left) if M.size)])
    high = max(2.0 * low, 1.0)
    while _riccati(plant, high) is None:
        low, high = high, 4.0 * high
        if high > 1e15:
            raise SynthesisError("no gamma below 1e15 is feasible: the plant is badly scaled")
    while low == 0.0 and _riccati(plant, high / 4.0) and high > 1e-15:
        high /= 4.0
    while high - low > TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _riccati(plant, middle) else (middle, high)
    return high


def _riccati(plant: _Normal, gamma: float) -> tuple[Array, Array, Array, Array] | None:
    """Solutions X, Y, F, L of both Riccati equations; None if X or Y is not >= 0, or rho(X Y) >= gamma^2."""
    A, B1, B2, C1, C2, D11, of_u, to_y = plant
    m2, p2 = len(of_u), len(to_y)
    p1, m1 = D11.shape
    top, left = D11[: p1 - m2], D11[:, : m1 - p2]
    if any(M.size and np.linalg.norm(M, 2) >= gamma for M in (top, left)):
        return None
    D12 = np.vstack([np.zeros((p1 - m2, m2)), np.eye(m2)])
    D21 = np.hstack([np.zeros((p2, m1 - p2)), np.eye(p2)])
    B, C = np.hstack([B1, B2]), np.vstack([C1, C2])
    D1, D_1 = np.hstack([D11, D12]), np.vstack([D11, D21])
    X_F = _stabilising(A, B, C1, D1, m1, gamma)
    Y_L = _stabilising(A.T, C.T, B1.T, D_1.T, p1, gamma)
    if X_F is None or Y_L is None:
        return None
    (X, F), (Y, Lt) = X_F, Y_L
    if np.abs(np.linalg.eigvals(X @ Y)).max() >= gamma**2:
        return None
    return X, Y, F, Lt.T


def _stabilising(A: Array, B: Array, C: Array, D: Array, m: int, gamma: float) -> tuple[Array, Array] | None:
    """X >= 0 of A'X + XA + C'C - (XB + C'D) R^-1 (B'X + D'C) = 0 and F = -R^-1 (D'C + B'X).

    R = D'D minus gamma^2 on its first `m` diagonal entries.
    """
    R = D.T @ D
    R[:m, :m] -= gamma**2 * np.eye(m)
    try:
        X = solve_continuous_are(A, B, C.T @ C, R, s=C.T @ D)
    except np.linalg.LinAlgError:  # eigenvalues on the imaginary axis leave none
        return None
    a, b, c = (float(np.linalg.norm(M)) for M in (A, B, C))
    size = float(np.linalg.norm(X)) + c**2 / max(a, b * c, 1e-300)  # X may be 0 but for rounding
    if np.linalg.eigvalsh(X).min() < -1e-9 * size:
        return None
    return X, -np.linalg.solve(R, D.T @ C + B.T @ X)


def _central(plant: _Normal, gamma: float) -> LinearSystem | None:
    found = _riccati(plant, gamma)
    if found is None:
        return None
    A, B1, B2, _, C2, D11, of_u, to_y = plant
    X, Y, F, L = found
    m2, p2 = len(of_u), len(to_y)
    p1, m1 = D11.shape
    D1111, D1112 = D11[: p1 - m2, : m1 - p2], D11[: p1 - m2, m1 - p2 :]
    D1121, D1122 = D11[p1 - m2 :, : m1 - p2], D11[p1 - m2 :, m1 - p2 :]
    inner = gamma**2 * np.eye(p1 - m2) - D1111 @ D1111.T
    D_11 = -D1121 @ D1111.T @ np.linalg.solve(inner, D1112) - D1122
    F12, F2 = F[m1 - p2 : m1], F[m1:]
    L12, L2 = L[:, p1 - m2 : p1], L[:, p1:]
    Z = np.linalg.inv(np.eye(len(A)) - Y @ X / gamma**2)
    through = -(C2 + F12)
    B_1 = -Z @ L2 + Z @ (B2 + L12) @ D_11
    C_1 = F2 + D_11 @ through
    A_ = A + np.hstack([B1, B2]) @ F + B_1 @ through
    A_, T = matrix_balance(A_)
    return LinearSystem(A_, np.linalg.solve(T, B_1 @ to_y), of_u @ C_1 @ T, of_u @ D_11 @ to_y)
