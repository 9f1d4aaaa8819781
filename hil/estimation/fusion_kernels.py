"""One interval of the error-state Kalman filter of `hil.estimation.fusion`: predict, decide, update.

All measurements are processed one number at a time, so no matrix is inverted. Every update of P has Joseph's
form (Bucy and Joseph, 1968), which keeps P symmetric and positive for any gain.

State x (37,): p 0..2, R 3..11 row-major, twist 12..17, biases of gyro 18..20 and accelerometer 21..23, leg
forces that the model does not know 24..29, the time by which the tracker stamps its samples too late 30, its
offset 31..36. Error (n,), n = 12 to 31: dp, dtheta, dv, domega, biases if the IMU has some, leg forces if
there are some, the tracker's errors if there is one; p = p + dp, R = exp(dtheta) R. All are in the base
frame (the global perturbation of Sola, Deray and Atchuthan, A micro Lie theory, 2018), biases in the platform
frame.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, kernel, record
from drivers.compiled.pointed import reals_at, records_at
from drivers.rotations import rotation_vector_kernel
from hil.estimation.fusion_layout import FUSION, GYRO_BIAS, KEPT, LEG_FORCE, STAMP, STEP, TWIST, UNDECIDED
from hil.estimation.fusion_predict import acceleration, exp_step, predict, rotation_of
from hil.mathematics.linear_algebra import condition_kernel
from hil.mathematics.rotations import orthonormalise
from hil.mathematics.vectors import Vector, add, at, cross, dot, rotate, rotate_back, row, scale, sub
from hil.robot.kinematics_kernels import leg, lengths_and_jacobian

NOTHING = 1e-8
"""A bend is left out if its square is below this share of the variance of a length."""
WATCHED, STRAYS = 100, 6.0
"""Samples of the exponential mean of tracker innovations, and its limit in standard deviations."""
BENT = 2.0
"""Factor on the variance of a bend, which lasts as long as the error of the pose and is no white noise."""
FADES = 6
"""Largest number of times that the process noise is raised by 100; then the measurements are accepted."""
steps_at = records_at(record(STEP))


@helper
def covariances_of(f: Any) -> Array:
    """View of the filter's ring of covariances, (size, n, n)."""
    n = f.errors
    return reals_at(f.covariances, f.size * n * n).reshape((f.size, n, n))


@helper
def take(P: Array, h: Array, r: float, innovation: float, dx: Array) -> None:
    """Update the filter with one number: z = h . error + noise of variance r; adds to dx (n,), changes P.

    innovation is relative to the state before any correction. P = (I - K h) P (I - K h)^T + K r K^T.
    """
    n = P.shape[0]
    K, Ph = np.empty(n), np.empty(n)
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
def correct(f: Any, x: Array, dx: Array) -> None:
    """Add the correction dx (n,) to the state x (30,), and set dx to zero."""
    for i in range(3):
        x[i] += dx[i]
    for i in range(6, f.forces):
        x[TWIST - 6 + i] += dx[i]
    for i in range(f.forces, f.offsets):
        x[LEG_FORCE - f.forces + i] += dx[i]
    for i in range(f.offsets, f.errors):
        x[STAMP - f.offsets + i] += dx[i]
    R = rotation_of(x)
    exp_step(R, at(dx, 3))
    orthonormalise(R)
    dx[:] = 0.0


@helper
def leg_rows(f: Any, i: int, x: Array, h: Array, g: Array) -> tuple[float, float]:
    """Length, m, and rate, m/s, of leg i in state x; fills their measurement rows h and g (n,).

    With r = R b, u = v + omega x r: dl = s . (dp + dtheta x r). The rate s . u changes with the pose by ds .
    (dp + dtheta x r) + s . (omega x (dtheta x r)), ds = (u - s s.u) / l, and with the twist like dl.
    """
    r = rotate(rotation_of(x), row(f.platform_joints, i))
    l, s = leg(row(f.base_joints, i), r, at(x, 0))
    v = at(x, TWIST)
    w = at(x, TWIST + 3)
    u = add(v, cross(w, r))
    rate = dot(s, u)
    ds = scale(1.0 / l, sub(u, scale(rate, s)))
    m = cross(r, s)
    turned = add(cross(r, ds), cross(r, cross(s, w)))
    h[:] = 0.0
    g[:] = 0.0
    for k in range(3):
        h[k] = g[6 + k] = s[k]
        h[3 + k] = g[9 + k] = m[k]
        g[k] = ds[k]
        g[3 + k] = turned[k]
    return l, rate


@helper
def variance_of(P: Array, h: Array) -> float:
    """Variance h P h^T of a predicted measurement with row h (n,)."""
    n = P.shape[0]
    total = 0.0
    for i in range(n):
        if h[i] != 0.0:
            row = 0.0
            for j in range(n):
                row += P[i, j] * h[j]
            total += h[i] * row
    return total


