"""Mass, centre of mass and inertia of rigid bodies: parallel axes, rotation, simple shapes, combination.

Sums are written out, as in hil.mathematics.linear_algebra: the last bit of BLAS results depends on the
processor. An inertia tensor is always the matrix of the equations of motion, I = integral of (r.r 1 - r r^T)
dm, whose products of inertia have the minus sign.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from hil.robot.geometry import TOLERANCE, Body, GeometryError


def product(A: Array, B: Array) -> Array:
    """Product A B of 3x3 matrices, summed in a fixed order so that all processors round alike."""
    return A[:, 0:1] * B[0:1] + A[:, 1:2] * B[1:2] + A[:, 2:3] * B[2:3]


def turned(inertia: ArrayLike, R: ArrayLike) -> Array:
    """Inertia (3, 3) kg m^2 about the same point in turned axes: R I R^T.

    inertia : (3, 3) kg m^2, in its own axes.
    R : (3, 3), x_new = R x_own.
    """
    turn = np.asarray(R, np.float64)
    I = product(product(turn, np.asarray(inertia, np.float64)), turn.T)
    return (I + I.T) / 2


def steiner(mass: float, d: ArrayLike) -> Array:
    """Parallel-axis term m (d.d 1 - d d^T), (3, 3) kg m^2 (Steiner 1840).

    Inertia about a point at the distance d (3,) m from the centre of mass is the inertia about the centre of
    mass plus this term.
    """
    x, y, z = (float(v) for v in np.asarray(d, np.float64))
    return mass * np.array(
        [[y * y + z * z, -x * y, -x * z], [-x * y, x * x + z * z, -y * z], [-x * z, -y * z, x * x + y * y]]
    )


def with_positive_products(inertia: ArrayLike) -> Array:
    """Inertia tensor (3, 3) kg m^2 from a table that lists the products of inertia as +integral of x y dm."""
    table = np.asarray(inertia, np.float64)
    return np.where(np.eye(3, dtype=bool), table, -table)


def box(mass: float, size: ArrayLike) -> Array:
    """Inertia (3, 3) kg m^2 of a homogeneous box, size (a, b, c) m, about its centre: m/12 (b^2 + c^2) .."""
    a, b, c = (float(v) ** 2 for v in np.asarray(size, np.float64))
    return np.diag([b + c, a + c, a + b]) * (mass / 12)


def cylinder(mass: float, radius: float, length: float, inner_radius: float = 0.0) -> Array:
    """Inertia (3, 3) kg m^2 of a homogeneous cylinder or tube along z about its centre.

    I_z = m/2 (R^2 + r^2), I_x = I_y = m/12 (3 (R^2 + r^2) + h^2), r the inner radius; all in m.
    """
    squares = radius**2 + inner_radius**2
    across = (3 * squares + length**2) / 12
    return np.diag([across, across, squares / 2]) * mass


def sphere(mass: float, radius: float) -> Array:
    """Inertia (3, 3) kg m^2 of a homogeneous sphere about its centre, 2/5 m r^2; mass in kg, radius in m."""
    return np.eye(3) * (0.4 * mass * radius**2)


def combine(bodies: Sequence[Body]) -> Body:
    """Combine bodies, all in the same frame, into one rigid body.

    m = sum m_k, com = sum m_k c_k / m, I = sum [I_k + m_k (d_k.d_k 1 - d_k d_k^T)], d_k = c_k - com.
    """
    mass = sum(body.mass for body in bodies)
    com = sum((body.mass * np.asarray(body.com, np.float64) for body in bodies), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for body in bodies:
        inertia = inertia + np.asarray(body.inertia, np.float64) + steiner(body.mass, body.com - com)
    return Body(mass, com, inertia)


def principal_moments(inertia: ArrayLike) -> tuple[float, float, float]:
    """Principal moments of an inertia (3, 3), kg m^2, ascending; not equal to the bit on all processors."""
    low, middle, high = np.linalg.eigvalsh(np.asarray(inertia, np.float64))
    return float(low), float(middle), float(high)


def physical(inertia: ArrayLike) -> bool:
    """Check that a body can have this inertia (3, 3) about its centre of mass: 0 <= I_1, I_3 <= I_1 + I_2.

    A point (three zeros) and a thin rod (one zero) count as bodies; relative tolerance 1e-9.
    """
    low, middle, high = principal_moments(inertia)
    return low >= -TOLERANCE * abs(high) and low + middle >= high * (1 - TOLERANCE)


def about_centre_of_mass(
    where: str, mass: float, com: ArrayLike, inertia: ArrayLike, point: ArrayLike | None = None
) -> Array:
    """Inertia about the centre of mass, checked, from the inertia about `point`: I - m (d.d 1 - d d^T).

    where: name of the tensor in messages; mass in kg; com, point: (3,) m in the axes of the tensor. Without
    `point` the tensor is already about the centre of mass.
    inertia : (3, 3) kg m^2

    Raises GeometryError if the tensor is not symmetric or not physical. The message states the principal
    moments about the centre of mass, and whether products of the other sign would be physical.
    """
    I = np.asarray(inertia, np.float64)
    if float(np.abs(I - I.T).max()) > TOLERANCE * float(np.abs(I).max()):
        raise GeometryError(where, I.tolist(), "a symmetric matrix")
    move = np.zeros((3, 3)) if point is None else steiner(mass, np.subtract(com, point))
    moved = I - move
    if physical(moved):
        return moved
    low, middle, high = principal_moments(moved)
    given = f"principal moments {low:.9g}, {middle:.9g}, {high:.9g} kg m^2"
    if point is not None:
        given += f" after the move from {np.asarray(point).tolist()} to the centre of mass"
    allowed = "the largest at most the sum of the other two, as for every rigid body"
    if low < 0:
        allowed = "three values >= 0" + (
            "; check whether the tensor is about the centre of mass already" if point is not None else ""
        )
    if physical(with_positive_products(I) - move):
        allowed += "; the tensor is valid with the other sign of the products of inertia (key products)"
    raise GeometryError(where, given, allowed)
