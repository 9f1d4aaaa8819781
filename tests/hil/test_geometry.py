"""Platforms, joints and inertia: round trips, closed forms of circles and solids, and refusals."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import ModelError
from hil.record.scene import around
from hil.robot import inertia, joints
from hil.robot.geometry import Body, GeometryError, Platform

DATA = Path(__file__).parents[1] / "data"
BOOK = json.loads((DATA / "book_platform.json").read_text())["geometry"]
GEOMETRIES = json.loads((DATA / "rigid_body_cases.json").read_text())["geometries"]


def changed(path, value):
    d = copy.deepcopy(BOOK)
    *outer, last = path.split(".")
    section = d
    for key in outer:
        section = section[key]
    section[last] = value
    return d


@pytest.mark.parametrize("name", GEOMETRIES)
def test_platform_survives_the_round_trip(name):
    platform = Platform.from_dict(GEOMETRIES[name])
    again = Platform.from_dict(json.loads(json.dumps(platform.to_dict())))
    assert again.to_dict() == platform.to_dict()
    for key in ("base_joints", "platform_joints", "cylinder", "rod", "gravity"):
        assert again.to_dict()[key] == GEOMETRIES[name][key]


def test_arrays_are_private_and_read_only():
    joints = np.array(BOOK["base_joints"])
    platform = Platform.from_dict(changed("base_joints", joints))
    joints[0, 0] = 99.0
    assert platform.base_joints[0, 0] == 2.0
    for array in (platform.base_joints, platform.gravity, platform.platform.inertia):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("platform.mass", 0.0),
        ("platform.mass", float("nan")),
        ("platform.mass", "heavy"),
        ("platform.com", [0.0, 0.0]),
        ("platform.inertia", [[571.0, 0, 0], [0, 285, 0], [0, 0, 285]]),
        ("platform.inertia", [[570.0, 1, 0], [0, 285, 0], [0, 0, 285]]),
        ("platform.inertia", [[570.0, 0, 0], [0, -285, 0], [0, 0, 285]]),
        ("rod.mass", -1.0),
        ("rod.inertia_transverse", float("inf")),
        ("cylinder.inertia_axial", 33.0),
        ("gravity", [0.0, 0.0, float("nan")]),
        ("base_joints", BOOK["base_joints"][:5]),
        ("universal_joint_base_axes", [[0.0, 0.0, 0.0]] * 6),
    ],
)
def test_impossible_platform_is_refused_with_key_and_value(path, value):
    with pytest.raises(GeometryError) as caught:
        Platform.from_dict(changed(path, value))
    assert isinstance(caught.value, ModelError)
    assert caught.value.where == path
    assert str(caught.value.value) in str(caught.value)


@pytest.mark.parametrize("leg", [0, 4])
def test_coincident_legs_are_refused_by_number(leg):
    d = copy.deepcopy(BOOK)
    for key in ("base_joints", "platform_joints"):
        d[key][leg + 1] = d[key][leg]
    with pytest.raises(GeometryError, match=f"legs {leg} and {leg + 1} with both joints"):
        Platform.from_dict(d)


def test_joints_on_a_line_are_refused():
    with pytest.raises(GeometryError, match="one line"):
        Platform.from_dict(changed("base_joints", [[k, 2 * k, 0] for k in range(6)]))


def test_missing_and_unknown_keys_are_listed():
    d = copy.deepcopy(BOOK)
    del d["rod"]["mass"]
    for given, name in ((d, r"rod\.mass"), (changed("platform.weight", 3.0), "weight")):
        with pytest.raises(GeometryError, match=name):
            Platform.from_dict(given)


def test_book_base_is_a_hexagon_of_radius_two():
    base = joints.on_circle(2.0, [0, 60, 120, 180, 240, 300])
    assert base == pytest.approx(np.array(BOOK["base_joints"]), abs=2e-15)


def test_book_platform_is_a_triangle_with_two_legs_at_each_corner():
    expected = np.array(BOOK["platform_joints"])
    assert joints.in_pairs(1.0, [30, 150, 270], 0.0) == pytest.approx(expected, abs=2e-15)
    assert joints.on_circle(1.0, [30, 30, 150, 150, 270, 270]) == pytest.approx(expected, abs=2e-15)


def test_pairs_by_half_angle_are_at_their_angles():
    spacing = joints.chord(0.75, 10.0)
    assert spacing == pytest.approx(2 * 0.75 * np.sin(np.deg2rad(10)), abs=1e-15)
    found = joints.in_pairs(0.75, [0, 120, 240], spacing, -0.1)
    angles = np.deg2rad([-10, 10, 110, 130, 230, 250])
    expected = np.stack([0.75 * np.cos(angles), 0.75 * np.sin(angles), np.full(6, -0.1)], axis=1)
    assert found == pytest.approx(expected, abs=1e-15)


def test_pairs_that_begin_with_the_second_leg_are_shifted_by_one():
    found = joints.in_pairs(0.6, [60, 180, 300], joints.chord(0.6, 10.0), begin="second_leg")
    z = found[:, 0] + 1j * found[:, 1]
    assert np.rad2deg(np.angle(z)) % 360 == pytest.approx([310, 50, 70, 170, 190, 290])


WALL = Rotation.from_rotvec([np.pi / 2, 0.0, 0.0]).as_matrix()
SIDE = Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).as_matrix()
SLANTED = Rotation.from_rotvec([0.0, 0.0, np.pi / 4]).as_matrix() @ WALL


@pytest.mark.parametrize("wide", [1.0, 0.05])
@pytest.mark.parametrize(
    "turn", [np.eye(3), WALL, SIDE, SLANTED, Rotation.from_rotvec([1, 2, -1]).as_matrix()]
)
def test_joints_of_a_ring_are_ordered_in_any_plane(turn, wide):
    """The legs are shuffled; first corner and direction are arbitrary."""
    ring = joints.on_circle(2.0, [10, 50, 120, 170, 240, 290]) * [1.0, wide, 1.0]
    mixed = np.array([3, 0, 5, 1, 4, 2])
    order = mixed[around(ring[mixed] @ turn.T + [3.0, -1.0, 2.0])]
    steps = np.diff(order, append=order[0]) % 6
    assert steps.tolist() in ([1] * 6, [5] * 6)


def test_joints_of_a_level_ring_are_ordered_from_x_towards_y():
    ring = joints.on_circle(2.0, [170, 10, -120, 50, 120, -70])
    assert around(ring).tolist() == [2, 5, 1, 3, 4, 0]


DIAGONAL = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()


def test_inertia_of_a_box_about_a_corner_has_the_closed_form():
    size, mass = np.array([0.6, 0.4, 0.2]), 7.0
    corner = inertia.box(mass, size) + inertia.steiner(mass, size / 2)
    # about a corner: m/3 (b^2 + c^2), products m/4 a b with the minus sign
    a, b, c = size
    assert np.diag(corner) == pytest.approx(
        mass / 3 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    )
    assert corner[0, 1] == pytest.approx(-mass / 4 * a * b)


def test_inertia_of_a_cylinder_and_of_a_tube_has_the_closed_form():
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


def test_inertia_of_a_sphere_about_a_tangent_is_seven_fifths():
    m, r = 2.0, 0.3
    I = inertia.sphere(m, r) + inertia.steiner(m, [r, 0, 0])
    assert np.diag(I) == pytest.approx([0.4 * m * r**2, 1.4 * m * r**2, 1.4 * m * r**2])


def test_two_rotated_boxes_combine_to_one_rotated_box():
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


def test_products_of_inertia_of_a_dumbbell_have_the_right_sign():
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
def test_moments_of_a_body_satisfy_the_triangle_inequality(moments, is_body):
    assert inertia.physical(DIAGONAL @ np.diag(np.array(moments, float)) @ DIAGONAL.T) is is_body


def test_tensor_about_another_point_is_moved_to_the_centre_of_mass():
    m, com, point = 12.0, np.array([0.1, -0.2, 0.4]), np.array([-0.3, 0.1, 0.0])
    own = DIAGONAL @ np.diag([0.5, 0.6, 0.8]) @ DIAGONAL.T
    x, y, z = com - point
    there = own + m * np.array(
        [[y * y + z * z, -x * y, -x * z], [-x * y, x * x + z * z, -y * z], [-x * z, -y * z, x * x + y * y]]
    )
    assert inertia.about_centre_of_mass("I", m, com, there, point) == pytest.approx(own, abs=1e-13)
    assert inertia.about_centre_of_mass("I", m, com, own).tolist() == own.tolist()


ROD = np.eye(3) - np.ones((3, 3)) / 3
"""A thin rod along (1, 1, 1), I = m l^2/12 (1 - n n^T); not physical with flipped products."""


@pytest.mark.parametrize(
    ("com", "tensor", "point", "reason"),
    [
        ([0.0, 0.0, 1.0], np.diag([0.5, 0.6, 0.8]), [0.0, 0.0, 0.0], "centre of mass already"),
        ([0.0, 0.0, 0.0], inertia.with_positive_products(ROD), None, "other sign of the products"),
        ([0.0, 0.0, 0.0], [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], None, "a symmetric matrix"),
    ],
    ids=["moved twice", "wrong sign of products", "unsymmetric"],
)
def test_unphysical_tensor_is_refused_with_the_reason(com, tensor, point, reason):
    assert inertia.physical(ROD)
    with pytest.raises(GeometryError, match=reason) as caught:
        inertia.about_centre_of_mass("I", 12.0, com, tensor, point)
    assert caught.value.where == "I"
