"""Algebra of 3-vectors as tuples of numbers, which the compiler keeps in registers."""

from drivers.arrays import Array
from drivers.compiled.compiler import helper

Vector = tuple[float, float, float]


@helper
def at(x: Array, k: int) -> Vector:
    """Elements k, k + 1 and k + 2 of an array, as a vector."""
    return x[k], x[k + 1], x[k + 2]


@helper
def row(A: Array, i: int) -> Vector:
    """Row i of an (n, 3) array, as a vector."""
    return A[i, 0], A[i, 1], A[i, 2]


@helper
def add(u: Vector, v: Vector) -> Vector:
    """Sum u + v of two vectors."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@helper
def sub(u: Vector, v: Vector) -> Vector:
    """Difference u - v of two vectors."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@helper
def scale(k: float, u: Vector) -> Vector:
    """Product k u of a number and a vector."""
    return k * u[0], k * u[1], k * u[2]


@helper
def dot(u: Vector, v: Vector) -> float:
    """Scalar product u . v."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@helper
def cross(u: Vector, v: Vector) -> Vector:
    """Vector product u x v."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@helper
def rotate(R: Array, x: Vector) -> Vector:
    """Product R x of a 3x3 matrix and a vector."""
    return (
        R[0, 0] * x[0] + R[0, 1] * x[1] + R[0, 2] * x[2],
        R[1, 0] * x[0] + R[1, 1] * x[1] + R[1, 2] * x[2],
        R[2, 0] * x[0] + R[2, 1] * x[1] + R[2, 2] * x[2],
    )


@helper
def rotate_back(R: Array, x: Vector) -> Vector:
    """Product R^T x of a transposed 3x3 matrix and a vector."""
    return (
        R[0, 0] * x[0] + R[1, 0] * x[1] + R[2, 0] * x[2],
        R[0, 1] * x[0] + R[1, 1] * x[1] + R[2, 1] * x[2],
        R[0, 2] * x[0] + R[1, 2] * x[1] + R[2, 2] * x[2],
    )
