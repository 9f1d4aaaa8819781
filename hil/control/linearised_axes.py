"""What a force does to the axes that inverse dynamics leaves: the leg lengths, or the platform's pose.

An axis obeys ddy = ddy* where the model is exact: y the leg lengths, or position and rotation of the platform
with the error of `hil.control.pose_inverse_dynamics`, e = [p_d - p; log(R_d R^T)]. A law asks for
ddy* = ddy_d + u, so that the error obeys e'' = -u, and these are the u that a force brings about: the inverse
of the linear part of the law.
"""

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, VECTOR, kernel
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.rotations import rotation_motion_kernel, rotation_vector_rate
from hil.mathematics.vectors import at, rotate
from hil.robot.dynamics_kernels import fill_jacobian, model_inertia


@kernel(VECTOR, INTEGER, VECTOR, MATRIX, VECTOR)
def accelerations(c: Array, code: int, p: Array, R: Array, tau: Array) -> Array:
    """Return [M^-1 J^T tau; J M^-1 J^T tau] (2, 6), of platform and legs; nan: M is singular.

    With the M and J of the variant. One leg's force moves all legs.
    """
    M = np.empty((6, 6))
    model_inertia(c, code, p, R, M)
    J = np.empty((6, 6))
    fill_jacobian(c, code, p, R, J)
    f = np.zeros(6)
    for i in range(6):
        for j in range(6):
            f[j] += J[i, j] * tau[i]
    answer = np.zeros((2, 6))
    LU = np.empty((6, 6))
    order = np.empty(6, np.int64)
    if lu_factor(M, LU, order):
        lu_solve(LU, order, f, answer[0])
        for i in range(6):
            for j in range(6):
                answer[1, i] += J[i, j] * answer[0, j]
    else:
        answer[:] = np.nan
    return answer


@kernel(MATRIX, VECTOR)
def pose_acceleration(errors: Array, dtwist: Array) -> Array:
    """Return [dv; L(r)^-1 E domega] (6,) m/s^2, rad/s^2, for dtwist = [dv; domega] of the platform.

    errors (2, 6): of `pose_errors`. Of the rotation vector r = log(R_d R^T) the second derivative is then
    -L(r)^-1 E domega, E = R_d R^T.
    """
    r = errors[0, 3:].copy()
    still = np.zeros(3)
    E, _, _ = rotation_motion_kernel(r, still, still)
    acceleration = dtwist.copy()
    acceleration[3:] = rotation_vector_rate(r, np.array(rotate(E, at(dtwist, 3))))
    return acceleration