@helper
def rate_variance(f: Any, s: Any, g: Array, rate: float) -> float:
    """Variance, m^2/s^2, of a measured leg rate: noise, time skew to the length, error of scale.

    With the row g of the rate, its gradient in pose and twist, the leg accelerates by g . [twist; dtwist].
    """
    dv, dw = acceleration(f, s)
    ddq = dot(at(g, 0), at(s.x, TWIST)) + dot(at(g, 3), at(s.x, TWIST + 3)) + dot(at(g, 6), dv)
    ddq += dot(at(g, 9), dw)
    return float(f.r_rate + f.rate_skew * ddq * ddq + f.rate_scale * rate * rate)


@helper
def bend(f: Any, b: Vector, x: Array, P: Array, h: Array, l: float) -> tuple[float, float]:
    """Mean and variance, over P, of the difference between a length l and its tangent h.

    With N the second derivative of the length by dp and dtheta: tr(N P) / 2 and tr(N P N P) / 2 (Bar-Shalom,
    Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 10.3). With d_i the
    motion of the joint, e_i or e_i x r: N_ij = (d_i . d_j - h_i h_j) / l; for the rotation plus s_i r_j, made
    symmetric, less s . r on the diagonal. 0 where it is negligible against a length's noise.
    """
    s = at(h, 0)
    r = rotate(rotation_of(x), b)
    reach = P[0, 0] + P[1, 1] + P[2, 2] + dot(r, r) * (P[3, 3] + P[4, 4] + P[5, 5])
    if reach * reach < NOTHING * l * l * f.r_length:
        return 0.0, 0.0
    N, W = np.empty((6, 6)), np.empty((6, 6))
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
def beyond(f: Any, s: Any, P: Array, bent: Array) -> tuple[int, int]:
    """(number of legs that contradict the prediction, the last of them); fills the innovation and bent.

    A leg contradicts it if length or rate is off by more than the gate. bent (2, 6): mean and variance of
    `bend`.
    """
    count, last = 0, 0
    h, g = np.empty(f.errors), np.empty(f.errors)
    for i in range(6):
        l, rate = leg_rows(f, i, s.x, h, g)
        s.innovation[i] = s.length[i] - l
        mean, variance = bend(f, row(f.platform_joints, i), s.x, P, h, l)
        bent[0, i], bent[1, i] = mean, variance
        if s.used[i] == 0:
            continue
        spread = variance_of(P, h) + f.r_length + variance + rate * rate * f.latch
        far = (s.innovation[i] - mean) ** 2 > f.gate * spread
        fast = (s.rate[i] - rate) ** 2 > f.gate * (variance_of(P, g) + rate_variance(f, s, g, rate))
        if far or fast:
            count += 1
            last = i
    return count, last


@helper
def watch_tracker(f: Any, s: Any) -> None:
    """Update the mean of the tracker's innovations, and whether white noise can explain it.

    Six legs are the reference: what no constant error of tracker and stamps explains is a drift or a jump.
    With a leg lost, the last judgement stays.
    """
    for i in range(6):
        if s.used[i] == 0:
            return
    f.strays = 0
    for i in range(6):
        f.mean[i] += (s.tracker_innovation[i] / s.tracker_std[i] - f.mean[i]) / WATCHED
        if f.mean[i] ** 2 * (2 * WATCHED - 1) > STRAYS**2:
            f.strays = 1


@helper
def update_tracker(f: Any, s: Any, P: Array, dx: Array) -> None:
    """Update with the tracker's pose at the state's time; ignored if one of six numbers is too far off.

    Stamped d late, by a tracker that is off by b: p(t - d) + b = p - d v + d^2 dv / 2 + b, R likewise.
    """
    x, Z, d = s.x, s.tracker_R, s.x[STAMP]
    a, turn = acceleration(f, s)
    R = rotation_of(x)
    turned = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turned[i, j] = Z[i, 0] * R[j, 0] + Z[i, 1] * R[j, 1] + Z[i, 2] * R[j, 2]
    angle = rotation_vector_kernel(turned)
    for i in range(3):
        s.tracker_innovation[i] = s.tracker_p[i] - x[i]
        s.tracker_innovation[3 + i] = angle[i]
    H, new = np.zeros((6, f.errors)), s.tracker == UNDECIDED
    if new:
        s.tracker = 1
    for i in range(6):
        speed, gain = x[TWIST + i], a[i] if i < 3 else turn[i - 3]
        H[i, i], H[i, 6 + i] = 1.0, -d
        H[i, f.offsets], H[i, f.offsets + 1 + i] = d * gain - speed, 1.0
        s.tracker_innovation[i] += d * (speed - 0.5 * d * gain) - x[STAMP + 1 + i]
        variance = variance_of(P, H[i]) + (f.r_position if i < 3 else f.r_rotation)
        s.tracker_std[i] = np.sqrt(variance)
        if new and s.tracker_innovation[i] ** 2 > f.gate * variance:
            s.tracker = -1
    if s.tracker < 0:
        return
    for i in range(6):
        take(P, H[i], f.r_position if i < 3 else f.r_rotation, s.tracker_innovation[i], dx)
    correct(f, x, dx)


