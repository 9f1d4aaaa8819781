"""Dynamics of platform and six two-part legs: M dtwist + H + G = J^T (tau - friction) + wrench.

The force of a leg is taken at its platform joint, which has velocity u and acceleration du (H. D. Taghirad,
Parallel Robots, 2013, 5.3, with l - c2 as the distance of the rod's centre of mass from the base joint). The
two hinges of a universal joint determine the spin of its leg. ``c`` is the vector of constants that
``hil.robot.dynamics`` packs.
"""

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, VECTOR, helper, kernel
from hil.mathematics.linear_algebra import lu_factor, lu_solve, lu_solve_transposed
from hil.mathematics.vectors import Vector, add, at, cross, dot, rotate, rotate_back, row, scale, sub
from hil.robot.kinematics_kernels import jacobian_rate_twist, leg, leg_motion

FULL, NO_H, PRINTED, CONSTANT, CONSTANT_MG = range(5)

# Indices in c.
BASE = 0  # (6, 3) base joints
PLATFORM = 18  # (6, 3) platform joints
AXES = 36  # (6, 3) unit base-side hinges of the universal joints
MASS = 54  # platform
COM = 55  # (3,) platform frame
INERTIA = 58  # (3, 3) about the platform origin, platform axes
GRAVITY = 67  # (3,)
CYLINDER_MASS = 70
CYLINDER_COM = 71
ROD_MASS = 72
ROD_COM = 73
TRANSVERSE = 74  # cylinder + rod, each about its own centre of mass
AXIAL = 75  # cylinder + rod; 0 where legs do not spin
FROZEN_M = 76  # (6, 6)
FROZEN_G = 112  # (6,)
FROZEN_J = 118  # (6, 6)
REFLECTED = 154  # (6,) motor and screw inertia as a mass along each leg
VISCOUS = 160  # (6,)
COULOMB = 166  # (6,)
SLIDING_SPEED = 172
SIZE = 173


@helper
def inertia_about_base(c: Array, l: float) -> float:
    """Inertia of a leg across its axis about its base joint, kg m^2: I1 + I2 + m1 c1^2 + m2 (l - c2)^2."""
    m1, c1, m2, c2 = c[CYLINDER_MASS], c[CYLINDER_COM], c[ROD_MASS], c[ROD_COM]
    return float(c[TRANSVERSE] + m1 * c1 * c1 + m2 * (l - c2) * (l - c2))


@helper
def spin_gradient(k: Vector, l: float, s: Vector) -> Vector:
    """Gradient h, 1/m: h.u is the spin rate, rad/s, of a leg about its axis if its platform joint moves at u.

    k is the unit direction of the base hinge, s that of the leg. The second hinge is along k x s; omega has
    no component along k x (k x s), so with x = k.s spin = x / (1 - x^2) (k x s).ds/dt.
    """
    x = dot(k, s)
    return scale(x / ((1.0 - x * x) * l), cross(k, s))


@helper
def leg_mass(c: Array, i: int, l: float, s: Vector) -> tuple[Vector, Vector, Vector]:
    """Rows of a leg's mass matrix, kg, M_i = (m2 + m_r) s s^T + I(l)/l^2 (1 - s s^T) + I_axial h h^T.

    The reflected mass m_r acts along the leg only.
    """
    across = inertia_about_base(c, l) / (l * l)
    along = c[ROD_MASS] + c[REFLECTED + i] - across
    M0 = (across + along * s[0] * s[0], along * s[0] * s[1], along * s[0] * s[2])
    M1 = (M0[1], across + along * s[1] * s[1], along * s[1] * s[2])
    M2 = (M0[2], M1[2], across + along * s[2] * s[2])
    if c[AXIAL] != 0.0:
        h = spin_gradient(at(c, AXES + 3 * i), l, s)
        M0 = add(M0, scale(c[AXIAL] * h[0], h))
        M1 = add(M1, scale(c[AXIAL] * h[1], h))
        M2 = add(M2, scale(c[AXIAL] * h[2], h))
    return M0, M1, M2


@helper
def leg_bias(c: Array, i: int, l: float, s: Vector, dl: float, ds: Vector) -> Vector:
    """Force h_i, N, of leg i at its platform joint due to velocities alone: without weight, at du = 0.

    h_i = (m2 c2 + m_r l) |ds|^2 s + 2 (dl / l) (m2 (l - c2) - I(l)/l) ds, and the spin's gyroscopic and
    constraint part. The reflected mass m_r needs m_r ddl along s, and ddl = s.du + l |ds|^2.
    """
    m2, c2 = c[ROD_MASS], c[ROD_COM]
    force = scale((m2 * c2 + c[REFLECTED + i] * l) * dot(ds, ds), s)
    force = add(force, scale(2.0 * dl / l * (m2 * (l - c2) - inertia_about_base(c, l) / l), ds))
    if c[AXIAL] != 0.0:
        k = at(c, AXES + 3 * i)
        x, dx = dot(k, s), dot(k, ds)
        rest = 1.0 - x * x
        turn = dot(cross(k, s), ds)
        spin = x / rest * turn
        dspin = (1.0 + x * x) / (rest * rest) * dx * turn - 2.0 * dl / l * spin
        force = add(force, scale(c[AXIAL] * spin / l, cross(ds, s)))
        force = add(force, scale(c[AXIAL] * dspin, spin_gradient(k, l, s)))
    return force


