"""3D view of a row: both poses, and each leg from its base joint to its platform joint."""

from __future__ import annotations

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp
from scipy.spatial.transform import Rotation

from drivers.tick_columns import ROW
from hil.record import Scene
from hil.record.scene import SceneDrawer, quaternion, transforms

ANGLES = np.deg2rad([0, 50, 120, 170, 240, 290])
BASE = np.column_stack([2.0 * np.cos(ANGLES), 2.0 * np.sin(ANGLES), 0.1 * np.arange(6)])
PLATFORM = np.column_stack([np.cos(ANGLES + 0.3), np.sin(ANGLES + 0.3), -0.05 * np.arange(6)])
HERE, THERE = Rotation.from_rotvec([0.3, -0.2, 0.5]), Rotation.from_rotvec([-0.1, 0.4, -0.6])


@pytest.fixture
def row():
    row = np.zeros((), ROW)
    row["p"], row["p_d"] = [0.1, -0.2, 1.5], [0.4, 0.5, 1.2]
    row["R"], row["R_d"] = (each.as_matrix().reshape(row["R"].shape) for each in (HERE, THERE))
    return row


def xyz(vector):
    return [vector.x, vector.y, vector.z]


def drawn(base, platform, row, stamp=Timestamp()):  # noqa: B008 - not changed
    """Drawn entities of a row."""
    data = SceneDrawer(Scene(base.tolist(), platform.tolist())).update(row, stamp)
    assert data is not None
    return {e.id: e for e in SceneUpdate.FromString(data).entities}


def frames_of(row):
    return [FrameTransform.FromString(each).child_frame_id for each in transforms(row, Timestamp())]


def test_platform_and_reference_are_drawn_at_their_own_poses(row):
    found = {t.child_frame_id: t for t in map(FrameTransform.FromString, transforms(row, Timestamp()))}
    assert list(found) == ["platform", "reference"]
    for name, p, R in (("platform", row["p"], HERE), ("reference", row["p_d"], THERE)):
        there = found[name]
        assert xyz(there.translation) == p.tolist()
        turned = Rotation.from_quat([*xyz(there.rotation), there.rotation.w])
        assert (turned * R.inv()).magnitude() < 1e-12


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_pose_that_is_not_finite_is_not_drawn(row, wrong):
    drawer = SceneDrawer(Scene(BASE.tolist(), PLATFORM.tolist()))
    places = [(name, k) for name in ("p", "R", "p_d", "R_d") for k in range(row[name].size)]
    for name, k in places:
        bad = row.copy()
        bad[name].reshape(-1)[k] = wrong
        assert frames_of(bad) == (["platform"] if name.endswith("_d") else ["reference"]), (name, k)
        assert (drawer.update(bad, Timestamp()) is not None) is name.endswith("_d")
    assert len(places) == 24


@pytest.mark.parametrize(("R", "other"), [("R", "reference"), ("R_d", "platform")])
def test_a_pose_of_zeros_is_not_drawn(row, R, other):
    row[R] = 0.0
    assert frames_of(row) == [other]


def test_all_entities_are_locked_to_the_base_frame(row):
    """Viewers move locked entities with their frame."""
    stamp = Timestamp(seconds=7, nanos=5)
    entities = drawn(BASE, PLATFORM, row, stamp)
    found = [(name, e.frame_id, e.frame_locked, e.timestamp) for name, e in entities.items()]
    assert found == [(name, "base", True, stamp) for name in ("base", "platform", "legs")]
    moved = [FrameTransform.FromString(each) for each in transforms(row, stamp)]
    assert [(t.parent_frame_id, t.child_frame_id, t.timestamp) for t in moved] == [
        ("base", "platform", stamp),
        ("base", "reference", stamp),
    ]


def test_each_leg_is_a_line_from_its_base_joint_to_its_platform_joint(row):
    (legs,) = drawn(BASE, PLATFORM, row)["legs"].lines
    points = np.array([xyz(each) for each in legs.points])
    np.testing.assert_allclose(points[::2], BASE, atol=1e-12)
    np.testing.assert_allclose(points[1::2], row["p"] + HERE.apply(PLATFORM), atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("largest", range(4))
def test_a_quaternion_is_exact_whichever_component_is_largest(largest, sign):
    q = np.array([0.1, -0.2, 0.3, 0.25])
    q[largest] = 2.0 * sign
    q /= np.linalg.norm(q)
    expected = q if q[3] >= 0.0 else -q
    np.testing.assert_allclose(quaternion(Rotation.from_quat(q).as_matrix()), expected, atol=1e-15)
    half = np.zeros(4)
    half[largest] = 1.0
    np.testing.assert_allclose(quaternion(Rotation.from_quat(half).as_matrix()), half, atol=1e-15)
