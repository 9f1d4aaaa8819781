"""Upper bound on the structured singular value of a complex matrix, frequency by frequency.

    mu(M) = 1 / min { largest singular value of Delta : det(I - M Delta) = 0 },  Delta = diag(Delta_1 ...)

The smallest structured perturbation that makes the loop around M singular has the size 1 / mu. A. Packard and
J. Doyle, The complex structured singular value, Automatica 29 (1993).
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray, Ints
from drivers.errors import ModelError

ZERO = 1e-6
"""Share of the first bound below which mu counts as 0."""
PATIENCE = 5
"""Rounds of centring without a lower bound after which the iteration ends."""


class Block(NamedTuple):
    """One block of Delta: a full complex matrix (rows, columns).

    The block maps `columns` outputs of M to `rows` inputs of M.
    """

    rows: int = 1
    columns: int = 1


class UpperBound(NamedTuple):
    """Upper bound on mu at N frequencies, and the scales that prove it."""

    bound: Array
    """(N,) upper bound on mu at each frequency."""
    D: Array
    """(N, blocks) scales > 0, 1 in the last: bound = largest singular value of D M D^-1."""


def upper_bound(M: ComplexArray, blocks: list[Block], *, accuracy: float = 1e-4) -> UpperBound:
    """Smallest upper bound on mu of M that scales of the blocks can prove: a convex problem.

    beta >= mu if there are D > 0 that commute with Delta with M^H D^2 M <= beta^2 D^2. The least beta is the
    largest singular value of D M D^-1, and equals mu for up to three blocks. The bound is found by the method
    of centres: Newton's method on the barrier -log det(beta^2 D^2 - M^H D^2 M), beta lowered to the proven
    bound after each centring. The result is a bound after any number of iterations.

    Parameters
    ----------
    M : (N, outputs, inputs)
    blocks : in the order of the rows and columns of M
    accuracy : relative step of the bound that ends the iteration
    """
    outputs, inputs = block_of_each(blocks)
    if M.shape[1:] != (len(outputs), len(inputs)):
        raise ModelError(f"blocks for a matrix of {len(outputs)} x {len(inputs)}, given {M.shape[1:]}")
    balance = _balanced(M, outputs, inputs)
    A = scaled(M, balance, blocks)
    n, N = len(blocks), len(A)
    parts = [A[:, outputs == k] for k in range(n)]
    gains = np.stack([_dagger(part) @ part for part in parts], 1)  # (N, n, inputs, inputs)
    units = np.array([np.diag(inputs == k) for k in range(n)], float)
    x = np.ones((N, n - 1))  # d_1^2 .. d_(n-1)^2; d_n = 1
    best, best_x = _proven(x, gains, inputs), x.copy()
    beta = highest = 1.05 * best + 1e-300
    idle = 0
    for _ in range(100):
        basis = beta[:, None, None, None] ** 2 * units - gains
        fixed, basis = basis[:, n - 1], basis[:, : n - 1]
        for _ in range(2):
            X = fixed + np.einsum("Nk,Nkij->Nij", x, basis)
            x = x + _newton_step(X, basis, x)
        proven = _proven(x, gains, inputs)
        better = proven < best
        best = np.where(better, proven, best)
        best_x[better] = x[better]
        lower = 0.7 * np.minimum(proven, beta) + 0.3 * beta
        moves = (beta - lower > accuracy * beta) & (lower > ZERO * highest)
        beta = np.where(moves, lower, beta)
        idle = 0 if moves.any() else idle + 1
        if idle == PATIENCE:  # centring goes on where beta rests: often it moves again
            break
    D = np.hstack([np.sqrt(best_x), np.ones((N, 1))])
    return UpperBound(best, D * balance / balance[:, -1:])


def block_of_each(blocks: list[Block]) -> tuple[Ints, Ints]:
    """Index of the block of each output, and of each input, of M."""
    count = np.arange(len(blocks))
    return np.repeat(count, [b.columns for b in blocks]), np.repeat(count, [b.rows for b in blocks])


def scaled(M: ComplexArray, D: Array, blocks: list[Block]) -> ComplexArray:
    """D M D^-1 (N, outputs, inputs) with a scale D (N, blocks) of each block."""
    outputs, inputs = block_of_each(blocks)
    return np.asarray(D[:, outputs, None] * M / D[:, None, inputs], complex)


def _dagger(M: ComplexArray) -> ComplexArray:
    return M.conj().swapaxes(-1, -2)


def _balanced(M: ComplexArray, outputs: Ints, inputs: Ints) -> Array:
    """Scales (N, blocks) that minimise the Frobenius norm of D M D^-1 off the diagonal (Osborne 1960)."""
    n = outputs[-1] + 1
    of_output, of_input = (np.eye(n)[each] for each in (outputs, inputs))
    power = np.einsum("Noi,oj,ik->jkN", np.abs(M) ** 2, of_output, of_input)
    tiny = 1e-28 * power.max((0, 1)) + 1e-300  # a block that nothing reaches keeps a scale
    power = np.where(np.eye(n)[:, :, None] > 0, 0.0, power + tiny)
    d2 = np.ones((n, len(M)))
    for k in [*range(n)] * 30 if n > 1 else []:
        d2[k] = np.sqrt((power[:, k] * d2).sum(0) / (power[k] / d2).sum(0))
    return np.asarray(np.sqrt(d2 / d2[-1]).T, float)


def _proven(x: Array, gains: ComplexArray, inputs: Ints) -> Array:
    """Smallest beta (N,), a bound on mu, that the scales x prove."""
    d2 = np.hstack([x, np.ones((len(x), 1))])
    d = np.sqrt(d2[:, inputs])
    left = np.einsum("Nk,Nkij->Nij", d2, gains) / (d[:, :, None] * d[:, None, :])
    return np.sqrt(np.maximum(np.linalg.eigvalsh(left)[:, -1], 0.0))


def _newton_step(X: ComplexArray, basis: ComplexArray, x: Array) -> Array:
    """Newton step that reduces -log det X(x) - sum log x, its length found by a line search."""
    values, vectors = np.linalg.eigh(X)
    S = vectors / np.sqrt(np.maximum(values, 1e-14 * values[:, -1:]))[:, None, :]
    Y = _dagger(S)[:, None] @ basis @ S[:, None]  # X^-1/2 dX X^-1/2
    gradient = -np.einsum("Nkii->Nk", Y).real
    hessian = np.einsum("Nkij,Nlji->Nkl", Y, Y).real
    p = np.arange(x.shape[1])
    gradient -= 1.0 / x
    hessian[:, p, p] += 1.0 / x**2
    steepest = np.abs(hessian).max((1, 2), initial=1e-300)
    hessian += 1e-13 * steepest[:, None, None] * np.eye(x.shape[1])  # a scale without effect stays
    step = -np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
    # along it the barrier is -sum log(1 + t r), r the eigenvalues of X^-1/2 dX X^-1/2 and the relative steps
    along = np.linalg.eigvalsh(np.einsum("Nk,Nkij->Nij", step, Y))
    r = np.hstack([along, step / x])
    decrement = np.sqrt(np.maximum(-(gradient * step).sum(1), 0.0))
    t = 1.0 / (1.0 + decrement)  # inside for certain: the barrier is self-concordant
    room = 1.0 / np.maximum(-r.min(1), 1e-12)
    t = np.minimum(t, 0.9 * room)
    for _ in range(4):
        share = r / (1.0 + t[:, None] * r)
        longer = t + share.sum(1) / np.maximum((share**2).sum(1), 1e-300)
        t = np.clip(longer, 0.1 * t, 0.5 * (t + room))
    return np.asarray(step * t[:, None], float)
