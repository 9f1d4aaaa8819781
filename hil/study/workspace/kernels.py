"""Compiled computation of leg lengths, forces, joint angles and condition number at many poses at once."""

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import MATRIX, OUT_MATRIX, REAL, VECTOR, helper, kernel
from hil.mathematics.linear_algebra import condition_from_lu, lu_factor, lu_solve_transposed
from hil.mathematics.vectors import at, cross, dot, rotate, row, scale
from hil.robot.dynamics_kernels import BASE, GRAVITY, PLATFORM, gravity_kernel
from hil.robot.kinematics_kernels import lengths_and_jacobian, segment_distance

# Columns of a survey.
LENGTH = 0  # six, m
FORCE = 6  # six, N: what holds the platform still; nan where J is singular
BASE_COSINE = 12  # six, of the angle between leg and axis of its base joint
PLATFORM_COSINE = 18  # six, of the angle between leg and axis of its platform joint
ORIENTATION = 24  # sign of det J
CONDITION = 25  # bound of hil.mathematics.linear_algebra.condition_kernel
CLEARANCE = 26  # m, smallest distance of two leg axes that are watched; inf where none are
COLUMNS = 27


@helper
def determinant_sign(LU: Array, order: Ints) -> float:
    """Sign of det A, +1 or -1, from its LU factors P A = L U; order (6,): row permutation P."""
    sign = 1.0
    for i in range(6):
        if LU[i, i] < 0.0:
            sign = -sign
        for j in range(i):
            if order[j] > order[i]:
                sign = -sign
    return sign


@kernel(VECTOR, VECTOR, MATRIX, MATRIX, MATRIX, REAL, MATRIX, MATRIX, OUT_MATRIX)
def survey_kernel(
    c: Array,
    payload: Array,
    base_axes: Array,
    platform_axes: Array,
    watched: Array,
    r: float,
    P: Array,
    RR: Array,
    out: Array,
) -> None:
    """Compute the figures of n poses into out (n, 27): row k of P (n, 3) m and, as (3, 3), of RR (n, 9).

    ``c``: constants of ``hil.robot.dynamics``. ``payload`` (4,): kg and its place in the platform frame, m.
    ``base_axes`` (6, 3) base frame and ``platform_axes`` (6, 3) platform frame: unit, from base to platform.
    ``watched`` (6, 6): > 0 if the distance of two legs counts. ``r``: as in ``condition_kernel``. Leg forces:
    tau = J^-T (G - wrench), where the wrench is the payload's weight.
    """
    a = c[BASE : BASE + 18].reshape(6, 3)
    b = c[PLATFORM : PLATFORM + 18].reshape(6, 3)
    g = at(c, GRAVITY)
    work = np.empty((33, 6))
    J = work[0:6]
    LU = work[6:12]
    order = np.empty(6, np.int64)
    for k in range(P.shape[0]):
        p = P[k]
        R = RR[k].reshape(3, 3)
        l = out[k, 0:6]
        tau = out[k, 6:12]
        lengths_and_jacobian(a, b, p, R, l, J)
        weight = scale(payload[0], g)
        moment = cross(rotate(R, at(payload, 1)), weight)
        f = gravity_kernel(c, p, R)
        for i in range(3):
            f[i] -= weight[i]
            f[3 + i] -= moment[i]
        for i in range(6):
            s = at(J[i], 0)
            out[k, BASE_COSINE + i] = dot(s, row(base_axes, i))
            out[k, PLATFORM_COSINE + i] = dot(s, rotate(R, row(platform_axes, i)))
        out[k, ORIENTATION] = 0.0
        out[k, CONDITION] = np.inf
        tau[:] = np.nan
        if lu_factor(J, LU, order):
            lu_solve_transposed(LU, order, f, tau, work[12])
            out[k, ORIENTATION] = determinant_sign(LU, order)
            out[k, CONDITION] = condition_from_lu(J, r, LU, order, work[13:32])
        clearance = np.inf
        for i in range(6):
            for j in range(i):
                if watched[i, j] > 0.0:
                    u = scale(l[i], at(J[i], 0))
                    v = scale(l[j], at(J[j], 0))
                    clearance = min(clearance, segment_distance(row(a, i), u, row(a, j), v))
        out[k, CLEARANCE] = clearance
