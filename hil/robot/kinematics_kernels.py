"""Lengths, Jacobian, its rate, and Newton's method for the pose.

a (6, 3): base joints in the base frame; b (6, 3): platform joints in the platform frame; p (3,), R (3, 3):
x_base = p + R x_platform; all in m. Row i of the Jacobian is [s_i, (R b_i) x s_i], s_i from base to platform
joint (Merlet, Parallel Robots, 2006, 5.3).
"""

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import INTEGER, MATRIX, REAL, VECTOR, helper, kernel
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.rotations import cayley_step, orthonormalise
from hil.mathematics.vectors import Vector, add, at, cross, dot, rotate, row, scale, sub

FLOOR = 1e-8
"""m: rounding dominates shorter Newton steps, so their ratio does not count in ``hop``."""


@helper
def leg(a: Vector, r: Vector, p: Vector) -> tuple[float, Vector]:
    """Length l, m, and unit vector s of the leg from base joint a to platform joint p + r, r = R b."""
    d = sub(add(p, r), a)
    l = np.sqrt(dot(d, d))
    return l, scale(1.0 / l, d)


@helper
def lengths_and_jacobian(a: Array, b: Array, p: Array, R: Array, l: Array, J: Array) -> None:
    """Fill the leg lengths l (6,) m and the Jacobian J (6, 6), dl/dt = J twist, at the pose p, R."""
    position = at(p, 0)
    for i in range(6):
        r = rotate(R, row(b, i))
        l[i], s = leg(row(a, i), r, position)
        m = cross(r, s)
        for j in range(3):
            J[i, j] = s[j]
            J[i, 3 + j] = m[j]


@kernel(MATRIX, MATRIX, VECTOR, MATRIX)
def leg_lengths_kernel(a: Array, b: Array, p: Array, R: Array) -> Array:
    """Leg lengths (6,) m at the pose p, R: l_i = |p + R b_i - a_i|."""
    l = np.empty(6)
    for i in range(6):
        l[i], _ = leg(row(a, i), rotate(R, row(b, i)), at(p, 0))
    return l


@kernel(MATRIX, MATRIX, VECTOR, MATRIX)
def jacobian_kernel(a: Array, b: Array, p: Array, R: Array) -> Array:
    """Jacobian J (6, 6) of the leg lengths at the pose p, R: dl/dt = J twist."""
    l = np.empty(6)
    J = np.empty((6, 6))
    lengths_and_jacobian(a, b, p, R, l, J)
    return J


@helper
def leg_motion(l: float, s: Vector, r: Vector, v: Vector, w: Vector) -> tuple[Vector, float, Vector]:
    """Velocity u = v + w x r, m/s, of a platform joint, leg rate s.u, m/s, and ds/dt = (u - s s.u)/l, 1/s."""
    u = add(v, cross(w, r))
    dl = dot(s, u)
    return u, dl, scale(1.0 / l, sub(u, scale(dl, s)))


@kernel(MATRIX, MATRIX, VECTOR, MATRIX, VECTOR)
def jacobian_rate_kernel(a: Array, b: Array, p: Array, R: Array, twist: Array) -> Array:
    """dJ/dt (6, 6) at a pose and twist (6,): row i is [ds, (w x r) x s + r x ds], r = R b_i, ds = ds_i/dt."""
    Jdot = np.empty((6, 6))
    v = at(twist, 0)
    w = at(twist, 3)
    for i in range(6):
        r = rotate(R, row(b, i))
        l, s = leg(row(a, i), r, at(p, 0))
        _, _, ds = leg_motion(l, s, r, v, w)
        m = add(cross(cross(w, r), s), cross(r, ds))
        for j in range(3):
            Jdot[i, j] = ds[j]
            Jdot[i, 3 + j] = m[j]
    return Jdot


@helper
def jacobian_rate_twist(a: Vector, b: Vector, p: Vector, R: Array, v: Vector, w: Vector) -> float:
    """One row of (dJ/dt) twist, m/s^2: ds.u + s.(w x (w x r)) of a leg, computed without dJ/dt."""
    r = rotate(R, b)
    l, s = leg(a, r, p)
    u, _, ds = leg_motion(l, s, r, v, w)
    return dot(ds, u) + dot(s, cross(w, cross(w, r)))


@helper
def joint_displacement(b: Array, R: Array, step: Array) -> float:
    """Largest displacement, m, of a platform joint b under the small motion ``step`` (6,) m, rad."""
    largest = 0.0
    for i in range(6):
        d = add(at(step, 0), cross(at(step, 3), rotate(R, row(b, i))))
        size = dot(d, d)
        if size > largest or np.isnan(size):
            largest = size
    return float(np.sqrt(largest))