@helper
def update_gyro(f: Any, s: Any, P: Array, dx: Array) -> None:
    """Update with the gyro: R^T omega + bias, moved to the interval's end by the model's acceleration.

    R^T changes by -R^T [dtheta]x: d(R^T omega) = R^T (domega + omega x dtheta).
    """
    R, w = rotation_of(s.x), at(s.x, TWIST + 3)
    left = (1.0 - s.imu_at) * s.T
    _, turn = acceleration(f, s)
    expected = rotate_back(R, sub(w, scale(left, turn)))
    for i in range(3):
        column = (R[0, i], R[1, i], R[2, i])
        turned = cross(column, w)  # column . (omega x dtheta) = dtheta . (column x omega)
        h = np.zeros(f.errors)
        bias = 0.0
        for j in range(3):
            h[3 + j] = turned[j]
            h[9 + j] = column[j]
        if f.forces > 12:
            h[12 + i] = 1.0
            bias = s.x[GYRO_BIAS + i]
        take(P, h, f.r_gyro, s.gyro[i] - expected[i] - bias, dx)


@helper
def interval(f: Any, before: Any, P0: Array, s: Any, P: Array) -> None:
    """Fill in a step's state and P, predicted and updated from those at the beginning of its interval.

    The first run decides which legs are used, the amount of process noise, and whether the tracker is
    trusted. Later runs, for a late sample, keep these decisions.
    """
    n = f.errors
    dx, h, g, bent = np.zeros(n), np.empty(n), np.empty(n), np.empty((2, 6))
    new = s.tracker == UNDECIDED
    for fades in range(FADES + 1):
        if new:
            s.tracker = UNDECIDED
        s.x[:] = before.x
        P[:] = P0
        done = 0.0
        if s.tracker != 0:
            done = s.tracker_at * s.T
            predict(f, s, P, done)
            update_tracker(f, s, P, dx)
        predict(f, s, P, s.T - done)
        count, last = beyond(f, s, P, bent)
        if s.decided != 0 or count == 0 or fades == FADES:
            break
        if count == 1 and s.used[last] < KEPT:
            s.used[last] = 0
            break
        s.fade *= 100.0
    s.decided = 1
    if new and s.tracker > 0:
        watch_tracker(f, s)
    for i in range(6):
        if s.used[i] != 0:
            l, rate = leg_rows(f, i, s.x, h, g)
            r = f.r_length + BENT * bent[1, i] + rate * rate * f.latch
            take(P, h, r, s.length[i] - l - bent[0, i], dx)
            take(P, g, rate_variance(f, s, g, rate), s.rate[i] - rate, dx)
    if s.imu != 0:
        update_gyro(f, s, P, dx)
    correct(f, s.x, dx)


@kernel(record(FUSION), INTEGER)
def rerun_kernel(f: Any, first: int) -> None:
    """Repeat the intervals of the ring from index ``first`` to the newest, as a sample came late."""
    steps, covariances = steps_at(f.steps, f.size), covariances_of(f)
    for i in range((f.newest - first) % f.size + 1):
        now = (first + i) % f.size
        before = (now + f.size - 1) % f.size
        interval(f, steps[before], covariances[before], steps[now], covariances[now])


@helper
def fill_estimate(f: Any, s: Any, P: Array, tick: Any) -> None:
    """Fill in a tick's q, dq, p, R, twist, J, fk_residual, condition, innovation_q and pose_std.

    s, P (n, n): the newest step and its covariance. Units, shapes and frames of the columns:
    `drivers.tick_columns`. fk_residual is the largest |measured - q| of the used legs, nan if the state is
    not finite; pose_std the root of P's first six variances; condition as in `condition_kernel`.
    """
    x, q, J = s.x, tick.q, tick.J
    tick.p[:] = x[0:3]
    R = rotation_of(x)
    tick.R[:] = R
    tick.twist[:] = x[TWIST : TWIST + 6]
    lengths_and_jacobian(f.base_joints, f.platform_joints, x[0:3], R, q, J)
    residual = 0.0
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += J[i, j] * x[TWIST + j]
        tick.dq[i] = total
        error = abs(s.length[i] - q[i])
        if s.used[i] != 0 and not error <= residual:
            residual = error
        tick.innovation_q[i] = s.innovation[i]
        tick.pose_std[i] = np.sqrt(np.maximum(P[i, i], 0.0))
    tick.fk_residual, tick.condition = residual, condition_kernel(J, f.radius)
