"""The filter's prediction: state and covariance over a part of an interval."""

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, OUT_VECTOR, VECTOR, helper, kernel
from hil.estimation import fusion_layout as k
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.vectors import Vector, add, at, cross, dot, rotate, scale, sub
from hil.robot.dynamics_kernels import fill_jacobian, forward_dynamics_kernel, model_inertia


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
def forces_at(n: int, c: Array) -> int:
    """Return where the error of n numbers has its six leg forces; 0 where it has none."""
    return n - 6 if c[k.LEG_FORCE_VARIANCE] > 0.0 else 0


@helper
def acceleration(x: Array, u: Array, c: Array) -> tuple[Vector, Vector]:
    """Return dv and domega of an interval: the model's, and that of the leg forces it does not know."""
    a, turn = at(u, k.DTWIST), at(u, k.DTWIST + 3)
    if c[k.LEG_FORCE_VARIANCE] > 0.0:
        for leg in range(6):
            at_leg = k.INFLUENCE + leg
            f = x[k.LEG_FORCE + leg]
            a = add(a, scale(f, (u[at_leg], u[at_leg + 6], u[at_leg + 12])))
            turn = add(turn, scale(f, (u[at_leg + 18], u[at_leg + 24], u[at_leg + 30])))
    return a, turn


@helper
def add_force_noise(P: Array, forces: int, q: float) -> None:
    """Add the variance q (N^2) to that of each of the leg forces."""
    for i in range(forces, forces + 6):
        P[i, i] += q


@helper
def carry(P: Array, F: Array, W: Array) -> None:
    """Replace the upper half of P by that of F P F^T, row by row and past the zeros of F. W is scratch."""
    n = P.shape[0]
    multiply(F, P, W)
    for i in range(n):
        for j in range(n):
            P[j, i] = W[i, j]
    multiply(F, P, W)
    for i in range(n):
        for j in range(i, n):
            P[i, j] = W[j, i]


@helper
def multiply(A: Array, B: Array, C: Array) -> None:
    """Fill C = A B, all (n, n)."""
    n = A.shape[0]
    for i in range(n):
        for j in range(n):
            C[i, j] = 0.0
        for m in range(n):
            factor = A[i, m]
            if factor != 0.0:
                for j in range(n):
                    C[i, j] += factor * B[m, j]


@helper
def weigh(x: Array, u: Array, c: Array, a: Vector, dt: float, F: Array) -> tuple[Vector, float]:
    """Return the linear acceleration of the interval u and the IMU's share in it, a being the model's.

    The mean of a and R (f - bias) + g, weighted by the inverse of their variances: two measurements of one
    acceleration. Fills what it changes of F: dv changes by dtheta x f share dt.
    """
    if u[k.IMU] == 0.0 or u[k.T] <= 0.0:
        return a, 0.0
    R = rotation_of(x)
    share = c[k.Q_V] / u[k.T]
    share = share / (share + c[k.R_FORCE])
    f = at(u, k.FORCE)
    if c[k.BIASED] != 0.0:
        f = sub(f, at(x, k.FORCE_BIAS))
    f = rotate(R, f)
    gain = share * dt
    F[6, 4], F[6, 5], F[7, 3] = gain * f[2], -gain * f[1], -gain * f[2]
    F[7, 5], F[8, 3], F[8, 4] = gain * f[0], gain * f[1], -gain * f[0]
    if c[k.BIASED] != 0.0:
        for i in range(3):
            for j in range(3):
                F[6 + i, 15 + j] = -gain * R[i, j]
    return add(a, scale(share, sub(add(f, at(c, k.GRAVITY)), a))), share


@helper
def fill_transition(
    u: Array, dt: float, share: float, phi: Vector, forces: int, stays: float, F: Array
) -> None:
    """Fill what is left of F: gradients of the model's acceleration, rotation by phi, decay of leg forces."""
    n = F.shape[0]
    for i in range(6):
        kept = dt * (1.0 - share) if i < 3 else dt
        for j in range(6):
            F[6 + i, j] += kept * u[k.GRADIENT + 6 * i + j]
            if forces:
                F[6 + i, forces + j] = kept * u[k.INFLUENCE + 6 * i + j]
    for i in range(3):
        for j in range(n):
            if j != 6 + i:
                F[i, j] += 0.5 * dt * F[6 + i, j]
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
    for j in range(6 if forces else 0):
        F[forces + j, forces + j] = stays
        for i in range(3):
            F[3 + i, forces + j] = 0.5 * dt * F[9 + i, forces + j]


