"""Rotations: Cayley step, rotation vectors and their derivatives.

Sine and cosine are power series: the C library's last bit differs from processor to processor.
"""

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import MATRIX, VECTOR, helper, kernel
from drivers.rotations import COSINE, SINE, reciprocal_factorials, rotation_vector_kernel, series
from hil.mathematics.vectors import Vector, add, at, cross, dot, rotate, scale

_REST = reciprocal_factorials(3)
_INVERSE = tuple(2 * (k + 1) * c for k, c in enumerate(reciprocal_factorials(4)))
"""Coefficients of (2 B - A) / x in ``rotation_vector_rate``."""


@helper
def cayley_step(R: Array, w: Vector) -> None:
    """Replace R by C(w) R, C(w) = I + 2/(1 + a.a) ([a]x + [a]x^2), a = w/2.

    C agrees with exp([w]x) up to w^2, sufficient for Newton's method, and is orthogonal without a sine
    (Cayley 1846).
    """
    a = scale(0.5, w)
    k = 2.0 / (1.0 + dot(a, a))
    for j in range(3):
        x = (R[0, j], R[1, j], R[2, j])
        t = cross(a, x)
        y = add(x, scale(k, add(t, cross(a, t))))
        R[0, j] = y[0]
        R[1, j] = y[1]
        R[2, j] = y[2]


@helper
def orthonormalise(R: Array) -> None:
    """Replace R by R (3 I - R^T R) / 2: one Newton step towards the nearest rotation."""
    x = (R[0, 0], R[1, 0], R[2, 0])
    y = (R[0, 1], R[1, 1], R[2, 1])
    z = (R[0, 2], R[1, 2], R[2, 2])
    xy, yz, zx = -0.5 * dot(x, y), -0.5 * dot(y, z), -0.5 * dot(z, x)
    xx, yy, zz = 1.5 - 0.5 * dot(x, x), 1.5 - 0.5 * dot(y, y), 1.5 - 0.5 * dot(z, z)
    for i in range(3):
        R[i, 0] = xx * x[i] + xy * y[i] + zx * z[i]
        R[i, 1] = xy * x[i] + yy * y[i] + yz * z[i]
        R[i, 2] = zx * x[i] + yz * y[i] + zz * z[i]


@helper
def rotation_motion(rv: Vector, v: Vector, a: Vector, R: Array) -> tuple[Vector, Vector]:
    """Fill R = exp([r]x) and return omega, alpha (base frame) of a rotation vector r(t) with its derivatives.

    With x = r.r: R = I + A [r]x + B [r]x^2, omega = dr + B r x dr + C r x (r x dr), where
    A = sin|r|/|r|, B = (1 - cos|r|)/|r|^2, C = (|r| - sin|r|)/|r|^3 as power series in x; alpha is the
    time derivative of omega. All (3,), rad; for |r| <= 2 pi.
    """
    x = dot(rv, rv)
    dx = 2.0 * dot(rv, v)
    A, _ = series(SINE, x)
    B, Bx = series(COSINE, x)
    C, Cx = series(_REST, x)
    for i in range(3):
        for j in range(3):
            R[i, j] = B * rv[i] * rv[j]
        R[i, i] += 1.0 - B * x
    R[0, 1] -= A * rv[2]
    R[1, 0] += A * rv[2]
    R[0, 2] += A * rv[1]
    R[2, 0] -= A * rv[1]
    R[1, 2] -= A * rv[0]
    R[2, 1] += A * rv[0]
    rxv = cross(rv, v)
    rxrxv = cross(rv, rxv)
    w = add(v, add(scale(B, rxv), scale(C, rxrxv)))
    rxa = cross(rv, a)
    second = add(cross(v, rxv), cross(rv, rxa))
    dw = add(a, add(scale(B, rxa), scale(C, second)))
    dw = add(dw, scale(dx, add(scale(Bx, rxv), scale(Cx, rxrxv))))
    return w, dw


@kernel(VECTOR, VECTOR, VECTOR)
def rotation_motion_kernel(r: Array, dr: Array, ddr: Array) -> tuple[Array, Array, Array]:
    """R (3, 3), omega (3,) rad/s and alpha (3,) rad/s^2, base frame, of r(t) by `rotation_motion`."""
    R = np.empty((3, 3))
    omega, alpha = rotation_motion(at(r, 0), at(dr, 0), at(ddr, 0), R)
    return R, np.array(omega), np.array(alpha)


@kernel(VECTOR, VECTOR)
def rotation_vector_rate(r: Array, omega: Array) -> Array:
    """Rate dr/dt (3,) rad/s of the rotation vector r, for exp([r]x) with angular velocity omega (base frame).

    The inverse of omega(r, dr) of ``rotation_motion_kernel``: dr = omega - r x omega / 2 + D r x (r x omega),
    D = (2 B - A) / (2 B x), with the numerator as a power series in x (Bullo and Murray, 1995). |r| < 2 pi.
    """
    rv, w = at(r, 0), at(omega, 0)
    x = dot(rv, rv)
    B, _ = series(COSINE, x)
    N, _ = series(_INVERSE, x)
    rxw = cross(rv, w)
    return np.array(add(w, add(scale(-0.5, rxw), scale(N / (2.0 * B), cross(rv, rxw)))))


@kernel(MATRIX, MATRIX)
def relative_rotation(R0: Array, R1: Array) -> Array:
    """Rotation vector (3,) rad, base frame, of the shortest turn from R0 to R1: log(R1 R0^T)."""
    product = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            product[i, j] = R1[i, 0] * R0[j, 0] + R1[i, 1] * R0[j, 1] + R1[i, 2] * R0[j, 2]
    return rotation_vector_kernel(product)


@kernel(MATRIX, VECTOR)
def turned(R: Array, x: Array) -> Array:
    """Twist or wrench x (6,) of the platform frame in the base frame: [R x[:3]; R x[3:]]."""
    return np.array(rotate(R, at(x, 0)) + rotate(R, at(x, 3)))


def rotation_from_vector(r: Array) -> Array:
    """Rotation matrix R = exp([r]x) (3, 3) of a rotation vector r (3,) rad, |r| <= 2 pi."""
    zero = np.zeros(3)
    return rotation_motion_kernel(np.array(r, np.float64), zero, zero)[0]


def rotation_vector(R: Array) -> Array:
    """Rotation vector r (3,) rad, |r| <= pi, of a rotation matrix R (3, 3): exp([r]x) = R."""
    return rotation_vector_kernel(np.ascontiguousarray(R, np.float64))
