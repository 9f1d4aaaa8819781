"""Invalid poses, motions and drives are refused with their names and values."""

import json
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from drivers.errors import ModelError
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
HOME = (np.array([0.0, 0.0, 1.0]), np.eye(3))
ANGLES = np.radians([0, 60, 120, 180, 240, 300])
HEXAGON = np.column_stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES])
SIMILAR = Platform.from_dict({**BOOK, "base_joints": 2 * HEXAGON, "platform_joints": HEXAGON})
SINGULAR = (np.array([0.0, 0.0, 1.0]), rotation_from_vector(np.array([0.0, 0.0, np.pi / 2])))
"""A platform rotated by 90 degrees about z over a similar base (Fichter, 1986)."""

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
def test_an_invalid_pose_is_refused_with_its_name_and_value(name, p, R, named):
    with pytest.raises(KinematicsError) as caught:
        OF_A_POSE[name](p, R)
    carried: Any = caught.value.values[named]
    assert np.array_equal(carried, p if named == "p" else R, equal_nan=True)
    assert str(caught.value).startswith(named)


@pytest.mark.parametrize(("find", "further"), [(forward_kinematics, 0.0), (continue_kinematics, 1e-3)])
def test_a_singular_pose_is_refused_with_its_values(find, further):
    with pytest.raises(KinematicsError, match="singular") as bound:
        Model(SIMILAR).inverse_dynamics(*SINGULAR, REST, REST)
    assert cast("float", bound.value.values["condition"]) > 1e12
    q = leg_lengths(SIMILAR, *SINGULAR) + further * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    with pytest.raises(KinematicsError, match=r"singular|reach") as caught:
        find(SIMILAR, q, *SINGULAR)
    assert caught.value.values["q"] == pytest.approx(q)
    assert caught.value.values["p"] == pytest.approx(SINGULAR[0])


def test_a_leg_of_length_zero_is_refused():
    p = PLATFORM.base_joints[0] - PLATFORM.platform_joints[0]
    for ask in (
        lambda: jacobian(PLATFORM, p, np.eye(3)),
        lambda: MODEL.mass_matrix(p, np.eye(3)),
        lambda: MODEL.inverse_dynamics(p, np.eye(3), REST, REST),
        lambda: MODEL.forward_dynamics(p, np.eye(3), REST, REST),
    ):
        with pytest.raises(KinematicsError, match=r"length zero|singular") as caught:
            ask()
        assert caught.value.values["p"] == pytest.approx(p)


@pytest.mark.parametrize(
    ("q", "p", "R", "named"),
    [
        ([1.6] * 5 + [np.nan], HOME[0], HOME[1], "q"),
        ([1.6] * 5 + [-1.6], HOME[0], HOME[1], "q"),
        ([1.6] * 5, HOME[0], HOME[1], "q"),
        ([1.6] * 6, [0.0, np.inf, 1.0], HOME[1], "p0"),
        ([1.6] * 6, HOME[0], 2 * HOME[1], "R"),
        ([1.6] * 6, HOME[0], "turned", "R"),
        ([1.0] * 5 + [9.0], HOME[0], HOME[1], "q"),
    ],
)
@pytest.mark.parametrize("find", [forward_kinematics, continue_kinematics])
def test_leg_lengths_that_fit_no_pose_are_refused_with_their_values(find, q, p, R, named):
    with pytest.raises(KinematicsError) as caught:
        find(PLATFORM, q, p, R)
    assert named in caught.value.values


@pytest.mark.parametrize("bad", [np.full(6, np.nan), np.zeros(5), ["x"] * 6])
def test_arguments_that_are_not_six_numbers_are_refused(bad):
    for call, name in (
        (lambda: MODEL.inverse_dynamics(*HOME, bad, REST), "twist"),
        (lambda: MODEL.forward_dynamics(*HOME, REST, bad), "tau"),
        (lambda: MODEL.inverse_dynamics(*HOME, REST, REST, bad), "wrench"),
        (lambda: MODEL.friction(bad), "dq"),
    ):
        with pytest.raises(KinematicsError, match=name):
            call()


BAD_DRIVES = [-1.0, float("nan"), [1.0] * 5, "much", [1.0, 1.0, -1.0, 1.0, 1.0, 1.0]]


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("variant", "exact"),
        ("variant", "constant"),
        ("leg_spin", "some"),
        ("leg_spin", "universal"),
        ("inertia_scale", float("nan")),
        *(
            (name, bad)
            for name in ("reflected_mass", "viscous", "coulomb", "sliding_speed")
            for bad in BAD_DRIVES
        ),
    ],
)
def test_invalid_settings_are_refused_by_name(name, bad):
    needed = {("variant", "constant"): "frozen_at", ("leg_spin", "universal"): "universal_joint_base_axes"}
    with pytest.raises(ModelError, match=needed.get((name, str(bad)), name)):
        Model(PLATFORM, **{name: bad})


def test_the_constants_of_a_model_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        MODEL.constants[0] = 1.0
