"""One interval of the error-state Kalman filter of `hil.fusion`: predict, decide, update.

Rule of the room: as in hil.kernels. All measurements are processed one number at a time, so nothing is
inverted; every update of P is Joseph's (Bucy and Joseph, 1968), which keeps P symmetric and positive whatever
the gain.

State x (24,): p 0..2, R 3..11 row-major, twist 12..17, biases of gyro 18..20 and accelerometer 21..23. Error
(n,), n = 12 or 18: dp, dtheta, dv, domega, biases; p = p + dp, R = exp(dtheta) R: all in the base frame
(the global perturbation of Sola, Deray and Atchuthan, A micro Lie theory, 2018), biases in the platform
frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.compile_cache import INTEGER, MATRIX, OUT_MATRIX, OUT_VECTOR, REAL, VECTOR, helper, kernel
from hil.kernels.dynamics import forward_dynamics_kernel
from hil.kernels.kinematics import leg, lengths_and_jacobian
from hil.linalg import condition_from_lu, lu_factor
from hil.rotations import orthonormalise, rotation_vector_kernel
from hil.vectors import Vector, add, at, cross, dot, rotate, rotate_back, row, scale, sub

Array = NDArray[np.float64]

OUT_CUBE = OUT_MATRIX.copy(ndim=3)

STATE = 24
TWIST, GYRO_BIAS, FORCE_BIAS = 12, 18, 21

# One interval, from the tick before to this one: what was measured, and what was decided about it.
T = 0
"""s."""
DTWIST = 1
"""6: acceleration of the model, mean over the interval."""
LENGTH, RATE = 7, 13
"""6 each: leg lengths m and rates m/s at its end."""
USED = 19
"""6: 0 the leg is not used, 1 unless it alone contradicts the prediction, KEPT whatever it says."""
KEPT = 2.0
FADE = 25
"""Factor on the process noise that the decision found necessary."""
DECIDED = 26
"""1 once legs and noise are decided."""
UNDECIDED = 2.0
"""TRACKER of a sample that no run has seen yet."""
TRACKER, TRACKER_AT, TRACKER_P, TRACKER_R = 27, 28, 29, 32
"""0 none, 1 used, -1 refused; instant as a share of the interval; (3,) m; (3, 3)."""
IMU, IMU_AT, GYRO, FORCE = 41, 42, 43, 46
"""0 or 1; instant as a share of the interval; (3,) rad/s; (3,) m/s^2, both in the platform frame."""
INNOVATION = 49
"""6: measured less predicted length, m."""
TRACKER_INNOVATION = 55
"""6: measured less predicted pose, m and rad."""
GRADIENT = 61
"""(6, 6): how the model's acceleration changes with dp, dtheta."""
INTERVAL = 97

# Noise: variances of one sample, densities of what is white in time.
(
    Q_V, Q_W, R_LENGTH, R_RATE, R_POSITION, R_ROTATION, GATE, R_GYRO, R_FORCE, Q_GYRO_BIAS, Q_FORCE_BIAS,
    LATCH, GRAVITY,
) = range(13)  # fmt: skip
"""GATE is the square of the allowed number of standard deviations; LATCH the variance of the
instant of latching, s^2; GRAVITY the first of three, m/s^2."""
NOISE = 16

DIFFERENCE = 1e-6
"""m or rad: step of the gradient."""
FADES = 6
"""Process noise is raised by 100 up to so often, before the measurements are taken as they are."""


@helper
def exp_step(R: Array, w: Vector) -> None:
    """Replace R by exp([w]x) R, |w| <= 0.5: series to the last bit for the rotations of one interval."""
    x = dot(w, w)
    A = 1.0 + x * (-1.0 / 6.0 + x * (1.0 / 120.0 + x * (-1.0 / 5040.0 + x / 362880.0)))
    B = 0.5 + x * (-1.0 / 24.0 + x * (1.0 / 720.0 + x * (-1.0 / 40320.0 + x / 3628800.0)))
    for j in range(3):
        y = (R[0, j], R[1, j], R[2, j])
        t = cross(w, y)
        z = add(y, add(scale(A, t), scale(B, cross(w, t))))
        R[0, j] = z[0]
        R[1, j] = z[1]
        R[2, j] = z[2]


@helper
def rotation_of(x: Array) -> Array:
    """Return the view R (3, 3) of a state."""
    return x[3:12].reshape(3, 3)


