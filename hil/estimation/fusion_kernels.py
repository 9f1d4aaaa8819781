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
from hil.estimation.fusion_predict import acceleration, exp_step, forces_at, predict, rotation_of, variance_of
from hil.mathematics.linear_algebra import condition_from_lu, lu_factor
from hil.mathematics.rotations import orthonormalise, rotation_vector_kernel
from hil.mathematics.vectors import Vector, add, at, cross, dot, rotate, rotate_back, row, scale, sub
from hil.robot.kinematics_kernels import leg, lengths_and_jacobian

NOTHING = 1e-8
"""A bend whose square is less than this share of the variance of a length is left out."""


@helper
def take(P: Array, h: Array, r: float, innovation: float, dx: Array, K: Array, Ph: Array) -> None:
    """Use one number: z = h . error + noise of variance r; adds to the correction dx, and updates P.

    innovation is that of the state before any correction. P = (I - K h) P (I - K h)^T + K r K^T.
    """
    n = P.shape[0]
    s = r
    predicted = 0.0
    Ph[:] = 0.0
    for j in range(n):
        if h[j] != 0.0:
            for i in range(n):
                Ph[i] += h[j] * P[j, i]
    for i in range(n):
        s += h[i] * Ph[i]
        predicted += h[i] * dx[i]
    for i in range(n):
        K[i] = Ph[i] / s
        dx[i] += K[i] * (innovation - predicted)
    for i in range(n):
        for j in range(n):
            P[i, j] -= K[i] * Ph[j]
    Ph[:] = 0.0
    for j in range(n):
        if h[j] != 0.0:
            for i in range(n):
                Ph[i] += P[i, j] * h[j]
    for i in range(n):
        for j in range(i, n):
            P[i, j] += (r * K[i] - Ph[i]) * K[j]
            P[j, i] = P[i, j]


@helper
def correct(x: Array, c: Array, dx: Array) -> None:
    """Apply the correction dx (n,) to x, and clear it."""
    for i in range(3):
        x[i] += dx[i]
        x[k.TWIST + i] += dx[6 + i]
        x[k.TWIST + 3 + i] += dx[9 + i]
        if c[k.BIASED] != 0.0:
            x[k.GYRO_BIAS + i] += dx[12 + i]
            x[k.FORCE_BIAS + i] += dx[15 + i]
    forces = forces_at(dx.shape[0], c)
    for i in range(6 if forces else 0):
        x[k.LEG_FORCE + i] += dx[forces + i]
    R = rotation_of(x)
    exp_step(R, at(dx, 3))
    orthonormalise(R)
    dx[:] = 0.0


@helper
def leg_rows(a: Vector, b: Vector, x: Array, h: Array, g: Array) -> tuple[float, float]:
    """Return length and rate of one leg, and fill their rows h and g (n,) of the measurement matrix.

    With r = R b, u = v + omega x r: dl = s . (dp + dtheta x r); the rate s . u changes with the pose by
    ds . (dp + dtheta x r) + s . (omega x (dtheta x r)), ds = (u - s s.u) / l, and with the twist like dl.
    """
    R = rotation_of(x)
    r = rotate(R, b)
    l, s = leg(a, r, at(x, 0))
    v = at(x, k.TWIST)
    w = at(x, k.TWIST + 3)
    u = add(v, cross(w, r))
    rate = dot(s, u)
    ds = scale(1.0 / l, sub(u, scale(rate, s)))
    m = cross(r, s)
    turned = add(cross(r, ds), cross(r, cross(s, w)))
    h[:] = 0.0
    g[:] = 0.0
    for i in range(3):
        h[i] = s[i]
        h[3 + i] = m[i]
        g[i] = ds[i]
        g[3 + i] = turned[i]
        g[6 + i] = s[i]
        g[9 + i] = m[i]
    return l, rate


@helper
def rate_variance(x: Array, u: Array, c: Array, g: Array, rate: float) -> float:
    """Return the variance of a measured leg rate: its noise, its skew beside the length, its scale.

    With the row g of the rate, its gradient in pose and twist, the leg accelerates by g . [twist; dtwist].
    """
    dv, dw = acceleration(x, u, c)
    ddq = dot(at(g, 0), at(x, k.TWIST)) + dot(at(g, 3), at(x, k.TWIST + 3)) + dot(at(g, 6), dv)
    ddq += dot(at(g, 9), dw)
    return float(c[k.R_RATE] + c[k.RATE_SKEW] * ddq * ddq + c[k.RATE_SCALE] * rate * rate)


