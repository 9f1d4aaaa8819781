"""Upper bound on the structured singular value of a complex matrix, frequency by frequency.

    mu(M) = 1 / min { largest singular value of Delta : det(I - M Delta) = 0 },  Delta = diag(Delta_1 ...)

The smallest structured perturbation that makes the loop around M singular has the size 1 / mu. A. Packard and
J. Doyle, The complex structured singular value, Automatica 29 (1993).
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray
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


def upper_bound(
    M: ComplexArray, blocks: list[Block], *, accuracy: float = 1e-4, iterations: int = 100
) -> UpperBound:
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
    outputs, inputs = _slices(M, blocks)
    balance = _balanced(M, outputs, inputs)
    A = _scaled(M, balance, outputs, inputs)
    n, N = len(blocks), len(A)
    gains = np.stack([_dagger(A[:, o]) @ A[:, o] for o in outputs], 1)  # (N, n, inputs, inputs)
    units = np.zeros((n, A.shape[2], A.shape[2]))
    for k, i in enumerate(inputs):
        units[k, i, i] = np.eye(i.stop - i.start)
    x = np.ones((N, n - 1))  # d_1^2 .. d_(n-1)^2; d_n = 1
    best, best_x = _proven(x, gains, inputs), x.copy()
    beta = highest = 1.05 * best + 1e-300
    idle = 0
    for _ in range(iterations):
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


def _slices(M: ComplexArray, blocks: list[Block]) -> tuple[list[slice], list[slice]]:
    outputs, inputs = [], []
    row = column = 0
    for block in blocks:
        outputs.append(slice(row, row := row + block.columns))
        inputs.append(slice(column, column := column + block.rows))
    if M.shape[1:] != (row, column):
        raise ModelError(f"blocks for a matrix of {row} x {column}, given {M.shape[1]} x {M.shape[2]}")
    return outputs, inputs


def _dagger(M: ComplexArray) -> ComplexArray:
    return M.conj().swapaxes(-1, -2)


def _balanced(M: ComplexArray, outputs: list[slice], inputs: list[slice]) -> Array:
    """Scales (N, blocks) that minimise the Frobenius norm of D M D^-1 off the diagonal (Osborne 1960)."""
    power = np.array([[(np.abs(M[:, o, i]) ** 2).sum((1, 2)) for i in inputs] for o in outputs])
    tiny = 1e-28 * power.max((0, 1)) + 1e-300  # a block that nothing reaches keeps a scale
    power = np.where(np.eye(len(outputs))[:, :, None] > 0, 0.0, power + tiny)
    d2 = np.ones((len(outputs), len(M)))
    for _ in range(30):
        for k in range(len(outputs)):
            d2[k] = np.sqrt((power[:, k] * d2).sum(0) / (power[k] / d2).sum(0)) if len(outputs) > 1 else 1.0
    return np.asarray(np.sqrt(d2 / d2[-1]).T, float)


def _scaled(M: ComplexArray, D: Array, outputs: list[slice], inputs: list[slice]) -> ComplexArray:
    return np.asarray(_each(D, outputs)[:, :, None] * M / _each(D, inputs)[:, None, :], complex)


def _each(x: Array, parts: list[slice]) -> Array:
    """Values of n blocks (N, n), repeated for each row or column of a block."""
    return np.repeat(x, [part.stop - part.start for part in parts], axis=1)


def _proven(x: Array, gains: ComplexArray, inputs: list[slice]) -> Array:
    """Smallest beta (N,), a bound on mu, that the scales x prove."""
    d2 = np.hstack([x, np.ones((len(x), 1))])
    left = np.einsum("Nk,Nkij->Nij", d2, gains)
    d = np.sqrt(_each(d2, inputs))
    return np.asarray(
        np.sqrt(np.maximum(np.linalg.eigvalsh(left / (d[:, :, None] * d[:, None, :]))[:, -1], 0.0))
    )


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