@helper
def predict(x: Array, P: Array, u: Array, c: Array, dt: float, fade: float, F: Array, W: Array) -> None:
    """Carry x and P on by dt (s) in place, with the acceleration of the interval u. F, W (n, n) are scratch.

    Where the interval has a specific force f, the acceleration is the mean of the model's and R (f - bias) +
    g, weighted by the inverse of their variances: two measurements of one acceleration.
    """
    n = P.shape[0]
    R = rotation_of(x)
    a = at(u, DTWIST)
    turn = at(u, DTWIST + 3)
    w = at(x, TWIST + 3)
    q_v = c[Q_V]
    F[:, :] = 0.0
    for i in range(n):
        F[i, i] = 1.0
    share = 0.0
    if u[IMU] != 0.0 and u[T] > 0.0:
        share = q_v / u[T]
        share = share / (share + c[R_FORCE])
        f = at(u, FORCE)
        if n > 12:
            f = sub(f, at(x, FORCE_BIAS))
        f = rotate(R, f)
        a = add(a, scale(share, sub(add(f, at(c, GRAVITY)), a)))
        q_v *= 1.0 - share
        k = share * dt  # dv changes by dtheta x f share dt
        F[6, 4], F[6, 5], F[7, 3] = k * f[2], -k * f[1], -k * f[2]
        F[7, 5], F[8, 3], F[8, 4] = k * f[0], k * f[1], -k * f[0]
        if n > 12:
            for i in range(3):
                for j in range(3):
                    F[6 + i, 15 + j] = -k * R[i, j]
    for i in range(6):
        kept = dt * (1.0 - share) if i < 3 else dt
        for j in range(6):
            F[6 + i, j] += kept * u[GRADIENT + 6 * i + j]
    for i in range(3):
        for j in range(n):
            if j != 6 + i:
                F[i, j] += 0.5 * dt * F[6 + i, j]
    phi = add(scale(dt, w), scale(0.5 * dt * dt, turn))
    y = dot(phi, phi)
    A = 1.0 - y / 6.0 + y * y / 120.0
    B = 0.5 - y / 24.0 + y * y / 720.0
    C = 1.0 / 6.0 - y / 120.0
    for j in range(3):
        e = (1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0)
        once = cross(phi, e)
        twice = cross(phi, once)
        for i in range(3):
            F[3 + i, 3 + j] = e[i] + A * once[i] + B * twice[i] + 0.5 * dt * F[9 + i, 3 + j]  # exp(phi)
            F[3 + i, j] = 0.5 * dt * F[9 + i, j]
            F[3 + i, 9 + j] = dt * (e[i] + B * once[i] + C * twice[i])  # its left Jacobian
        F[j, 6 + j] = dt
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += F[i, k] * P[k, j]
            W[i, j] = total
    for i in range(n):
        for j in range(i, n):
            total = 0.0
            for k in range(n):
                total += W[i, k] * F[j, k]
            P[i, j] = total
    add_process_noise(P, q_v * fade, c[Q_W] * fade, c[Q_GYRO_BIAS], c[Q_FORCE_BIAS], dt)
    for i in range(3):
        x[i] += dt * (x[TWIST + i] + 0.5 * dt * a[i])
        x[TWIST + i] += dt * a[i]
        x[TWIST + 3 + i] += dt * turn[i]
    exp_step(R, phi)


@helper
def add_process_noise(P: Array, q_v: float, q_w: float, q_gyro: float, q_force: float, dt: float) -> None:
    """Add the noise of white accelerations and bias drifts over dt to P, and mirror its upper half."""
    n = P.shape[0]
    for i in range(3):
        for at_pose, at_rate, q in ((i, 6 + i, q_v), (3 + i, 9 + i, q_w)):
            P[at_pose, at_pose] += q * dt * dt * dt / 3.0
            P[at_pose, at_rate] += q * dt * dt / 2.0
            P[at_rate, at_rate] += q * dt
        if n > 12:
            P[12 + i, 12 + i] += q_gyro * dt
            P[15 + i, 15 + i] += q_force * dt
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i]


@helper
def variance_of(P: Array, h: Array) -> float:
    """Return h P h^T."""
    n = P.shape[0]
    total = 0.0
    for i in range(n):
        if h[i] != 0.0:
            for j in range(n):
                total += h[i] * P[i, j] * h[j]
    return total


@kernel(VECTOR, INTEGER, VECTOR, VECTOR, VECTOR, OUT_VECTOR)
def accelerate_kernel(constants: Array, code: int, x: Array, tau: Array, wrench: Array, u: Array) -> None:
    """Fill DTWIST and GRADIENT of u: the model's acceleration for forces tau (6,) N, its pose gradient.

    A platform on legs that are given forces is an inverted pendulum: an error in a direction that no leg sees
    grows by itself, about as fast as a tracker of 1 mm and 200 Hz corrects it. Forward differences.
    """
    p = x[0:3].copy()
    R = x[3:12].copy().reshape(3, 3)
    twist = x[12:18].copy()
    there = forward_dynamics_kernel(constants, code, p, R, twist, tau, wrench)
    for i in range(6):
        u[DTWIST + i] = there[i]
    for j in range(6):
        pj = p.copy()
        Rj = R.copy()
        if j < 3:
            pj[j] += DIFFERENCE
        else:
            turn = (
                DIFFERENCE if j == 3 else 0.0, DIFFERENCE if j == 4 else 0.0, DIFFERENCE if j == 5 else 0.0
            )  # fmt: skip
            exp_step(Rj, turn)
        moved = forward_dynamics_kernel(constants, code, pj, Rj, twist, tau, wrench)
        for i in range(6):
            u[GRADIENT + 6 * i + j] = (moved[i] - there[i]) / DIFFERENCE


