"""Moving platform for 3D views: foxglove.FrameTransform and foxglove.SceneUpdate from rows.

For display only, at a low rate; nothing reads it back.
"""

from math import isfinite, sqrt
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from drivers.arrays import Array, Rows
from hil.record.recording import Scene

BASE = "base"
_POSES = (("platform", "p", "R"), ("reference", "p_d", "R_d"))
_GREY = Color(r=0.45, g=0.48, b=0.52, a=1.0)
_BLUE = Color(r=0.12, g=0.42, b=0.71, a=1.0)
_ORANGE = Color(r=0.93, g=0.55, b=0.14, a=1.0)


_PLANES = ((0, 1), (1, 2), (2, 0))
"""Pairs of axes that span the planes of a frame: xy, yz, zx."""


def around(joints: Array) -> NDArray[np.intp]:
    """Order (n,) of joints (n, 3) m by angle about their centre, for a ring in any plane.

    The view is along the frame axis along which the ring covers the largest area. For a level ring the angle
    runs from x towards y.
    """
    x = joints - joints.mean(axis=0)
    moments = (x[:, :, None] * x[:, None, :]).sum(axis=0)
    areas = [moments[i, i] * moments[j, j] - moments[i, j] ** 2 for i, j in _PLANES]
    i, j = _PLANES[int(np.argmax(areas))]
    return np.argsort(np.arctan2(x[:, j], x[:, i]))


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w), w >= 0, of a rotation matrix (3, 3), by its largest component."""
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
    """Serialised foxglove.FrameTransform of the platform in a row, and of the reference if it has one."""
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
    """Draws base, platform and legs of a row as lines of a foxglove.SceneUpdate."""

    def __init__(self, scene: Scene) -> None:
        self._a = np.array(scene.base_joints, float)
        self._b = np.array(scene.platform_joints, float)
        self._base, self._top = around(self._a), around(self._b)
        self._thickness = 0.02 * float(np.linalg.norm(self._a, axis=1).max())

    def update(self, row: Rows, stamp: Timestamp) -> bytes | None:
        """Serialised foxglove.SceneUpdate of a row; None for a row without a pose."""
        pose = _pose(row, "p", "R")
        if pose is None:
            return None
        p, R = pose
        with np.errstate(all="ignore"):  # a meaningless pose may overflow
            tops = p + self._b @ R.T
        legs = np.stack((self._a, tops), axis=1).reshape(-1, 3)
        entities = [
            self._entity("base", LinePrimitive.LINE_LOOP, self._a[self._base], _GREY, stamp),
            self._entity("platform", LinePrimitive.LINE_LOOP, tops[self._top], _BLUE, stamp),
            self._entity("legs", LinePrimitive.LINE_LIST, legs, _ORANGE, stamp),
        ]
        return bytes(SceneUpdate(entities=entities).SerializeToString(deterministic=True))

    def _entity(self, name: str, kind: Any, points: Array, color: Any, stamp: Timestamp) -> Any:
        corners = [Point3(x=x, y=y, z=z) for x, y, z in points.tolist()]
        line = LinePrimitive(type=kind, thickness=self._thickness, points=corners, color=color)
        return SceneEntity(timestamp=stamp, frame_id=BASE, id=name, frame_locked=True, lines=[line])


def _pose(row: Rows, p_column: str, R_column: str) -> tuple[Array, Array] | None:
    """Position p (3,) and rotation matrix R (3, 3) of a row; None without a pose."""
    names = row.dtype.names or ()
    if p_column not in names or R_column not in names:
        return None
    p = np.asarray(row[p_column], float).reshape(3)
    R = np.asarray(row[R_column], float).reshape(3, 3)
    numbers = R.ravel().tolist()
    # all zero: no pose estimated or no reference yet
    return (p, R) if any(numbers) and all(map(isfinite, numbers + p.tolist())) else None
