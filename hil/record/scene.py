"""The moving platform for 3D views: foxglove.FrameTransform and foxglove.SceneUpdate from rows.

Pictures only, at a low rate; nothing here is read back.
"""

from math import isfinite, sqrt
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from drivers.arrays import Array, Rows
from hil.record.recording import Scene
from hil.robot.around import around

BASE = "base"
_POSES = (("platform", "p", "R"), ("reference", "p_d", "R_d"))
_GREY = Color(r=0.45, g=0.48, b=0.52, a=1.0)
_BLUE = Color(r=0.12, g=0.42, b=0.71, a=1.0)
_ORANGE = Color(r=0.93, g=0.55, b=0.14, a=1.0)


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Return (x, y, z, w), w >= 0, of a rotation matrix (3, 3), by its largest component."""
    m = R.tolist()
    trace = m[0][0] + m[1][1] + m[2][2]
    squares = (m[0][0], m[1][1], m[2][2], trace)
    largest = squares.index(max(squares))
    s = 2.0 * sqrt(1.0 + (2.0 * squares[largest] - trace))
    if largest == 3:
        return (m[2][1] - m[1][2]) / s, (m[0][2] - m[2][0]) / s, (m[1][0] - m[0][1]) / s, s / 4.0
    i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
    v = [0.0, 0.0, 0.0]
    v[i], v[j], v[k] = s / 4.0, (m[i][j] + m[j][i]) / s, (m[i][k] + m[k][i]) / s
    w = (m[k][j] - m[j][k]) / s
    sign = -1.0 if w < 0.0 else 1.0
    return sign * v[0], sign * v[1], sign * v[2], sign * w


def transforms(row: Rows, stamp: Timestamp) -> list[bytes]:
    """Return the serialised FrameTransforms of one row: platform, and reference where there is one."""
    messages = []
    for name, p_column, R_column in _POSES:
        pose = _pose(row, p_column, R_column)
        if pose is None:
            continue
        p, R = pose
        p_x, p_y, p_z = p.tolist()
        x, y, z, w = quaternion(R)
        message = FrameTransform(
            timestamp=stamp,
            parent_frame_id=BASE,
            child_frame_id=name,
            translation=Vector3(x=p_x, y=p_y, z=p_z),
            rotation=Quaternion(x=x, y=y, z=z, w=w),
        )
        messages.append(message.SerializeToString(deterministic=True))
    return messages


class SceneDrawer:
    """Draws platform and legs. Mutable state: the message, in which what moves is set for each picture."""

    def __init__(self, scene: Scene) -> None:
        self._a = np.array(scene.base_joints, float)
        self._b = np.array(scene.platform_joints, float)
        base, self._top = around(self._a), around(self._b)
        self._thickness = 0.02 * float(np.linalg.norm(self._a, axis=1).max())
        self._update = SceneUpdate(
            entities=[
                _entity("base", lines=[self._outline(self._a[base], _GREY)]),
                _entity("platform", lines=[self._outline(self._b[self._top], _BLUE)]),
                _entity("legs", cylinders=[self._leg() for _ in self._a]),
            ]
        )
        _, platform, legs = self._update.entities
        self._stamps = [entity.timestamp for entity in self._update.entities]
        self._corners = list(platform.lines[0].points)
        self._legs = [(leg.pose.position, leg.pose.orientation, leg.size) for leg in legs.cylinders]

    def update(self, row: Rows, stamp: Timestamp) -> bytes | None:
        """Return a serialised SceneUpdate, or None while there is no pose."""
        pose = _pose(row, "p", "R")
        if pose is None:
            return None
        p, R = pose
        with np.errstate(all="ignore"):  # a pose that makes no sense makes a picture that makes none
            return self._draw(p, R, stamp)

    def _draw(self, p: Array, R: Array, stamp: Timestamp) -> bytes:
        for each in self._stamps:
            each.CopyFrom(stamp)
        tops = p + self._b @ R.T
        for corner, top in zip(self._corners, tops[self._top].tolist(), strict=True):
            corner.x, corner.y, corner.z = top
        axes = tops - self._a
        lengths = [sqrt(axis.dot(axis)) for axis in axes]
        directions, middles = axes / np.array(lengths)[:, None], (self._a + tops) / 2.0
        for (position, turn, size), (x, y, z), middle, length in zip(
            self._legs, directions.tolist(), middles.tolist(), lengths, strict=True
        ):
            # the rotation that takes the z axis to the leg, about z cross leg
            w = sqrt(max((1.0 + z) / 2.0, 0.0))
            turn.x, turn.y, turn.w = (1.0, 0.0, 0.0) if w < 1e-9 else (-y / (2.0 * w), x / (2.0 * w), w)
            position.x, position.y, position.z = middle
            size.z = length
        return bytes(self._update.SerializeToString(deterministic=True))

    def _outline(self, joints: Array, color: Any) -> Any:
        return LinePrimitive(
            type=LinePrimitive.LINE_LOOP,
            thickness=self._thickness,
            points=[Point3(x=x, y=y, z=z) for x, y, z in joints.tolist()],
            color=color,
        )

    def _leg(self) -> Any:
        return CylinderPrimitive(
            pose=Pose(position=Vector3(), orientation=Quaternion()),
            size=Vector3(x=self._thickness, y=self._thickness),
            bottom_scale=1.5,
            top_scale=1.0,
            color=_ORANGE,
        )


def _entity(name: str, **primitives: Any) -> Any:
    return SceneEntity(frame_id=BASE, id=name, frame_locked=True, **primitives)


def _pose(row: Rows, p_column: str, R_column: str) -> tuple[Array, Array] | None:
    """Return p (3,), R (3, 3) of a row, or None where there is no pose in it."""
    names = row.dtype.names or ()
    if p_column not in names or R_column not in names:
        return None
    p = np.asarray(row[p_column], float).reshape(3)
    R = np.asarray(row[R_column], float).reshape(3, 3)
    numbers = R.ravel().tolist()
    # all zero: no pose estimated or no reference yet
    return (p, R) if any(numbers) and all(map(isfinite, numbers + p.tolist())) else None