@helper
def take(P: Array, h: Array, r: float, innovation: float, dx: Array, K: Array, Ph: Array) -> None:
    """Use one number: z = h . error + noise of variance r; adds to the correction dx, and updates P.

    innovation is that of the state before any correction. P = (I - K h) P (I - K h)^T + K r K^T.
    """
    n = P.shape[0]
    s = r
    predicted = 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * h[j]
        Ph[i] = total
    for i in range(n):
        s += h[i] * Ph[i]
        predicted += h[i] * dx[i]
    for i in range(n):
        K[i] = Ph[i] / s
        dx[i] += K[i] * (innovation - predicted)
    for i in range(n):
        for j in range(n):
            P[i, j] -= K[i] * Ph[j]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * h[j]
        Ph[i] = total
    for i in range(n):
        for j in range(i, n):
            P[i, j] += (r * K[i] - Ph[i]) * K[j]
            P[j, i] = P[i, j]


@helper
def correct(x: Array, dx: Array) -> None:
    """Apply the correction dx (n,) to x, and clear it."""
    for i in range(3):
        x[i] += dx[i]
        x[TWIST + i] += dx[6 + i]
        x[TWIST + 3 + i] += dx[9 + i]
        if dx.shape[0] > 12:
            x[GYRO_BIAS + i] += dx[12 + i]
            x[FORCE_BIAS + i] += dx[15 + i]
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
    v = at(x, TWIST)
    w = at(x, TWIST + 3)
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
def beyond(a: Array, b: Array, x: Array, P: Array, u: Array, c: Array, h: Array, g: Array) -> tuple[int, int]:
    """Return how many legs contradict the prediction, and the last of them; fill INNOVATION of u."""
    count = 0
    last = 0
    for i in range(6):
        l, rate = leg_rows(row(a, i), row(b, i), x, h, g)
        u[INNOVATION + i] = u[LENGTH + i] - l
        if u[USED + i] == 0.0:
            continue
        far = u[INNOVATION + i] ** 2 > c[GATE] * (variance_of(P, h) + c[R_LENGTH] + rate * rate * c[LATCH])
        fast = (u[RATE + i] - rate) ** 2 > c[GATE] * (variance_of(P, g) + c[R_RATE])
        if far or fast:
            count += 1
            last = i
    return count, last


@helper
def update_tracker(x: Array, P: Array, u: Array, c: Array, dx: Array, h: Array, K: Array, Ph: Array) -> None:
    """Use the tracker's pose at the state's instant, unless a number of it lies beyond the gate."""
    R = rotation_of(x)
    Z = u[TRACKER_R : TRACKER_R + 9].reshape(3, 3)
    turned = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turned[i, j] = Z[i, 0] * R[j, 0] + Z[i, 1] * R[j, 1] + Z[i, 2] * R[j, 2]
    angle = rotation_vector_kernel(turned)
    for i in range(3):
        u[TRACKER_INNOVATION + i] = u[TRACKER_P + i] - x[i]
        u[TRACKER_INNOVATION + 3 + i] = angle[i]
    if u[TRACKER] == UNDECIDED:
        u[TRACKER] = 1.0
        for i in range(6):
            r = c[R_POSITION] if i < 3 else c[R_ROTATION]
            if u[TRACKER_INNOVATION + i] ** 2 > c[GATE] * (P[i, i] + r):
                u[TRACKER] = -1.0
    if u[TRACKER] < 0.0:
        return
    for i in range(6):
        h[:] = 0.0
        h[i] = 1.0
        take(P, h, c[R_POSITION] if i < 3 else c[R_ROTATION], u[TRACKER_INNOVATION + i], dx, K, Ph)
    correct(x, dx)


