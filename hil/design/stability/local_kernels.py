"""The loop of a linearising law at one state, compiled: a survey takes many thousands.

``c``: the vector of constants that `hil.robot.dynamics` packs, of the robot; ``believed`` and ``code``: what
its law believes of it. joint: the axes are the legs, else the pose. h: of the differences.
"""

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import BOOLEAN, INTEGER, MATRIX, REAL, VECTOR, helper, kernel
from hil.design.stability.differences import acceleration, by_demand, by_state, displace
from hil.mathematics.linear_algebra import condition_kernel, lu_factor, lu_solve, solve
from hil.mathematics.vectors import at
from hil.robot.dynamics_kernels import (
    BASE,
    FULL,
    PLATFORM,
    fill_jacobian,
    fill_mass_matrix,
    inverse_dynamics_kernel,
    joint_idc_kernel,
)
from hil.robot.kinematics_kernels import jacobian_rate_twist

FORCE, TORQUE, VISCOUS, COULOMB = 0, 1, 2, 8
"""Where `stated` (14,) has the load's force, N, and torque, N m, and each leg's friction, N s/m and N."""


@helper
def fill_demanded(
    c: Array, joint: bool, p: Array, R: Array, twist: Array, dtwist: Array, J: Array, demanded: Array
) -> None:
    """Fill the accelerations (6,) of the axes under a motion of the platform; J belongs to p, R."""
    for i in range(6):
        demanded[i] = dtwist[i]
        if joint:
            a, b = at(c, BASE + 3 * i), at(c, PLATFORM + 3 * i)
            total = jacobian_rate_twist(a, b, at(p, 0), R, at(twist, 0), at(twist, 3))
            for j in range(6):
                total += J[i, j] * dtwist[j]
            demanded[i] = total


@helper
def fill_mobility(
    c: Array, joint: bool, p: Array, R: Array, J: Array, mobility: Array, per_force: Array
) -> None:
    """Fill accelerations of the axes per wrench on the platform, and per force of the legs, all (6, 6)."""
    M, LU, order = np.empty((6, 6)), np.empty((6, 6)), np.empty(6, np.int64)
    fill_mass_matrix(c, p, R, M)
    inverse, unit = np.full((6, 6), np.nan), np.zeros(6)
    if lu_factor(M, LU, order):
        for j in range(6):
            unit[j] = 1.0
            lu_solve(LU, order, unit, inverse[j])  # M is symmetric: a row as good as a column
            unit[j] = 0.0
    for i in range(6):
        for j in range(6):
            mobility[i, j] = inverse[i, j]
            if joint:
                mobility[i, j] = 0.0
                for k in range(6):
                    mobility[i, j] += J[i, k] * inverse[k, j]
    for i in range(6):
        for j in range(6):
            per_force[i, j] = 0.0
            for k in range(6):
                per_force[i, j] += mobility[i, k] * J[j, k]


@helper
def fill_extremes(
    mobility: Array, per_force: Array, error: Array, rates: Array, stated: Array, d: Array, extremes: Array
) -> None:
    """Fill the largest |d| (6,) of each axis, and the disturbances (12, 6) at each axis' extremes.

    error: (6,) what the axes miss of their demand without load; rates: (6,) m/s of the legs.
    """
    worst = np.zeros(6)
    for i in range(6):
        for half in range(2):
            square = 0.0
            for k in range(3 * half, 3 * half + 3):
                square += mobility[i, k] * mobility[i, k]
            size = np.sqrt(square)
            for k in range(3 * half, 3 * half + 3):
                worst[k] = stated[FORCE + half] * mobility[i, k] / size if size > 0.0 else 0.0
        d[i] = abs(error[i])
        for j in range(6):
            load = 0.0
            for k in range(6):
                load += worst[k] * mobility[j, k]
            extremes[i, j] = error[j] + load
            extremes[6 + i, j] = error[j] - load
            if j == i:
                d[i] += load
            lost = stated[VISCOUS + j] * abs(rates[j]) + stated[COULOMB + j]
            d[i] += abs(per_force[i, j]) * lost


