"""Differences of the equations of motion and of a law's forces, compiled: a survey takes many thousands.

``c``: the vector of constants that `hil.robot.dynamics` packs. joint: the axes are the legs, else the pose.
"""

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import BOOLEAN, INTEGER, MATRIX, REAL, VECTOR, helper, kernel
from hil.mathematics.linear_algebra import solve
from hil.mathematics.rotations import rotation_motion
from hil.mathematics.vectors import at
from hil.robot.dynamics_kernels import (
    BASE,
    FULL,
    PLATFORM,
    fill_jacobian,
    forward_dynamics_kernel,
    inverse_dynamics_kernel,
    joint_idc_kernel,
)
from hil.robot.kinematics_kernels import jacobian_rate_twist


@kernel(VECTOR, BOOLEAN, VECTOR, MATRIX, VECTOR, VECTOR)
def acceleration(c: Array, joint: bool, p: Array, R: Array, twist: Array, tau: Array) -> Array:
    """Return the accelerations (6,) of the axes under the forces tau (6,) N, unloaded."""
    dtwist = forward_dynamics_kernel(c, FULL, p, R, twist, tau, np.zeros(6))
    if not joint:
        return dtwist
    J, ddq = np.empty((6, 6)), np.empty(6)
    fill_jacobian(c, FULL, p, R, J)
    for i in range(6):
        a, b = at(c, BASE + 3 * i), at(c, PLATFORM + 3 * i)
        ddq[i] = jacobian_rate_twist(a, b, at(p, 0), R, at(twist, 0), at(twist, 3))
        for j in range(6):
            ddq[i] += J[i, j] * dtwist[j]
    return ddq


@helper
def displace(p: Array, R: Array, x: Array, at_p: Array, at_R: Array) -> None:
    """Fill the pose shifted by x[:3] m and turned by the rotation vector x[3:] rad, base frame."""
    Q = np.empty((3, 3))
    rotation_motion(at(x, 3), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), Q)
    for i in range(3):
        at_p[i] = p[i] + x[i]
        for j in range(3):
            at_R[i, j] = Q[i, 0] * R[0, j] + Q[i, 1] * R[1, j] + Q[i, 2] * R[2, j]


@kernel(VECTOR, BOOLEAN, VECTOR, MATRIX, VECTOR, VECTOR, REAL)
def by_state(
    c: Array, joint: bool, p: Array, R: Array, twist: Array, tau: Array, h: float
) -> tuple[Array, Array]:
    """Return the derivatives (6, 6) of the axes' accelerations by their places, and by their rates.

    h: of the differences, m, rad, m/s or rad/s. While a place changes, the rates of the axes stay.
    """
    by_error, by_rate = np.empty((6, 6)), np.empty((6, 6))
    J, J_at = np.empty((6, 6)), np.empty((6, 6))
    fill_jacobian(c, FULL, p, R, J)
    rates, step = np.zeros(6), np.zeros(6)
    for i in range(6):
        for j in range(6):
            rates[i] += J[i, j] * twist[j]
    at_p, at_R = np.empty(3), np.empty((3, 3))
    here = acceleration(c, joint, p, R, twist, tau)
    for i in range(6):
        step[:] = 0.0
        step[i] = h
        x = solve(J, step) if joint else step
        displace(p, R, x, at_p, at_R)
        there = twist.copy()
        if joint:
            fill_jacobian(c, FULL, at_p, at_R, J_at)
            there = solve(J_at, rates)
        moved = acceleration(c, joint, at_p, at_R, there, tau)
        faster = acceleration(c, joint, p, R, twist + x, tau)
        for k in range(6):
            by_error[k, i] = (moved[k] - here[k]) / h
            by_rate[k, i] = (faster[k] - here[k]) / h
    return by_error, by_rate


@kernel(VECTOR, INTEGER, BOOLEAN, VECTOR, MATRIX, VECTOR, VECTOR)
def by_demand(
    c: Array, code: int, joint: bool, p: Array, R: Array, twist: Array, demanded: Array
) -> tuple[Array, Array]:
    """Return a law's forces (6,) N, and (6, 6) per acceleration that is demanded of the axes, (6,).

    c and code: what the law believes of the robot.
    """
    J, per_demand, none = np.empty((6, 6)), np.empty((6, 6)), np.zeros(6)
    fill_jacobian(c, FULL, p, R, J)
    tau = np.empty(6)
    for i in range(-1, 6):
        wanted = demanded.copy()
        if i >= 0:
            wanted[i] += 1.0
        if joint:
            found = joint_idc_kernel(c, code, p, R, twist, J, wanted, none)
        else:
            found = inverse_dynamics_kernel(c, code, p, R, twist, wanted, none)
        if i < 0:
            tau[:] = found
            continue
        for k in range(6):
            per_demand[k, i] = found[k] - tau[k]
    return tau, per_demand
