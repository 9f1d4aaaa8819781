"""One interval of the error-state Kalman filter of `hil.estimation.fusion`: predict, decide, update.

All measurements are processed one number at a time, so nothing is inverted; every update of P is Joseph's
(Bucy and Joseph, 1968), which keeps P symmetric and positive whatever the gain.

State x (30,): p 0..2, R 3..11 row-major, twist 12..17, biases of gyro 18..20 and accelerometer 21..23, leg
forces that the model does not know 24..29. Error (n,), n = 12, 18 or 24: dp, dtheta, dv, domega, biases where
the IMU has some, leg forces where there are some; p = p + dp, R = exp(dtheta) R: all in the base frame (the
global perturbation of Sola, Deray and Atchuthan, A micro Lie theory, 2018), biases in the platform frame.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import (
    INTEGER,
    MATRIX,
    OUT_MATRIX,
    VECTOR,
    helper,
    kernel,
)
from hil.estimation import fusion_layout as k
from hil.estimation.fusion_predict import predict, rotation_of
from hil.estimation.fusion_update import (
    beyond,
    correct,
    leg_rows,
    rate_variance,
    take,
    update_gyro,
    update_tracker,
)
from hil.mathematics.linear_algebra import condition_from_lu, lu_factor
from hil.mathematics.vectors import row
from hil.robot.kinematics_kernels import lengths_and_jacobian

OUT_CUBE = OUT_MATRIX.copy(ndim=3)


@helper
def interval(
    a: Array, b: Array, c: Array, u: Array, x0: Array, P0: Array, x: Array, P: Array, work: Array
) -> None:
    """Fill x and P at the end of the interval u from x0 and P0 at its beginning.

    The first run decides which legs are used, how much process noise there was, and whether the tracker is
    believed; later ones, for a sample that came late, keep to it.
    """
    n = P.shape[0]
    F, W = work[0:n], work[n : 2 * n]
    dx, h, g, K, Ph = work[2 * n], work[2 * n + 1], work[2 * n + 2], work[2 * n + 3], work[2 * n + 4]
    bent = work[2 * n + 5 : 2 * n + 7]
    dx[:] = 0.0
    new = u[k.TRACKER] == k.UNDECIDED
    for fades in range(k.FADES + 1):
        if new:
            u[k.TRACKER] = k.UNDECIDED
        x[:] = x0
        P[:, :] = P0
        done = 0.0
        if u[k.TRACKER] != 0.0:
            done = u[k.TRACKER_AT] * u[k.T]
            predict(x, P, u, c, done, u[k.FADE], F, W)
            update_tracker(x, P, u, c, dx, h, K, Ph)
        predict(x, P, u, c, u[k.T] - done, u[k.FADE], F, W)
        count, last = beyond(a, b, x, P, u, c, h, g, bent, F, W)
        if u[k.DECIDED] != 0.0 or count == 0 or fades == k.FADES:
            break
        if count == 1 and u[k.USED + last] < k.KEPT:
            u[k.USED + last] = 0.0
            break
        u[k.FADE] *= 100.0
    u[k.DECIDED] = 1.0
    for i in range(6):
        if u[k.USED + i] != 0.0:
            l, rate = leg_rows(row(a, i), row(b, i), x, h, g)
            r = c[k.R_LENGTH] + bent[1, i] + rate * rate * c[k.LATCH]
            take(P, h, r, u[k.LENGTH + i] - l - bent[0, i], dx, K, Ph)
            take(P, g, rate_variance(x, u, c, g, rate), u[k.RATE + i] - rate, dx, K, Ph)
    if u[k.IMU] != 0.0:
        update_gyro(x, P, u, c, dx, h, K, Ph)
    correct(x, c, dx)


@kernel(MATRIX, MATRIX, VECTOR, OUT_MATRIX, OUT_MATRIX, OUT_CUBE, INTEGER, INTEGER)
def rerun_kernel(
    a: Array, b: Array, c: Array, intervals: Array, states: Array, covariances: Array, first: int, count: int
) -> None:
    """Run ``count`` intervals of the rings from ``first`` on, each from the state before it.

    a, b (6, 3) joints; c (NOISE,); rings: intervals (N, INTERVAL), states (N, STATE), covariances (N, n, n).
    """
    size = intervals.shape[0]
    n = covariances.shape[1]
    work = np.empty((2 * n + 7, n))
    for i in range(count):
        now = (first + i) % size
        x0, P0 = states[(now + size - 1) % size], covariances[(now + size - 1) % size]
        interval(a, b, c, intervals[now], x0, P0, states[now], covariances[now], work)


@helper
def fill_estimate(a: Array, b: Array, radius: float, x: Array, u: Array, P: Array, tick: Any) -> None:
    """Fill q, dq, p, R, twist, J, fk_residual, condition, innovation_q and pose_std of a tick.

    a, b (6, 3) m joints, base frame and platform frame; radius m; x (STATE,), u (INTERVAL,) and P (n, n), the
    newest of their rings. Units, shapes and frames of the columns: `drivers.tick_columns`. fk_residual is the
    largest |measured - q| of the used legs, nan where x is not finite; pose_std the root of P's first six
    variances; condition as in hil.mathematics.linear_algebra with radius, inf where J is singular.
    """
    q, dq, J = tick.q, tick.dq, tick.J
    tick.p[:] = x[0:3]
    R = rotation_of(x)
    tick.R[:, :] = R
    tick.twist[:] = x[k.TWIST : k.TWIST + 6]
    lengths_and_jacobian(a, b, x[0:3], R, q, J)
    residual = 0.0
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += J[i, j] * x[k.TWIST + j]
        dq[i] = total
        error = abs(u[k.LENGTH + i] - q[i])
        if u[k.USED + i] != 0.0 and not error <= residual:
            residual = error
        tick.innovation_q[i] = u[k.INNOVATION + i]
        tick.pose_std[i] = np.sqrt(np.maximum(P[i, i], 0.0))
    work = np.empty((25, 6))
    LU = work[0:6]
    order = np.empty(6, np.int64)
    tick.fk_residual, tick.condition = residual, np.inf
    if lu_factor(J, LU, order):
        tick.condition = condition_from_lu(J, radius, LU, order, work[6:25])