@helper
def predict(x: Array, P: Array, u: Array, c: Array, dt: float, fade: float, F: Array, W: Array) -> None:
    """Carry x and P on by dt (s) in place, with the acceleration of the interval u. F, W (n, n) are scratch.

    The noise of the leg forces comes in two halves, before and after.
    """
    n = P.shape[0]
    w = at(x, k.TWIST + 3)
    forces = forces_at(n, c)
    stays, q_leg = 1.0, 0.0
    if forces:
        stays = np.exp(-dt / c[k.LEG_FORCE_TIME])
        q_leg = fade * c[k.LEG_FORCE_VARIANCE] * (1.0 - stays * stays)
        add_force_noise(P, forces, 0.5 * q_leg)
    F[:, :] = 0.0
    for i in range(n):
        F[i, i] = 1.0
    a, turn = acceleration(x, u, c)
    a, share = weigh(x, u, c, a, dt, F)
    phi = add(scale(dt, w), scale(0.5 * dt * dt, turn))
    fill_transition(u, dt, share, phi, forces, stays, F)
    carry(P, F, W)
    if forces:
        add_force_noise(P, forces, 0.5 * q_leg)
    add_process_noise(P, c, c[k.Q_V] * (1.0 - share) * fade, c[k.Q_W] * fade, dt)
    for i in range(6):
        x[k.LEG_FORCE + i] *= stays
    for i in range(3):
        x[i] += dt * (x[k.TWIST + i] + 0.5 * dt * a[i])
        x[k.TWIST + i] += dt * a[i]
        x[k.TWIST + 3 + i] += dt * turn[i]
    exp_step(rotation_of(x), phi)


@helper
def add_process_noise(P: Array, c: Array, q_v: float, q_w: float, dt: float) -> None:
    """Add the noise of white accelerations and bias drifts over dt to P, and mirror its upper half."""
    n = P.shape[0]
    for i in range(3):
        for at_pose, at_rate, q in ((i, 6 + i, q_v), (3 + i, 9 + i, q_w)):
            P[at_pose, at_pose] += q * dt * dt * dt / 3.0
            P[at_pose, at_rate] += q * dt * dt / 2.0
            P[at_rate, at_rate] += q * dt
        if c[k.BIASED] != 0.0:
            P[12 + i, 12 + i] += c[k.Q_GYRO_BIAS] * dt
            P[15 + i, 15 + i] += c[k.Q_FORCE_BIAS] * dt
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
            row = 0.0
            for j in range(n):
                row += P[i, j] * h[j]
            total += h[i] * row
    return total


@helper
def fill_influence(constants: Array, code: int, p: Array, R: Array, u: Array) -> None:
    """Fill INFLUENCE of u: M^-1 J^T of the model at a pose."""
    J, M, LU, order = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6)), np.empty(6, np.int64)
    moved = np.zeros(6)
    fill_jacobian(constants, code, p, R, J)
    model_inertia(constants, code, p, R, M)
    if lu_factor(M, LU, order):
        for leg in range(6):
            lu_solve(LU, order, J[leg], moved)
            for i in range(6):
                u[k.INFLUENCE + 6 * i + leg] = moved[i]


@kernel(VECTOR, INTEGER, VECTOR, VECTOR, VECTOR, OUT_VECTOR)
def accelerate_kernel(constants: Array, code: int, x: Array, tau: Array, wrench: Array, u: Array) -> None:
    """Fill DTWIST, GRADIENT and INFLUENCE of u: its acceleration for forces tau (6,) N, gradients.

    A platform on legs that are given forces is an inverted pendulum: an error in a direction that no leg sees
    grows by itself, about as fast as a tracker of 1 mm and 200 Hz corrects it. Forward differences.
    """
    p = x[0:3].copy()
    R = x[3:12].copy().reshape(3, 3)
    twist = x[12:18].copy()
    there = forward_dynamics_kernel(constants, code, p, R, twist, tau, wrench)
    for i in range(6):
        u[k.DTWIST + i] = there[i]
    for j in range(6):
        pj = p.copy()
        Rj = R.copy()
        if j < 3:
            pj[j] += k.DIFFERENCE
        else:
            d = k.DIFFERENCE
            exp_step(Rj, (d if j == 3 else 0.0, d if j == 4 else 0.0, d if j == 5 else 0.0))
        moved = forward_dynamics_kernel(constants, code, pj, Rj, twist, tau, wrench)
        for i in range(6):
            u[k.GRADIENT + 6 * i + j] = (moved[i] - there[i]) / k.DIFFERENCE
    fill_influence(constants, code, p, R, u)
