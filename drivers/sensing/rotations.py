"""Rotations of sensors, compiled: rotation vectors and matrices."""

from math import atan2, sin, sqrt

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import helper

_SMALL = 1e-4
"""rad: below it the second term of a series is less than the last bit."""


@helper
def turn(r: Array, R: Array) -> Array:
    """exp([r]x) R by Rodrigues' formula; r (3,) rad."""
    angle = sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    if angle < _SMALL:
        a, b = 1.0 - angle * angle / 6.0, 0.5 - angle * angle / 24.0
    else:
        half = sin(0.5 * angle) / angle
        a, b = sin(angle) / angle, 2.0 * half * half
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


@helper
def rotation_vector_of(r: Array, R: Array) -> Array:
    """Rotation vector (3,) rad of exp([r]x) R, norm <= pi, from its quaternion, largest component first."""
    M = turn(r, R)
    trace = M[0, 0] + M[1, 1] + M[2, 2]
    q = np.empty(4)
    i = 0
    for k in range(1, 3):
        if M[k, k] > M[i, i]:
            i = k
    if trace > M[i, i]:
        q[3] = 1.0 + trace
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            q[k] = M[b, a] - M[a, b]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 - trace + 2.0 * M[i, i]
        q[j], q[k] = M[j, i] + M[i, j], M[k, i] + M[i, k]
        q[3] = M[k, j] - M[j, k]
    if q[3] < 0.0:
        q *= -1.0
    sine = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    scale = 2.0 / q[3] if sine < _SMALL * _SMALL * q[3] else 2.0 * atan2(sine, q[3]) / sine
    return scale * q[:3]
