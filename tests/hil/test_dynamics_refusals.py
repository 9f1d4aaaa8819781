"""Poses and motions without meaning end in a named error that carries their values, in every function."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import (
    KinematicsError,
    condition,
    continue_kinematics,
    forward_kinematics,
    jacobian,
    jacobian_rate,
    leg_lengths,
)

BOOK = json.loads((Path(__file__).parents[1] / "data" / "book_platform.json").read_text())["geometry"]
PLATFORM = Platform.from_dict(BOOK)
MODEL = Model(PLATFORM)
REST = np.zeros(6)
ANGLES = np.radians([0, 60, 120, 180, 240, 300])
HEXAGON = np.column_stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES])
SIMILAR = Platform.from_dict({**BOOK, "base_joints": 2 * HEXAGON, "platform_joints": HEXAGON})
SINGULAR = (np.array([0.0, 0.0, 1.0]), rotation_from_vector(np.array([0.0, 0.0, np.pi / 2])))
"""A platform turned by 90 degrees about z over a similar base (Fichter, 1986)."""

OF_A_POSE = {
    "leg_lengths": lambda p, R: leg_lengths(PLATFORM, p, R),
    "jacobian": lambda p, R: jacobian(PLATFORM, p, R),
    "jacobian_rate": lambda p, R: jacobian_rate(PLATFORM, p, R, REST),
    "condition": lambda p, R: condition(PLATFORM, p, R),
    "mass_matrix": MODEL.mass_matrix,
    "coriolis": lambda p, R: MODEL.coriolis(p, R, REST),
    "gravity": MODEL.gravity,
    "inverse_dynamics": lambda p, R: MODEL.inverse_dynamics(p, R, REST, REST),
    "forward_dynamics": lambda p, R: MODEL.forward_dynamics(p, R, REST, REST),
    "kinetic_energy": lambda p, R: MODEL.kinetic_energy(p, R, REST),
    "potential_energy": MODEL.potential_energy,
    "frozen_at": lambda p, R: Model(PLATFORM, "constant", frozen_at=(p, R)),
}


@pytest.mark.parametrize("name", OF_A_POSE)
@pytest.mark.parametrize(
    ("p", "R", "named"),
    [
        ([0.0, np.nan, 1.0], np.eye(3), "p"),
        ([0.0, 0.0, np.inf], np.eye(3), "p"),
        ([0.0, 0.0], np.eye(3), "p"),
        ([0.0, 0.0, 1.0], np.full((3, 3), np.nan), "R"),
        ([0.0, 0.0, 1.0], 1.001 * np.eye(3), "R"),
        ([0.0, 0.0, 1.0], np.diag([1.0, 1.0, -1.0]), "R"),
        ([0.0, 0.0, 1.0], np.eye(4), "R"),
    ],
    ids=["nan", "infinite", "two numbers", "nan rotation", "scaled", "reflection", "4x4"],
)
def test_a_pose_without_meaning_is_named_with_its_value(name, p, R, named):
    with pytest.raises(KinematicsError) as caught:
        OF_A_POSE[name](p, R)
    carried: Any = caught.value.values[named]
    assert np.array_equal(carried, p if named == "p" else R, equal_nan=True)
    assert str(caught.value).startswith(named)


@pytest.mark.parametrize(("find", "further"), [(forward_kinematics, 0.0), (continue_kinematics, 1e-3)])
def test_forward_kinematics_at_a_singular_pose_is_named_with_its_values(find, further):
    q = leg_lengths(SIMILAR, *SINGULAR) + further * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    with pytest.raises(KinematicsError, match=r"singular|reach") as caught:
        find(SIMILAR, q, *SINGULAR)
    assert caught.value.values["q"] == pytest.approx(q)
    assert caught.value.values["p"] == pytest.approx(SINGULAR[0])


def test_a_leg_of_length_zero_has_no_dynamics():
    p = PLATFORM.base_joints[0] - PLATFORM.platform_joints[0]
    for ask in (
        lambda: MODEL.mass_matrix(p, np.eye(3)),
        lambda: MODEL.inverse_dynamics(p, np.eye(3), REST, REST),
        lambda: MODEL.forward_dynamics(p, np.eye(3), REST, REST),
    ):
        with pytest.raises(KinematicsError, match=r"length zero|singular") as caught:
            ask()
        assert caught.value.values["p"] == pytest.approx(p)