@helper
def newton(
    a: Array,
    b: Array,
    q: Array,
    p: Array,
    R: Array,
    tolerance: float,
    max_iterations: int,
    J: Array,
    order: Ints,
    work: Array,
) -> tuple[int, float, float]:
    """Iterate p, R in place until the leg lengths are q, fill J, and return iterations, residual, hop.

    Newton on SE(3): J step = q - l(p, R), p += step_v, R = C(step_w) R with the Cayley map C. hop >= 1: the
    pose may belong to another assembly (``hil.estimation.pose``). ``order`` (6,), ``work`` (9, 6): scratch.
    """
    LU = work[0:6]
    l = work[6]
    error = work[7]
    step = work[8]
    hop = 0.0
    previous = 0.0
    orthonormalise(R)
    for iteration in range(max_iterations + 1):
        lengths_and_jacobian(a, b, p, R, l, J)
        residual = 0.0
        for i in range(6):
            error[i] = q[i] - l[i]
            size = abs(error[i])
            if size > residual or np.isnan(size):  # a nan stays
                residual = size
        if residual <= tolerance:
            return iteration, residual, hop
        if iteration == max_iterations or not residual < np.inf or not lu_factor(J, LU, order):
            return iteration, np.inf, hop
        lu_solve(LU, order, error, step)
        size = joint_displacement(b, R, step)
        if previous > FLOOR:
            hop = max(hop, 8.0 * size / previous)
        previous = size
        for i in range(3):
            p[i] += step[i]
        cayley_step(R, at(step, 3))
    return max_iterations, np.inf, hop


@kernel(MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, REAL, INTEGER)
def forward_kinematics_kernel(
    a: Array, b: Array, q: Array, p0: Array, R0: Array, tolerance: float, max_iterations: int
) -> tuple[Array, Array, Array, int, float, float]:
    """Pose p, R for the leg lengths q (6,) m by Newton's method from p0, R0; also J and how it converged.

    Returns p, R, J, iterations, residual, hop. ``residual`` is the largest |q_i - l_i| in m, at most
    ``tolerance``; without convergence inf, and p, R are the last iterate. ``hop``: see ``newton``.
    """
    p = p0.copy()
    R = R0.copy()
    J = np.empty((6, 6))
    iterations, residual, hop = newton(
        a, b, q, p, R, tolerance, max_iterations, J, np.empty(6, np.int64), np.empty((9, 6))
    )
    return p, R, J, iterations, residual, hop


@kernel(MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, REAL, INTEGER)
def continuation_kernel(
    a: Array, b: Array, q: Array, p0: Array, R0: Array, tolerance: float, max_substeps: int
) -> tuple[Array, Array, int, float]:
    """Pose p, R, substeps tried, residual, m, for leg lengths q (6,) m on the branch that starts at p0, R0.

    The lengths move on a straight line from those of p0, R0 to q. A substep that does not converge with
    hop < 1 (see ``newton``) is halved. residual is inf if q is not reached within ``max_substeps`` tries.
    """
    p = p0.copy()
    R = R0.copy()
    pt = np.empty(3)
    Rt = np.empty((3, 3))
    start = np.empty(6)
    target = np.empty(6)
    J = np.empty((6, 6))
    order = np.empty(6, np.int64)
    work = np.empty((9, 6))
    lengths_and_jacobian(a, b, p, R, start, J)
    done = 0.0
    stride = 1.0
    for substep in range(max_substeps):
        end = min(1.0, done + stride)
        for i in range(6):
            target[i] = q[i] if end == 1.0 else start[i] + end * (q[i] - start[i])
        pt[:] = p
        Rt[:] = R
        _, residual, hop = newton(a, b, target, pt, Rt, tolerance, 12, J, order, work)
        if residual < np.inf and hop < 1.0:
            p[:] = pt
            R[:] = Rt
            done = end
            if done == 1.0:
                return p, R, substep + 1, residual
            stride *= 2.0
        else:
            stride *= 0.5
    return p, R, max_substeps, np.inf


@helper
def segment_distance(x: Vector, u: Vector, y: Vector, v: Vector) -> float:
    """Smallest distance, m, between the line segments x..x+u and y..y+v (Ericson, 2005, 5.1.9)."""
    w = sub(x, y)
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    det = uu * vv - uv * uv
    s = 0.0
    if det > 1e-12 * uu * vv:
        s = min(max((uv * vw - uw * vv) / det, 0.0), 1.0)
    t = (uv * s + vw) / vv
    if t < 0.0:
        t = 0.0
        s = min(max(-uw / uu, 0.0), 1.0)
    elif t > 1.0:
        t = 1.0
        s = min(max((uv - uw) / uu, 0.0), 1.0)
    d = add(w, sub(scale(s, u), scale(t, v)))
    return float(np.sqrt(dot(d, d)))
