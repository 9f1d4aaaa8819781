"""Rotation vectors and matrices, compiled, for both ends of the bus and for the controller's mathematics.

Sine, cosine and arc tangent are power series: the C library's last bit differs from processor to processor.
"""

from math import factorial

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import MATRIX, helper, kernel

_TERMS = 24
"""Number of terms: enough for full double precision at |r| <= 2 pi."""


def reciprocal_factorials(first: int) -> tuple[float, ...]:
    """Coefficients (-1)^k / (2 k + first)! for k = 0, 1, ..., of the power series of rotations."""
    return tuple((-1) ** k / factorial(2 * k + first) for k in range(_TERMS))


SINE = reciprocal_factorials(1)
"""sin(a) / a as a series in a^2."""
COSINE = reciprocal_factorials(2)
"""(1 - cos(a)) / a^2 as a series in a^2."""


@helper
def series(coefficients: tuple[float, ...], x: float) -> tuple[float, float]:
    """Polynomial sum c_k x^k and its derivative (Horner)."""
    value = 0.0
    slope = 0.0
    for k in range(_TERMS):
        slope = slope * x + value
        value = value * x + coefficients[_TERMS - 1 - k]
    return value, slope


@helper
def turn(r: Array, R: Array) -> Array:
    """exp([r]x) R by Rodrigues' formula; r (3,) rad, |r| <= 2 pi."""
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    a, b = series(SINE, square)[0], series(COSINE, square)[0]
    found = np.empty((3, 3))
    for j in range(3):
        x, y, z = R[0, j], R[1, j], R[2, j]
        u, v, w = r[1] * z - r[2] * y, r[2] * x - r[0] * z, r[0] * y - r[1] * x
        found[0, j] = x + a * u + b * (r[1] * w - r[2] * v)
        found[1, j] = y + a * v + b * (r[2] * u - r[0] * w)
        found[2, j] = z + a * w + b * (r[0] * v - r[1] * u)
    return found


@helper
def times(A: Array, x: Array) -> Array:
    """A x for A (3, 3), x (3,)."""
    y = np.empty(3)
    for i in range(3):
        y[i] = A[i, 0] * x[0] + A[i, 1] * x[1] + A[i, 2] * x[2]
    return y


@kernel(MATRIX)
def rotation_vector_kernel(R: Array) -> Array:
    """Rotation vector r with exp([r]x) = R, |r| <= pi. R (3, 3).

    Uses the unit quaternion and an arc tangent of an eighth of the half angle.
    """
    # Largest of w, x, y, z first: no small divisor.
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace > 0.0:
        w, v = 1.0 + trace, (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        w, v = R[2, 1] - R[1, 2], (1.0 + R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0])
    elif R[1, 1] >= R[2, 2]:
        w, v = R[0, 2] - R[2, 0], (R[0, 1] + R[1, 0], 1.0 + R[1, 1] - R[0, 0] - R[2, 2], R[1, 2] + R[2, 1])
    else:
        w, v = R[1, 0] - R[0, 1], (R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1.0 + R[2, 2] - R[0, 0] - R[1, 1])
    norm = np.sqrt(w * w + v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    sign = -1.0 if w < 0.0 else 1.0
    c, s = sign * w / norm, np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) / norm  # of half the angle
    r = np.zeros(3)
    if s == 0.0:
        return r
    # The angle is 2 * 8 * atan of the tangent of an eighth of the half angle, at most tan(pi/16).
    sine = s
    for _ in range(3):
        h = np.sqrt(0.5 * (1.0 + c))
        s = s / (2.0 * h)
        c = h
    t = s / c
    x = t * t
    total = 0.0
    for k in range(13):
        n = 12 - k
        total = (-total) * x + 1.0 / (2 * n + 1)
    angle = 16.0 * t * total
    for i in range(3):
        r[i] = sign * v[i] / norm / sine * angle
    return r
