"""Lengths, rates, accelerations, forces and condition along a sampled path: compiled, as it has thousands."""

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, OUT_MATRIX, REAL, VECTOR, kernel
from hil.mathematics.linear_algebra import condition_kernel
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.robot.kinematics_kernels import jacobian_rate_kernel, lengths_and_jacobian

SAMPLE = 24
"""Numbers of a sample: p (3,) m, R (3, 3) by rows, twist (6,), dtwist (6,), SI."""
LENGTH, RATE, ACCELERATION, FORCE, CONDITION = 0, 6, 12, 18, 24
"""Where a row of what is found has q, dq, ddq (6,) m, m/s, m/s^2, tau (6,) N, and the condition of J."""


@kernel(MATRIX, MATRIX, VECTOR, INTEGER, REAL, MATRIX, OUT_MATRIX, OUT_MATRIX)
def walk_kernel(
    a: Array, b: Array, c: Array, code: int, radius: float, samples: Array, found: Array, Js: Array
) -> None:
    """Fill found (n, 25) and J (n, 36) at each of the samples (n, 24).

    a, b (6, 3) m: base and platform joints. c, code: of the model, see `hil.robot.dynamics`. radius: m that
    makes rotations comparable with displacements. Forces are those of `inverse_dynamics_kernel`.
    """
    p, R, twist, dtwist = np.empty(3), np.empty((3, 3)), np.empty(6), np.empty(6)
    no_wrench, l, J = np.zeros(6), np.empty(6), np.empty((6, 6))
    for k in range(len(samples)):
        for i in range(3):
            p[i] = samples[k, i]
            for j in range(3):
                R[i, j] = samples[k, 3 + 3 * i + j]
        for i in range(6):
            twist[i], dtwist[i] = samples[k, 12 + i], samples[k, 18 + i]
        lengths_and_jacobian(a, b, p, R, l, J)
        J_dot = jacobian_rate_kernel(a, b, p, R, twist)
        tau = inverse_dynamics_kernel(c, code, p, R, twist, dtwist, no_wrench)
        for i in range(6):
            rate = acceleration = 0.0
            for j in range(6):
                Js[k, 6 * i + j] = J[i, j]
                rate += J[i, j] * twist[j]
                acceleration += J[i, j] * dtwist[j] + J_dot[i, j] * twist[j]
            found[k, LENGTH + i], found[k, RATE + i] = l[i], rate
            found[k, ACCELERATION + i], found[k, FORCE + i] = acceleration, tau[i]
        found[k, CONDITION] = condition_kernel(J, radius)