@helper
def leg_weight(c: Array, g: Vector, l: float, s: Vector) -> Vector:
    """Force, N, that carries a leg's weight: g_i = -m2 s s.g - (m1 c1 + m2 (l - c2))/l (g - s s.g)."""
    along = dot(s, g)
    across = (c[CYLINDER_MASS] * c[CYLINDER_COM] + c[ROD_MASS] * (l - c[ROD_COM])) / l
    return sub(scale(-c[ROD_MASS] * along, s), scale(across, sub(g, scale(along, s))))


@helper
def inertia_times(c: Array, x: Vector) -> Vector:
    """Product I x, kg m^2 times x, of the platform's inertia about its origin and a vector, platform axes."""
    return dot(at(c, INERTIA), x), dot(at(c, INERTIA + 3), x), dot(at(c, INERTIA + 6), x)


@helper
def fill_mass_matrix(c: Array, p: Array, R: Array, M: Array) -> None:
    """Fill the mass matrix M (6, 6) = platform + sum J_i^T M_i J_i, J_i = [1, -[r_i]x]."""
    m = c[MASS]
    x = rotate(R, at(c, COM))
    M[:] = 0.0
    M[0, 0] = M[1, 1] = M[2, 2] = m
    for j in range(3):  # R I R^T, one column at a time
        column = rotate(R, inertia_times(c, row(R, j)))
        M[3, 3 + j], M[4, 3 + j], M[5, 3 + j] = column
    M[0, 4] = m * x[2]  # force of alpha: m alpha x c = -m [c]x alpha
    M[0, 5] = -m * x[1]
    M[1, 3] = -m * x[2]
    M[1, 5] = m * x[0]
    M[2, 3] = m * x[1]
    M[2, 4] = -m * x[0]
    for i in range(6):
        r = rotate(R, at(c, PLATFORM + 3 * i))
        l, s = leg(at(c, BASE + 3 * i), r, at(p, 0))
        # Row n of M_i J_i is [m_n, r x m_n], because m.(w x r) = (r x m).w.
        m0, m1, m2 = leg_mass(c, i, l, s)
        n0, n1, n2 = cross(r, m0), cross(r, m1), cross(r, m2)
        for j in range(3):
            M[0, j] += m0[j]
            M[1, j] += m1[j]
            M[2, j] += m2[j]
            M[0, 3 + j] += n0[j]
            M[1, 3 + j] += n1[j]
            M[2, 3 + j] += n2[j]
            turn = cross(r, (n0[j], n1[j], n2[j]))
            M[3, 3 + j] += turn[0]
            M[4, 3 + j] += turn[1]
            M[5, 3 + j] += turn[2]
    for i in range(3):
        for j in range(3):
            M[3 + j, i] = M[i, 3 + j]


@helper
def platform_force(c: Array, R: Array, g: Vector, w: Vector, dv: Vector, dw: Vector) -> tuple[Vector, Vector]:
    """Force and moment about the platform origin that accelerate the platform (Newton, Euler).

    F = m (dv + dw x x + w x (w x x) - g), N = I dw + w x I w + m x x (dv - g), x = R com.
    """
    x = rotate(R, at(c, COM))
    lift = scale(c[MASS], sub(dv, g))
    force = add(lift, scale(c[MASS], add(cross(dw, x), cross(w, cross(w, x)))))
    wp = rotate_back(R, w)
    turning = add(inertia_times(c, rotate_back(R, dw)), cross(wp, inertia_times(c, wp)))
    return force, add(rotate(R, turning), cross(x, lift))


@helper
def newton_euler(c: Array, p: Array, R: Array, g: Vector, twist: Array, dtwist: Array, f: Array) -> None:
    """Fill f (6,) N, N m = M dtwist + H + G: platform, and sum J_i^T (M_i du_i + h_i + g_i) over the legs.

    twist = 0 omits H, g = 0 omits G.
    """
    v, w = at(twist, 0), at(twist, 3)
    dv, dw = at(dtwist, 0), at(dtwist, 3)
    force, moment = platform_force(c, R, g, w, dv, dw)
    for i in range(6):
        r = rotate(R, at(c, PLATFORM + 3 * i))
        l, s = leg(at(c, BASE + 3 * i), r, at(p, 0))
        _, dl, ds = leg_motion(l, s, r, v, w)
        du = add(add(dv, cross(dw, r)), cross(w, cross(w, r)))
        m0, m1, m2 = leg_mass(c, i, l, s)
        at_joint = add((dot(m0, du), dot(m1, du), dot(m2, du)), leg_bias(c, i, l, s, dl, ds))
        at_joint = add(at_joint, leg_weight(c, g, l, s))
        force = add(force, at_joint)
        moment = add(moment, cross(r, at_joint))
    for j in range(3):
        f[j] = force[j]
        f[3 + j] = moment[j]