@helper
def update_gyro(x: Array, P: Array, u: Array, c: Array, dx: Array, h: Array, K: Array, Ph: Array) -> None:
    """Use the angular rate R^T omega + bias, carried to the interval's end by the model's acceleration.

    R^T changes by -R^T [dtheta]x: d(R^T omega) = R^T (domega + omega x dtheta).
    """
    R = rotation_of(x)
    w = at(x, TWIST + 3)
    left = (1.0 - u[IMU_AT]) * u[T]
    expected = rotate_back(R, sub(w, scale(left, at(u, DTWIST + 3))))
    for i in range(3):
        column = (R[0, i], R[1, i], R[2, i])
        turned = cross(column, w)  # column . (omega x dtheta) = dtheta . (column x omega)
        h[:] = 0.0
        bias = 0.0
        for j in range(3):
            h[3 + j] = turned[j]
            h[9 + j] = column[j]
        if P.shape[0] > 12:
            h[12 + i] = 1.0
            bias = x[GYRO_BIAS + i]
        take(P, h, c[R_GYRO], u[GYRO + i] - expected[i] - bias, dx, K, Ph)


@helper
def interval(
    a: Array, b: Array, c: Array, u: Array, x0: Array, P0: Array, x: Array, P: Array, work: Array
) -> None:
    """Fill x and P at the end of the interval u from x0 and P0 at its beginning.

    The first run decides which legs are used, how much process noise there was, and whether the tracker is
    believed; later ones, for a sample that came late, keep to it.
    """
    n = P.shape[0]
    F = work[0:n, 0:n]
    W = work[n : 2 * n, 0:n]
    dx, h, g, K, Ph = (
        work[2 * n, 0:n], work[2 * n + 1, 0:n], work[2 * n + 2, 0:n], work[2 * n + 3, 0:n], work[2 * n + 4,
        0:n]
    )  # fmt: skip
    dx[:] = 0.0
    new = u[TRACKER] == UNDECIDED
    for fades in range(FADES + 1):
        if new:
            u[TRACKER] = UNDECIDED
        x[:] = x0
        P[:, :] = P0
        done = 0.0
        if u[TRACKER] != 0.0:
            done = u[TRACKER_AT] * u[T]
            predict(x, P, u, c, done, u[FADE], F, W)
            update_tracker(x, P, u, c, dx, h, K, Ph)
        predict(x, P, u, c, u[T] - done, u[FADE], F, W)
        count, last = beyond(a, b, x, P, u, c, h, g)
        if u[DECIDED] != 0.0 or count == 0 or fades == FADES:
            break
        if count == 1 and u[USED + last] < KEPT:
            u[USED + last] = 0.0
            break
        u[FADE] *= 100.0
    u[DECIDED] = 1.0
    for i in range(6):
        if u[USED + i] != 0.0:
            l, rate = leg_rows(row(a, i), row(b, i), x, h, g)
            take(P, h, c[R_LENGTH] + rate * rate * c[LATCH], u[LENGTH + i] - l, dx, K, Ph)
            take(P, g, c[R_RATE], u[RATE + i] - rate, dx, K, Ph)
    if u[IMU] != 0.0:
        update_gyro(x, P, u, c, dx, h, K, Ph)
    correct(x, dx)


@kernel(MATRIX, MATRIX, VECTOR, OUT_MATRIX, OUT_MATRIX, OUT_CUBE, INTEGER, INTEGER)
def rerun_kernel(
    a: Array, b: Array, c: Array, intervals: Array, states: Array, covariances: Array, first: int, count: int
) -> None:
    """Run ``count`` intervals of the rings from ``first`` on, each from the state before it.

    a, b (6, 3) joints; c (NOISE,); rings: intervals (N, INTERVAL), states (N, STATE), covariances (N, n, n).
    """
    size = intervals.shape[0]
    n = covariances.shape[1]
    work = np.empty((2 * n + 5, n))
    for i in range(count):
        k = (first + i) % size
        before = (k + size - 1) % size
        interval(a, b, c, intervals[k], states[before], covariances[before], states[k], covariances[k], work)


@kernel(MATRIX, MATRIX, REAL, VECTOR, VECTOR, OUT_VECTOR, OUT_VECTOR, OUT_MATRIX)
def observed_kernel(
    a: Array, b: Array, radius: float, x: Array, u: Array, q: Array, dq: Array, J: Array
) -> tuple[float, float]:
    """Fill lengths q, rates dq and J of a state x; return the residual of the used legs and J's condition.

    residual: largest |measured - q| in m, nan where x is not finite; condition as in hil.linalg with radius.
    """
    p = x[0:3]
    R = x[3:12].reshape(3, 3)
    lengths_and_jacobian(a, b, p, R, q, J)
    residual = 0.0
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += J[i, j] * x[TWIST + j]
        dq[i] = total
        error = abs(u[LENGTH + i] - q[i])
        if u[USED + i] != 0.0 and not error <= residual:
            residual = error
    work = np.empty((25, 6))
    LU = work[0:6]
    order = np.empty(6, np.int64)
    condition = np.inf
    if lu_factor(J, LU, order):
        condition = condition_from_lu(J, radius, LU, order, work[6:25])
    return residual, condition