@helper
def multiplied(A: Array, B: Array, C: Array) -> None:
    """Fill C = A B, all (6, 6)."""
    for i in range(6):
        for j in range(6):
            C[i, j] = 0.0
            for k in range(6):
                C[i, j] += A[i, k] * B[k, j]


@kernel(VECTOR, VECTOR, INTEGER, BOOLEAN, VECTOR, MATRIX, MATRIX, MATRIX, VECTOR, REAL, REAL, REAL)
def local_kernel(
    c: Array, believed: Array, code: int, joint: bool, p_d: Array, R_d: Array, motion: Array, behind: Array,
    stated: Array, stale_s: float, radius: float, h: float,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, float]:  # fmt: skip
    """Return the fields of `disturbance.Local`; all nan and infinite where J is singular.

    p_d (3,) m, R_d (3, 3), motion (2, 6): twist and dtwist of the reference, SI; behind (2, 6): how far the
    axes are behind it, and their rates.
    """
    J, demanded, x, dx = np.empty((6, 6)), np.empty(6), behind[0].copy(), behind[1].copy()
    twist_d, dtwist_d = motion[0], motion[1]
    fill_jacobian(c, FULL, p_d, R_d, J)
    fill_demanded(c, joint, p_d, R_d, twist_d, dtwist_d, J, demanded)
    if joint:
        x, dx = solve(J, x), solve(J, dx)
    p, R, twist = np.empty(3), np.empty((3, 3)), twist_d - dx
    displace(p_d, R_d, -x, p, R)
    fill_jacobian(c, FULL, p, R, J)
    condition = condition_kernel(J, radius)
    mobility, per_force = np.empty((6, 6)), np.empty((6, 6))
    Gamma, stale, d, extremes = np.empty((6, 6)), np.empty((6, 6)), np.empty(6), np.zeros((12, 6))
    if not np.isfinite(condition):
        d[:] = np.inf
        Gamma[:] = np.nan
        return Gamma, Gamma, Gamma, d, extremes, Gamma, Gamma, np.inf
    fill_mobility(c, joint, p, R, J, mobility, per_force)
    tau, per_demand = by_demand(believed, code, joint, p, R, twist, demanded)
    error = acceleration(c, joint, p, R, twist, tau) - demanded
    multiplied(per_force, per_demand, Gamma)
    stale[:] = Gamma
    if stale_s != 0.0:
        p_was, R_was = np.empty(3), np.empty((3, 3))
        displace(p, R, -stale_s * twist_d, p_was, R_was)
        _, late = by_demand(believed, code, joint, p_was, R_was, twist - stale_s * dtwist_d, demanded)
        multiplied(per_force, late, stale)
    rates = np.zeros(6)
    for i in range(6):
        for j in range(6):
            rates[i] += J[i, j] * twist[j]
    fill_extremes(mobility, per_force, error, rates, stated, d, extremes)
    by_error, by_rate = by_state(c, joint, p, R, twist, tau, h)
    return Gamma, stale, per_force, d, extremes, by_error, by_rate, condition


@kernel(VECTOR, VECTOR, INTEGER, BOOLEAN, VECTOR, MATRIX, MATRIX)
def reference_kernel(
    c: Array, believed: Array, code: int, joint: bool, p: Array, R: Array, motion: Array
) -> tuple[Array, Array]:
    """Return the law's forces (6,) N on the reference, and the accelerations of the axes per force (6, 6)."""
    J, demanded = np.empty((6, 6)), np.empty(6)
    fill_jacobian(c, FULL, p, R, J)
    fill_demanded(c, joint, p, R, motion[0], motion[1], J, demanded)
    mobility, per_force = np.empty((6, 6)), np.empty((6, 6))
    fill_mobility(c, joint, p, R, J, mobility, per_force)
    none = np.zeros(6)
    if joint:
        return joint_idc_kernel(believed, code, p, R, motion[0], J, demanded, none), per_force
    return inverse_dynamics_kernel(believed, code, p, R, motion[0], demanded, none), per_force