@helper
def model_force(c: Array, code: int, p: Array, R: Array, twist: Array, dtwist: Array, f: Array) -> None:
    """Fill f (6,) N, N m with M dtwist + H + G as the model variant `code` simplifies it."""
    if code in (CONSTANT, CONSTANT_MG):
        for i in range(6):
            total = c[FROZEN_G + i]
            for j in range(6):
                total += c[FROZEN_M + 6 * i + j] * dtwist[j]
            f[i] = total
    elif code == FULL:
        newton_euler(c, p, R, at(c, GRAVITY), twist, dtwist, f)
    else:
        newton_euler(c, p, R, at(c, GRAVITY), np.zeros(6), dtwist, f)


@helper
def fill_jacobian(c: Array, code: int, p: Array, R: Array, J: Array) -> None:
    """Fill the Jacobian J (6, 6) at p, R; for the variant CONSTANT with the frozen Jacobian in c."""
    for i in range(6):
        if code == CONSTANT:
            for j in range(6):
                J[i, j] = c[FROZEN_J + 6 * i + j]
        else:
            r = rotate(R, at(c, PLATFORM + 3 * i))
            _, s = leg(at(c, BASE + 3 * i), r, at(p, 0))
            m = cross(r, s)
            for j in range(3):
                J[i, j] = s[j]
                J[i, 3 + j] = m[j]


@helper
def leg_friction(c: Array, i: int, dq: float) -> float:
    """Friction of leg i, N: viscous dq + coulomb sat(dq / v_s); > 0 while the leg extends.

    sat is 1 above v_s and linear below; with v_s = 0 it is sgn, sgn(0) = 0.
    """
    v_s = c[SLIDING_SPEED]
    if dq > v_s:
        share = 1.0
    elif dq < -v_s:
        share = -1.0
    elif v_s > 0.0:
        share = dq / v_s
    else:
        share = 0.0
    return float(c[VISCOUS + i] * dq + c[COULOMB + i] * share)


@helper
def add_friction(c: Array, p: Array, R: Array, twist: Array, sign: float, tau: Array) -> None:
    """Add sign * friction to the leg forces tau (6,) N at dq = J twist; J is that of p, R, never frozen."""
    for i in range(6):
        if c[VISCOUS + i] != 0.0 or c[COULOMB + i] != 0.0:
            r = rotate(R, at(c, PLATFORM + 3 * i))
            _, s = leg(at(c, BASE + 3 * i), r, at(p, 0))
            dq = dot(s, add(at(twist, 0), cross(at(twist, 3), r)))
            tau[i] += sign * leg_friction(c, i, dq)


@kernel(VECTOR, VECTOR)
def friction_kernel(c: Array, dq: Array) -> Array:
    """Friction forces (6,) N of the drives at the leg rates dq (6,) m/s, with the signs of dq."""
    force = np.empty(6)
    for i in range(6):
        force[i] = leg_friction(c, i, dq[i])
    return force


@kernel(VECTOR, VECTOR, MATRIX)
def mass_matrix_kernel(c: Array, p: Array, R: Array) -> Array:
    """Mass matrix M (6, 6) kg, kg m, kg m^2 in twist coordinates at the pose p (3,) m, R (3, 3)."""
    M = np.empty((6, 6))
    fill_mass_matrix(c, p, R, M)
    return M


@kernel(VECTOR, VECTOR, MATRIX, VECTOR)
def coriolis_kernel(c: Array, p: Array, R: Array, twist: Array) -> Array:
    """Centripetal and gyroscopic forces H (6,) N, N m, base frame, at the pose p, R and the twist (6,)."""
    f = np.empty(6)
    newton_euler(c, p, R, (0.0, 0.0, 0.0), twist, np.zeros(6), f)
    return f


@kernel(VECTOR, VECTOR, MATRIX)
def gravity_kernel(c: Array, p: Array, R: Array) -> Array:
    """Forces G (6,) N, N m, base frame, that carry platform and legs against gravity at the pose p, R."""
    f, rest = np.empty(6), np.zeros(6)
    newton_euler(c, p, R, at(c, GRAVITY), rest, rest, f)
    return f


