"""A platform is checked once, carries its values in errors, and cannot be changed."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ModelError
from hil.robot.geometry import GeometryError, Platform

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
def test_a_platform_survives_the_round_trip(name):
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
def test_an_impossible_platform_is_refused_with_key_and_value(path, value):
    with pytest.raises(GeometryError) as caught:
        Platform.from_dict(changed(path, value))
    assert isinstance(caught.value, ModelError)
    assert caught.value.where == path
    assert str(caught.value.value) in str(caught.value)


@pytest.mark.parametrize("leg", [0, 4])
def test_coincident_legs_are_refused_by_number(leg):
    d = copy.deepcopy(BOOK)
    for joints in ("base_joints", "platform_joints"):
        d[joints][leg + 1] = d[joints][leg]
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
