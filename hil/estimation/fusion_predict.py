"""The fusion filter's prediction: state and covariance over a part of an interval between two ticks."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import VECTOR, helper, kernel, record
from drivers.compiled.pointed import reals_at
from hil.estimation.fusion_layout import FORCE_BIAS, FUSION, LEG_FORCE, STEP, TWIST
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.vectors import Vector, add, at, cross, dot, rotate, scale, sub
from hil.robot.dynamics_kernels import SIZE, fill_jacobian, forward_dynamics_kernel, model_inertia

DIFFERENCE = 1e-6
"""Step of the gradient, m or rad."""


@helper
def exp_step(R: Array, w: Vector) -> None:
    """Replace R by exp([w]x) R, w rad, |w| <= 0.5, by a series that is exact to the last bit."""
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
    """View of the rotation R (3, 3), platform to base, in a state (30,)."""
    return x[3:12].reshape(3, 3)


@helper
def acceleration(f: Any, s: Any) -> tuple[Vector, Vector]:
    """Accelerations (dv m/s^2, domega rad/s^2) of an interval: the model's, plus unknown leg forces' part."""
    a, turn, I = at(s.dtwist, 0), at(s.dtwist, 3), s.influence
    for leg in range(f.offsets - f.forces):
        force = s.x[LEG_FORCE + leg]
        a = add(a, scale(force, (I[0, leg], I[1, leg], I[2, leg])))
        turn = add(turn, scale(force, (I[3, leg], I[4, leg], I[5, leg])))
    return a, turn


@helper
def multiply(A: Array, B: Array, C: Array) -> None:
    """Fill C = A B, all (n, n), skipping zeros of A."""
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
def carry(P: Array, F: Array) -> None:
    """Replace the upper half of P by that of F P F^T, all (n, n), row by row."""
    n, W = P.shape[0], np.empty_like(P)
    multiply(F, P, W)
    for i in range(n):
        for j in range(n):
            P[j, i] = W[i, j]
    multiply(F, P, W)
    for i in range(n):
        for j in range(i, n):
            P[i, j] = W[j, i]


@helper
def weigh(f: Any, s: Any, a: Vector, dt: float, F: Array) -> tuple[Vector, float]:
    """Linear acceleration of an interval, m/s^2, and the IMU's weight in it, 0..1; a: the model's one.

    It is the mean of a and R (f - bias) + g, weighted by the inverse of their variances: two measurements of
    one acceleration. Fills the entries of F that depend on it: dv changes by dtheta x f share dt.
    """
    if s.imu == 0 or s.T <= 0.0:
        return a, 0.0
    R = rotation_of(s.x)
    share = f.q_v / s.T
    share = share / (share + f.r_force)
    biased = f.forces > 12
    felt = at(s.force, 0)
    if biased:
        felt = sub(felt, at(s.x, FORCE_BIAS))
    felt = rotate(R, felt)
    gain = share * dt
    F[6, 4], F[6, 5], F[7, 3] = gain * felt[2], -gain * felt[1], -gain * felt[2]
    F[7, 5], F[8, 3], F[8, 4] = gain * felt[0], gain * felt[1], -gain * felt[0]
    if biased:
        for i in range(3):
            for j in range(3):
                F[6 + i, 15 + j] = -gain * R[i, j]
    return add(a, scale(share, sub(add(felt, at(f.gravity, 0)), a))), share


@helper
def fill_transition(f: Any, s: Any, dt: float, share: float, phi: Vector, stays: float, F: Array) -> None:
    """Fill in F's gradients of the model's acceleration, rotation by phi rad, and decay of leg forces."""
    n, forces, offsets = f.errors, f.forces, f.offsets
    for i in range(6):
        kept = dt * (1.0 - share) if i < 3 else dt
        for j in range(6):
            F[6 + i, j] += kept * s.gradient[i, j]
        for j in range(offsets - forces):
            F[6 + i, forces + j] = kept * s.influence[i, j]
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
    for j in range(forces, offsets):
        F[j, j] = stays
        for i in range(3):
            F[3 + i, j] = 0.5 * dt * F[9 + i, j]


@helper
def predict(f: Any, s: Any, P: Array, dt: float) -> None:
    """Predict the state of a step and P by dt (s) in place, with the acceleration of its interval.

    The noise of the leg forces is added in two halves, before and after.
    """
    x, n, forces, offsets = s.x, f.errors, f.forces, f.offsets
    w = at(x, TWIST + 3)
    stays, q_leg = 1.0, 0.0
    if forces < offsets:
        stays = np.exp(-dt / f.leg_force_s)
        q_leg = s.fade * f.leg_force * (1.0 - stays * stays)
    for i in range(forces, offsets):
        P[i, i] += 0.5 * q_leg
    F = np.eye(n)
    a, turn = acceleration(f, s)
    a, share = weigh(f, s, a, dt, F)
    phi = add(scale(dt, w), scale(0.5 * dt * dt, turn))
    fill_transition(f, s, dt, share, phi, stays, F)
    carry(P, F)
    for i in range(forces, offsets):
        P[i, i] += 0.5 * q_leg
    add_process_noise(f, P, f.q_v * (1.0 - share) * s.fade, f.q_w * s.fade, dt)
    for i in range(6):
        x[LEG_FORCE + i] *= stays
    for i in range(3):
        x[i] += dt * (x[TWIST + i] + 0.5 * dt * a[i])
        x[TWIST + i] += dt * a[i]
        x[TWIST + 3 + i] += dt * turn[i]
    exp_step(rotation_of(x), phi)


@helper
def add_process_noise(f: Any, P: Array, q_v: float, q_w: float, dt: float) -> None:
    """Add process noise over dt, s, to P: white accelerations, bias drifts; then mirror its upper half."""
    for i in range(3):
        for at_pose, at_rate, q in ((i, 6 + i, q_v), (3 + i, 9 + i, q_w)):
            P[at_pose, at_pose] += q * dt * dt * dt / 3.0
            P[at_pose, at_rate] += q * dt * dt / 2.0
            P[at_rate, at_rate] += q * dt
    for i in range(12, f.forces):
        P[i, i] += (f.q_gyro_bias if i < 15 else f.q_force_bias) * dt
    for i in range(f.offsets, f.errors):
        place = i - f.offsets
        P[i, i] += (f.q_stamp if place == 0 else f.q_position if place < 4 else f.q_rotation) * dt
    for i in range(f.errors):
        for j in range(i):
            P[i, j] = P[j, i]


@kernel(record(FUSION), record(STEP), VECTOR, VECTOR, record(STEP))
def accelerate_kernel(f: Any, before: Any, tau: Array, wrench: Array, s: Any) -> None:
    """Fill dtwist, gradient and influence of a step from the state before and the forces tau (6,) N.

    A platform on legs with given forces is an inverted pendulum: an error in a direction that no leg measures
    grows by itself, about as fast as a tracker of 1 mm and 200 Hz corrects it. Forward differences.
    """
    c, code, x = reals_at(f.constants, SIZE), f.code, before.x
    p, R, twist = x[0:3].copy(), rotation_of(x).copy(), x[12:18].copy()
    there = forward_dynamics_kernel(c, code, p, R, twist, tau, wrench)
    s.dtwist[:] = there
    for j in range(6):
        pj, Rj = p.copy(), R.copy()
        if j < 3:
            pj[j] += DIFFERENCE
        else:
            d = DIFFERENCE
            exp_step(Rj, (d if j == 3 else 0.0, d if j == 4 else 0.0, d if j == 5 else 0.0))
        moved = forward_dynamics_kernel(c, code, pj, Rj, twist, tau, wrench)
        for i in range(6):
            s.gradient[i, j] = (moved[i] - there[i]) / DIFFERENCE
    J, M, LU, order = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6)), np.empty(6, np.int64)
    fill_jacobian(c, code, p, R, J)
    model_inertia(c, code, p, R, M)
    if lu_factor(M, LU, order):
        for leg in range(6):
            lu_solve(LU, order, J[leg], moved)
            for i in range(6):
                s.influence[i, leg] = moved[i]