@kernel(VECTOR, VECTOR, MATRIX)
def potential_energy_kernel(c: Array, p: Array, R: Array) -> float:
    """Potential energy, J: -sum m g.x over platform, cylinders and rods, x in the base frame."""
    g = at(c, GRAVITY)
    energy = -c[MASS] * dot(g, add(at(p, 0), rotate(R, at(c, COM))))
    for i in range(6):
        a = at(c, BASE + 3 * i)
        r = rotate(R, at(c, PLATFORM + 3 * i))
        l, s = leg(a, r, at(p, 0))
        energy -= c[CYLINDER_MASS] * dot(g, add(a, scale(c[CYLINDER_COM], s)))
        energy -= c[ROD_MASS] * dot(g, add(a, scale(l - c[ROD_COM], s)))
    return float(energy)


@kernel(VECTOR, INTEGER, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR)
def inverse_dynamics_kernel(
    c: Array, code: int, p: Array, R: Array, twist: Array, dtwist: Array, wrench: Array
) -> Array:
    """Leg forces (6,) N: tau = J^-T (M dtwist + H + G - wrench) + friction; nan where J is singular."""
    work = np.empty((14, 6))
    f = work[12]
    model_force(c, code, p, R, twist, dtwist, f)
    for i in range(6):
        f[i] -= wrench[i]
    J, LU = work[0:6], work[6:12]
    fill_jacobian(c, code, p, R, J)
    order, tau = np.empty(6, np.int64), np.empty(6)
    if lu_factor(J, LU, order):
        lu_solve_transposed(LU, order, f, tau, work[13])
        add_friction(c, p, R, twist, 1.0, tau)
    else:
        tau[:] = np.nan
    return tau


@kernel(VECTOR, INTEGER, VECTOR, MATRIX, VECTOR, MATRIX, VECTOR, VECTOR)
def joint_idc_kernel(
    c: Array, code: int, p: Array, R: Array, twist: Array, J: Array, ddq_star: Array, wrench: Array
) -> Array:
    """Leg forces tau = J^-T [M J^-1 (ddq* - (dJ/dt) twist) + H + G - wrench] + friction, (6,) N.

    nan where J is singular. J is the Jacobian at p, R; variant ``constant`` uses its frozen J instead. Only
    ``full`` and ``no_H`` contain (dJ/dt) twist.
    """
    work = np.empty((15, 6))
    LU = work[0:6]
    order = np.empty(6, np.int64)
    tau = np.empty(6)
    if code == CONSTANT:
        frozen = work[6:12]
        fill_jacobian(c, code, p, R, frozen)
        regular = lu_factor(frozen, LU, order)
    else:
        regular = lu_factor(J, LU, order)
    if not regular:
        tau[:] = np.nan
        return tau
    y = work[12]
    for i in range(6):
        y[i] = ddq_star[i]
        if code in (FULL, NO_H):
            a = at(c, BASE + 3 * i)
            b = at(c, PLATFORM + 3 * i)
            y[i] -= jacobian_rate_twist(a, b, at(p, 0), R, at(twist, 0), at(twist, 3))
    dtwist = work[13]
    lu_solve(LU, order, y, dtwist)
    f = work[14]
    model_force(c, code, p, R, twist, dtwist, f)
    for i in range(6):
        f[i] -= wrench[i]
    lu_solve_transposed(LU, order, f, tau, y)
    add_friction(c, p, R, twist, 1.0, tau)
    return tau


@helper
def model_inertia(c: Array, code: int, p: Array, R: Array, M: Array) -> None:
    """Fill M (6, 6), kg, kg m and kg m^2, base frame, with the mass matrix of the model variant."""
    if code in (CONSTANT, CONSTANT_MG):
        for i in range(6):
            for j in range(6):
                M[i, j] = c[FROZEN_M + 6 * i + j]
    else:
        fill_mass_matrix(c, p, R, M)


@kernel(VECTOR, INTEGER, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR)
def forward_dynamics_kernel(
    c: Array, code: int, p: Array, R: Array, twist: Array, tau: Array, wrench: Array
) -> Array:
    """Acceleration (6,), m/s^2, rad/s^2: M^-1 (J^T (tau - friction) + wrench - H - G); nan for singular M."""
    drive = tau.copy()
    add_friction(c, p, R, twist, -1.0, drive)
    f, dtwist = np.empty(6), np.zeros(6)
    model_force(c, code, p, R, twist, dtwist, f)
    J, M, LU = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    fill_jacobian(c, code, p, R, J)
    for j in range(6):
        total = 0.0
        for i in range(6):
            total += J[i, j] * drive[i]
        f[j] = total + wrench[j] - f[j]
    model_inertia(c, code, p, R, M)
    order = np.empty(6, np.int64)
    if lu_factor(M, LU, order):
        lu_solve(LU, order, f, dtwist)
    else:
        dtwist[:] = np.nan
    return dtwist
