"""Inertia moved, turned and combined, against integrals and closed forms of solids."""

import itertools

import numpy as np
import pytest
from scipy.integrate import tplquad
from scipy.spatial.transform import Rotation

from hil.robot import inertia
from hil.robot.geometry import Body, GeometryError

DIAGONAL = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()


def integral(density, limits, about=(0.0, 0.0, 0.0)):
    """I = integral of (r.r 1 - r r^T) rho dV over a box, element by element, by quadrature."""
    I = np.zeros((3, 3))
    for i, j in itertools.product(range(3), repeat=2):

        def element(z, y, x, i=i, j=j):
            r = np.array([x, y, z]) - about
            return density * ((i == j) * (r @ r) - r[i] * r[j])

        I[i, j] = tplquad(element, *limits)[0]
    return I


def test_a_box_about_its_centre_and_about_a_corner_is_the_integral():
    size, mass = np.array([0.6, 0.4, 0.2]), 7.0
    density = mass / size.prod()
    limits = [v for s in size for v in (-s / 2, s / 2)]
    I = inertia.box(mass, size)
    assert pytest.approx(integral(density, limits), abs=1e-12) == I
    corner = I + inertia.steiner(mass, size / 2)
    # about a corner: m/3 (b^2 + c^2), products m/4 a b with the minus sign
    a, b, c = size
    assert np.diag(corner) == pytest.approx(
        mass / 3 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    )
    assert corner[0, 1] == pytest.approx(-mass / 4 * a * b)
    assert corner == pytest.approx(integral(density, limits, about=size / 2), abs=1e-12)


def test_a_cylinder_about_its_end_and_a_tube_are_the_closed_forms():
    m, r, h = 3.0, 0.2, 0.9
    end = inertia.cylinder(m, r, h) + inertia.steiner(m, [0, 0, h / 2])
    assert np.diag(end) == pytest.approx([m * r**2 / 4 + m * h**2 / 3] * 2 + [m * r**2 / 2])
    # a tube is the full cylinder less the core, at the same density
    inner = 0.15
    core = m * inner**2 / (r**2 - inner**2)
    whole = core + m
    assert inertia.cylinder(m, r, h, inner) == pytest.approx(
        inertia.cylinder(whole, r, h) - inertia.cylinder(core, inner, h)
    )


def test_a_sphere_about_a_tangent_is_seven_fifths():
    m, r = 2.0, 0.3
    I = inertia.sphere(m, r) + inertia.steiner(m, [r, 0, 0])
    assert np.diag(I) == pytest.approx([0.4 * m * r**2, 1.4 * m * r**2, 1.4 * m * r**2])


def test_uneven_boxes_that_are_turned_together_are_one_turned_box():
    density, R = 800.0, DIAGONAL
    parts = []
    for low, high in ((-0.5, -0.2), (-0.2, 0.5)):
        size = np.array([0.4, 0.3, high - low])
        m = density * size.prod()
        parts.append(
            Body(m, R @ [0, 0, (low + high) / 2] + [0.1, 0.2, 0.3], inertia.turned(inertia.box(m, size), R))
        )
    both = inertia.combine(parts)
    m = density * 0.4 * 0.3
    assert both.mass == pytest.approx(m)
    assert both.com == pytest.approx([0.1, 0.2, 0.3])
    principal = m / 12 * np.array([0.3**2 + 1, 0.4**2 + 1, 0.4**2 + 0.3**2])
    assert both.inertia == pytest.approx(R @ np.diag(principal) @ R.T)


def test_a_dumbbell_shows_the_sign_of_the_products():
    # Two points of 1 kg at +-(1, 1, 0): I_xy = -integral of x y dm = -2.
    ends = [Body(1.0, np.array([s, s, 0.0]), np.zeros((3, 3))) for s in (1.0, -1.0)]
    I = inertia.combine(ends).inertia
    assert I.tolist() == [[2, -2, 0], [-2, 2, 0], [0, 0, 4]]
    assert inertia.with_positive_products([[2, 2, 0], [2, 2, 0], [0, 0, 4]]).tolist() == I.tolist()


@pytest.mark.parametrize(
    ("moments", "is_body"),
    [
        ((1, 2, 3), True),
        ((1, 2, 3.0001), False),
        ((0, 0, 0), True),
        ((0, 1, 1), True),
        ((-1e-3, 1, 1), False),
        ((0, 0, 1), False),
    ],
)
def test_the_triangle_inequality_decides_what_is_a_body(moments, is_body):
    assert inertia.physical(DIAGONAL @ np.diag(np.array(moments, float)) @ DIAGONAL.T) is is_body


def test_a_tensor_about_another_point_comes_home():
    m, com, point = 12.0, np.array([0.1, -0.2, 0.4]), np.array([-0.3, 0.1, 0.0])
    own = DIAGONAL @ np.diag([0.5, 0.6, 0.8]) @ DIAGONAL.T
    x, y, z = com - point
    there = own + m * np.array(
        [[y * y + z * z, -x * y, -x * z], [-x * y, x * x + z * z, -y * z], [-x * z, -y * z, x * x + y * y]]
    )
    assert inertia.about_centre_of_mass("I", m, com, there, point) == pytest.approx(own, abs=1e-13)
    assert inertia.about_centre_of_mass("I", m, com, own).tolist() == own.tolist()


ROD = np.eye(3) - np.ones((3, 3)) / 3
"""A thin rod along (1, 1, 1), I = m l^2/12 (1 - n n^T): with flipped products it is no body."""


@pytest.mark.parametrize(
    ("com", "tensor", "point", "reason"),
    [
        ([0.0, 0.0, 1.0], np.diag([0.5, 0.6, 0.8]), [0.0, 0.0, 0.0], "centre of mass already"),
        ([0.0, 0.0, 0.0], inertia.with_positive_products(ROD), None, "other sign of the products"),
        ([0.0, 0.0, 0.0], [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], None, "a symmetric matrix"),
    ],
    ids=["moved twice", "wrong sign of products", "unsymmetric"],
)
def test_a_tensor_of_no_body_is_refused_with_the_reason(com, tensor, point, reason):
    assert inertia.physical(ROD)
    with pytest.raises(GeometryError, match=reason) as caught:
        inertia.about_centre_of_mass("I", 12.0, com, tensor, point)
    assert caught.value.where == "I"
