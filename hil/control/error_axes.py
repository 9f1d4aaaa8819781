"""The error of the six axes of a law: of the legs, or of the pose."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import helper
from hil.mathematics.rotations import relative_rotation, rotation_vector_rate
from hil.mathematics.vectors import at, rotate, rotate_back


@helper
def error_axes(
    pose: bool, q: Array, dq: Array, p: Array, R: Array, twist: Array,
    p_d: Array, R_d: Array, twist_d: Array, dtwist_d: Array, q_d: Array, dq_d: Array, ddq_d: Array,
    e: Array, de: Array, rate: Array, feed: Array,
) -> None:  # fmt: skip
    """Fill e, de, and rate and acceleration of the reference, each (6,), of the axes.

    Legs: e = q_d - q. Pose: e = [p_d - p; r], r = log(R_d R^T), base frame, and dr its exact derivative as in
    `hil.control.pose_inverse_dynamics`; the reference's are twist_d and dtwist_d, which for the rotation
    differ from the derivatives of r in the second order of r.
    """
    if not pose:
        for i in range(6):
            e[i] = q_d[i] - q[i]
            de[i] = dq_d[i] - dq[i]
            rate[i] = dq_d[i]
            feed[i] = ddq_d[i]
        return
    r = relative_rotation(R, R_d)
    turning = rotate(R_d, rotate_back(R, at(twist, 3)))
    Omega = np.empty(3)
    for i in range(3):
        Omega[i] = twist_d[3 + i] - turning[i]
    dr = rotation_vector_rate(r, Omega)
    for i in range(3):
        e[i] = p_d[i] - p[i]
        de[i] = twist_d[i] - twist[i]
        e[3 + i] = r[i]
        de[3 + i] = dr[i]
    for i in range(6):
        rate[i] = twist_d[i]
        feed[i] = dtwist_d[i]
