"""The tracking error of the six axes on which a law acts: the legs, or the pose."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import helper
from hil.mathematics.rotations import relative_rotation, rotation_vector_rate
from hil.mathematics.vectors import at, rotate, rotate_back, sub


@helper
def error_axes(pose: bool, tick: Any, e: Array, de: Array, rate: Array, feed: Array) -> None:
    """Fill e, de, and rate and acceleration of the reference, each (6,), for the axes.

    pose: False for leg axes, True for pose axes. Legs: e = q_d - q, m. Pose: e = [p_d - p; r], m and rad, r =
    log(R_d R^T), base frame, and dr is its exact derivative as in `hil.control.pose_inverse_dynamics`. Rate
    and acceleration of the reference are then twist_d and dtwist_d; for the rotation they differ from the
    derivatives of r in the second order of r.
    """
    if not pose:
        for i in range(6):
            e[i] = tick.q_d[i] - tick.q[i]
            de[i] = tick.dq_d[i] - tick.dq[i]
            rate[i] = tick.dq_d[i]
            feed[i] = tick.ddq_d[i]
        return
    r = relative_rotation(tick.R, tick.R_d)
    turning = rotate(tick.R_d, rotate_back(tick.R, at(tick.twist, 3)))
    dr = rotation_vector_rate(r, np.array(sub(at(tick.twist_d, 3), turning)))
    for i in range(3):
        e[i] = tick.p_d[i] - tick.p[i]
        de[i] = tick.twist_d[i] - tick.twist[i]
        e[3 + i] = r[i]
        de[3 + i] = dr[i]
    for i in range(6):
        rate[i] = tick.twist_d[i]
        feed[i] = tick.dtwist_d[i]