@helper
def bend(
    b: Vector, x: Array, P: Array, c: Array, h: Array, l: float, N: Array, W: Array
) -> tuple[float, float]:
    """Return mean and variance of what a length differs from its tangent h, over the pose's covariance.

    With N the second derivative of the length by dp and dtheta: tr(N P) / 2 and tr(N P N P) / 2 (Bar-Shalom,
    Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 10.3). With d_i how the
    joint moves, e_i or e_i x r: N_ij = (d_i . d_j - h_i h_j) / l, and of the rotation s_i r_j, made
    symmetric, less s . r on the diagonal. N, W are scratch. 0 where it is nothing beside a length's noise.
    """
    s = at(h, 0)
    r = rotate(rotation_of(x), b)
    reach = P[0, 0] + P[1, 1] + P[2, 2] + dot(r, r) * (P[3, 3] + P[4, 4] + P[5, 5])
    if reach * reach < NOTHING * l * l * c[k.R_LENGTH]:
        return 0.0, 0.0
    for i in range(6):
        e = (1.0 if i % 3 == 0 else 0.0, 1.0 if i % 3 == 1 else 0.0, 1.0 if i % 3 == 2 else 0.0)
        W[i, 0], W[i, 1], W[i, 2] = e if i < 3 else cross(e, r)
    for i in range(6):
        for j in range(6):
            N[i, j] = (dot(row(W, i), row(W, j)) - h[i] * h[j]) / l
            if i > 2 and j > 2:
                N[i, j] += 0.5 * (s[i - 3] * r[j - 3] + s[j - 3] * r[i - 3])
                if i == j:
                    N[i, j] -= dot(s, r)
    for i in range(6):
        for j in range(6):
            W[i, j] = 0.0
            for m in range(6):
                W[i, j] += N[i, m] * P[m, j]
    mean, variance = 0.0, 0.0
    for i in range(6):
        mean += 0.5 * W[i, i]
        for j in range(6):
            variance += 0.5 * W[i, j] * W[j, i]
    return mean, variance


@helper
def beyond(
    a: Array,
    b: Array,
    x: Array,
    P: Array,
    u: Array,
    c: Array,
    h: Array,
    g: Array,
    bent: Array,
    N: Array,
    W: Array,
) -> tuple[int, int]:
    """Return how many legs contradict the prediction, and the last of them; fill INNOVATION of u and bent.

    bent (2, >= 6): mean and variance of `bend`. N, W are scratch.
    """
    count = 0
    last = 0
    for i in range(6):
        l, rate = leg_rows(row(a, i), row(b, i), x, h, g)
        u[k.INNOVATION + i] = u[k.LENGTH + i] - l
        mean, variance = bend(row(b, i), x, P, c, h, l, N, W)
        bent[0, i] = mean
        bent[1, i] = variance
        if u[k.USED + i] == 0.0:
            continue
        spread = variance_of(P, h) + c[k.R_LENGTH] + variance + rate * rate * c[k.LATCH]
        far = (u[k.INNOVATION + i] - mean) ** 2 > c[k.GATE] * spread
        fast = (u[k.RATE + i] - rate) ** 2 > c[k.GATE] * (variance_of(P, g) + rate_variance(x, u, c, g, rate))
        if far or fast:
            count += 1
            last = i
    return count, last


@helper
def update_tracker(x: Array, P: Array, u: Array, c: Array, dx: Array, h: Array, K: Array, Ph: Array) -> None:
    """Use the tracker's pose at the state's instant, unless a number of it lies beyond the gate."""
    R = rotation_of(x)
    Z = u[k.TRACKER_R : k.TRACKER_R + 9].reshape(3, 3)
    turned = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turned[i, j] = Z[i, 0] * R[j, 0] + Z[i, 1] * R[j, 1] + Z[i, 2] * R[j, 2]
    angle = rotation_vector_kernel(turned)
    for i in range(3):
        u[k.TRACKER_INNOVATION + i] = u[k.TRACKER_P + i] - x[i]
        u[k.TRACKER_INNOVATION + 3 + i] = angle[i]
    if u[k.TRACKER] == k.UNDECIDED:
        u[k.TRACKER] = 1.0
        for i in range(6):
            r = c[k.R_POSITION] if i < 3 else c[k.R_ROTATION]
            if u[k.TRACKER_INNOVATION + i] ** 2 > c[k.GATE] * (P[i, i] + r):
                u[k.TRACKER] = -1.0
    if u[k.TRACKER] < 0.0:
        return
    for i in range(6):
        h[:] = 0.0
        h[i] = 1.0
        take(P, h, c[k.R_POSITION] if i < 3 else c[k.R_ROTATION], u[k.TRACKER_INNOVATION + i], dx, K, Ph)
    correct(x, c, dx)


@helper
def update_gyro(x: Array, P: Array, u: Array, c: Array, dx: Array, h: Array, K: Array, Ph: Array) -> None:
    """Use the angular rate R^T omega + bias, carried to the interval's end by the model's acceleration.

    R^T changes by -R^T [dtheta]x: d(R^T omega) = R^T (domega + omega x dtheta).
    """
    R = rotation_of(x)
    w = at(x, k.TWIST + 3)
    left = (1.0 - u[k.IMU_AT]) * u[k.T]
    _, turn = acceleration(x, u, c)
    expected = rotate_back(R, sub(w, scale(left, turn)))
    for i in range(3):
        column = (R[0, i], R[1, i], R[2, i])
        turned = cross(column, w)  # column . (omega x dtheta) = dtheta . (column x omega)
        h[:] = 0.0
        bias = 0.0
        for j in range(3):
            h[3 + j] = turned[j]
            h[9 + j] = column[j]
        if c[k.BIASED] != 0.0:
            h[12 + i] = 1.0
            bias = x[k.GYRO_BIAS + i]
        take(P, h, c[k.R_GYRO], u[k.GYRO + i] - expected[i] - bias, dx, K, Ph)


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
