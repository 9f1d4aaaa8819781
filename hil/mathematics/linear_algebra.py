"""6 x 6 linear algebra without LAPACK: LU with partial pivoting, and a bound on the condition number.

The last bit of a LAPACK result depends on the kernel that OpenBLAS selects for the processor; the results
of this code do not.
"""

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import MATRIX, REAL, VECTOR, helper, kernel


@helper
def lu_factor(A: Array, LU: Array, order: Ints) -> bool:
    """Factor P A = L U into ``LU`` (unit diagonal of L not stored); row i of P A is row ``order[i]`` of A.

    All (6, 6). Returns False for a pivot that is zero or not finite; ``LU`` is then invalid.
    """
    for i in range(6):
        order[i] = i
        for j in range(6):
            LU[i, j] = A[i, j]
    for k in range(6):
        pivot = k
        largest = abs(LU[k, k])
        for i in range(k + 1, 6):
            size = abs(LU[i, k])
            if size > largest:
                largest = size
                pivot = i
        if not (largest > 0.0 and largest < np.inf):
            return False
        if pivot != k:
            order[k], order[pivot] = order[pivot], order[k]
            for j in range(6):
                LU[k, j], LU[pivot, j] = LU[pivot, j], LU[k, j]
        inverse = 1.0 / LU[k, k]
        for i in range(k + 1, 6):
            factor = LU[i, k] * inverse
            LU[i, k] = factor
            for j in range(k + 1, 6):
                LU[i, j] -= factor * LU[k, j]
    return True


@helper
def lu_solve(LU: Array, order: Ints, b: Array, x: Array) -> None:
    """Solve A x = b with the factors of ``lu_factor``; fills ``x`` (6,), which must not be ``b``."""
    for i in range(6):
        total = b[order[i]]
        for j in range(i):
            total -= LU[i, j] * x[j]
        x[i] = total
    for k in range(6):
        i = 5 - k
        total = x[i]
        for j in range(i + 1, 6):
            total -= LU[i, j] * x[j]
        x[i] = total / LU[i, i]


@helper
def lu_solve_transposed(LU: Array, order: Ints, b: Array, x: Array, work: Array) -> None:
    """Solve A^T x = b with the factors of ``lu_factor``; fills ``x`` (6,); ``work`` is scratch (6,)."""
    for i in range(6):
        total = b[i]
        for j in range(i):
            total -= LU[j, i] * work[j]
        work[i] = total / LU[i, i]
    for k in range(6):
        i = 5 - k
        total = work[i]
        for j in range(i + 1, 6):
            total -= LU[j, i] * work[j]
        work[i] = total
    for i in range(6):
        x[order[i]] = work[i]


@kernel(MATRIX, VECTOR)
def solve(A: Array, b: Array) -> Array:
    """Solution of A x = b, all nan where A is singular. A (6, 6), b (6,)."""
    LU = np.empty((6, 6))
    order = np.empty(6, np.int64)
    x = np.empty(6)
    if lu_factor(A, LU, order):
        lu_solve(LU, order, b, x)
    else:
        x[:] = np.nan
    return x


@kernel(MATRIX, VECTOR)
def solve_transposed(A: Array, b: Array) -> Array:
    """Solution of A^T x = b, all nan where A is singular. A (6, 6), b (6,)."""
    LU = np.empty((6, 6))
    order = np.empty(6, np.int64)
    x = np.empty(6)
    if lu_factor(A, LU, order):
        lu_solve_transposed(LU, order, b, x, np.empty(6))
    else:
        x[:] = np.nan
    return x


@helper
def square_scaled(A: Array, B: Array) -> float:
    """Fill B = (A / trace A)^2 for a symmetric A (6, 6), and return the trace; scaled against overflow."""
    trace = A[0, 0] + A[1, 1] + A[2, 2] + A[3, 3] + A[4, 4] + A[5, 5]
    k = 1.0 / trace
    k = k * k
    for i in range(6):
        for j in range(i, 6):
            total = 0.0
            for m in range(6):
                total += A[i, m] * A[j, m]
            B[i, j] = total * k
            B[j, i] = total * k
    return float(trace)


@helper
def largest_eigenvalue_bound(A: Array, B: Array) -> float:
    """trace(A^8)^(1/8) of a symmetric positive definite A, which is overwritten; ``B`` is scratch.

    With eigenvalues lambda_i >= 0 the trace of A^8 is the sum of lambda_i^8, between lambda_max^8 and
    6 lambda_max^8. The bound is between lambda_max and 6^(1/8) = 1.251 times lambda_max.
    """
    t0 = square_scaled(A, B)
    t1 = square_scaled(B, A)
    t2 = square_scaled(A, B)
    t3 = B[0, 0] + B[1, 1] + B[2, 2] + B[3, 3] + B[4, 4] + B[5, 5]
    return float(t0 * np.sqrt(t1 * np.sqrt(t2 * np.sqrt(t3))))


@helper
def fill_gram(A: Array, r: float, G: Array) -> None:
    """Fill G = (A S)^T (A S), S = diag(1, 1, 1, r, r, r), for scaled singular values of A; all (6, 6)."""
    for i in range(6):
        for j in range(i, 6):
            total = 0.0
            for m in range(6):
                total += A[m, i] * A[m, j]
            G[i, j] = total * (1.0 if i < 3 else r) * (1.0 if j < 3 else r)
            G[j, i] = G[i, j]


@helper
def condition_from_lu(J: Array, r: float, LU: Array, order: Ints, work: Array) -> float:
    """Upper bound on the condition number of J (``condition_kernel``) from its LU factors; work (19, 6)."""
    A = work[0:6]
    B = work[6:12]
    K = work[12:18]
    unit = work[18]
    unit[:] = 0.0
    for j in range(6):
        unit[j] = 1.0
        lu_solve(LU, order, unit, K[j])  # row j of K is column j of the inverse
        unit[j] = 0.0
    fill_gram(J, 1.0 / r, A)
    largest = largest_eigenvalue_bound(A, B)
    fill_gram(K, r, A)
    return float(np.sqrt(largest * largest_eigenvalue_bound(A, B)))


@kernel(MATRIX, REAL)
def condition_kernel(J: Array, r: float) -> float:
    """Upper bound on the 2-norm condition number of J diag(1, 1, 1, 1/r, 1/r, 1/r).

    Between 1 and 6^(1/8) = 1.251 times the condition number (1.12 times close to a singular pose); inf where
    J is singular.
    J (6, 6), r the length in m that scales rotations to displacements.
    """
    work = np.empty((25, 6))
    LU = work[0:6]
    order = np.empty(6, np.int64)
    if not lu_factor(J, LU, order):
        return np.inf
    return condition_from_lu(J, r, LU, order, work[6:])
