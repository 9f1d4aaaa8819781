"""Joints from radii and angles, and the order round a ring."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.robot import joints
from hil.robot.around import around

BOOK = json.loads((Path(__file__).parents[1] / "data/book_platform.json").read_text())["geometry"]


def test_the_books_base_is_a_hexagon_of_radius_two():
    base = joints.on_circle(2.0, [0, 60, 120, 180, 240, 300])
    assert base == pytest.approx(np.array(BOOK["base_joints"]), abs=2e-15)


def test_the_books_platform_is_a_triangle_with_two_legs_a_corner():
    expected = np.array(BOOK["platform_joints"])
    assert joints.in_pairs(1.0, [30, 150, 270], 0.0) == pytest.approx(expected, abs=2e-15)
    assert joints.on_circle(1.0, [30, 30, 150, 150, 270, 270]) == pytest.approx(expected, abs=2e-15)


def test_pairs_by_half_angle_stand_at_their_angles():
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
def test_a_ring_is_gone_round_in_its_own_plane_whichever_that_is(turn, wide):
    """Leg order mixed up; a ring has no first corner and no direction."""
    ring = joints.on_circle(2.0, [10, 50, 120, 170, 240, 290]) * [1.0, wide, 1.0]
    mixed = np.array([3, 0, 5, 1, 4, 2])
    order = mixed[around(ring[mixed] @ turn.T + [3.0, -1.0, 2.0])]
    steps = np.diff(order, append=order[0]) % 6
    assert steps.tolist() in ([1] * 6, [5] * 6)


def test_a_level_ring_is_gone_round_from_x_towards_y():
    ring = joints.on_circle(2.0, [170, 10, -120, 50, 120, -70])
    assert around(ring).tolist() == [2, 5, 1, 3, 4, 0]
