"""Poses by roll, pitch and yaw against SciPy's Rotation, in each section with a rotation."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from hil.app.configuration.configuration import loads
from hil.config.platform import Frame, InertiaReference
from hil.config.reference import Waypoint
from hil.config.values import Pose
from tests.hil.app.texts import edited

TURNS = [
    (0, 0, 0), (30, 0, 0), (0, 30, 0), (0, 0, 30), (10, -20, 30), (-170, 80, 95), (1e-9, 0, -1e-9), (0, 0, 350),
    (25, 90, -40), (25, -90, -40), (25, 89.9999999, 10), (180, 0, 0), (0, 120, 0), (200, 200, 200),
]  # fmt: skip


@pytest.mark.parametrize("turn", TURNS, ids=str)
def test_roll_pitch_and_yaw_give_the_rotation_of_scipy(turn):
    """R = Rz(yaw) Ry(pitch) Rx(roll); at a pitch of 90 deg, too, the rotation is one."""
    vector = Pose(position_m=(0, 0, 1), roll_pitch_yaw_deg=turn).rotation_vector_deg
    assert np.linalg.norm(vector) <= 180 * (1 + 1e-12)
    expected = Rotation.from_euler("ZYX", turn[::-1], degrees=True)
    found = Rotation.from_rotvec(vector, degrees=True)
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=1e-14)
    again = found.as_euler("ZYX", degrees=True)[::-1] if abs(np.cos(np.deg2rad(turn[1]))) > 1e-3 else turn
    if max(map(abs, turn)) < 90:
        np.testing.assert_allclose(again, turn, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("section", "more"),
    [(Pose, {"position_m": (0, 0, 1)}), (Waypoint, {"position_m": (0, 0, 1), "t_s": 1}), (Frame, {}), (InertiaReference, {})],
)  # fmt: skip
def test_rotation_is_configured_either_as_vector_or_as_roll_pitch_yaw_but_not_both(section, more):
    of_vector = section(**more, rotation_vector_deg=(0, 0, 20))
    of_angles = section(**more, roll_pitch_yaw_deg=(0, 0, 20))
    np.testing.assert_allclose(of_angles.rotation_vector_deg, (0, 0, 20), rtol=1e-15)
    assert of_angles.model_dump().keys() == of_vector.model_dump().keys(), "files of the robot stay valid"
    assert section.model_validate(of_angles.model_dump()) == of_angles
    with pytest.raises(ValidationError, match="either rotation_vector_deg or roll_pitch_yaw_deg"):
        section(**more, rotation_vector_deg=(0, 0, 0), roll_pitch_yaw_deg=(0, 0, 20))
    with pytest.raises(ValidationError, match="finite"):
        section(**more, roll_pitch_yaw_deg=(0, 0, float("inf")))


def test_home_pose_in_a_configuration_may_be_given_by_roll_pitch_and_yaw():
    home = "    rotation_vector_deg: [0, 0, 0]\n  # The book"
    c = loads(
        edited((home, home.replace("rotation_vector_deg: [0, 0, 0]", "roll_pitch_yaw_deg: [2, 3, -4]"))),
        "mine.yaml",
    )
    expected = Rotation.from_euler("ZYX", [-4, 3, 2], degrees=True).as_rotvec(degrees=True)
    np.testing.assert_allclose(c.platform.home.rotation_vector_deg, expected, rtol=1e-12)
