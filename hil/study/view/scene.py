"""The robot as meshes and lines for a 3D view: a plate, outlines, legs from joint to joint."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Array, Rows
from hil.robot.around import around
from hil.study.report.scene import has_pose

THICKNESS = 0.03
"""Of a plate, as a share of the base's radius."""

FLAT = 1e-9
"""Sine between the edges of a side, below which it is none."""


class Solid(NamedTuple):
    """A closed surface of triangles."""

    vertices: Array
    """(n, 3) m."""
    triangles: NDArray[np.uint32]
    """(k, 3) indices, counter-clockwise seen from outside."""
    normals: Array
    """(n, 3), of length 1."""


def outline(joints: Array) -> Array:
    """Return joints (n, 3) m by their angle about their centre, the first once more at the end."""
    ring = joints[around(joints)]
    return np.concatenate((ring, ring[:1]))


def plate(joints: Array, thickness: float) -> Solid:
    """Return a plate of `thickness` m through the plane of joints (n, 3) m; each face has its own vertices.

    Joints of two legs may be one point: the plate has one corner there. One straight above another is no
    side.
    """
    ring = joints[around(joints)]
    ring = ring[np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1) > 0.0]
    n = len(ring)
    up = _normal(ring)
    top, bottom = ring + up * thickness / 2.0, ring - up * thickness / 2.0
    vertices, normals = [top, bottom], [np.tile(up, (n, 1)), np.tile(-up, (n, 1))]
    triangles = [[0, k, k + 1] for k in range(1, n - 1)]
    triangles += [[n, n + k + 1, n + k] for k in range(1, n - 1)]
    for i in range(n):
        j, first = (i + 1) % n, 2 * n + 4 * (len(vertices) - 2)
        side = np.array([bottom[i], bottom[j], top[j], top[i]])
        outward = np.cross(side[1] - side[0], side[2] - side[1])
        size = float(np.linalg.norm(outward))
        if size <= FLAT * thickness * float(np.linalg.norm(side[1] - side[0])):
            continue
        vertices.append(side)
        normals.append(np.tile(outward / size, (4, 1)))
        triangles += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return Solid(np.concatenate(vertices), np.array(triangles, np.uint32), np.concatenate(normals))


def _normal(ring: Array) -> Array:
    """Return the unit normal (3,) of the plane nearest to a ring, to the side from which it turns left."""
    x = ring - ring.mean(axis=0)
    normal = np.linalg.svd(x)[2][2]
    area = np.cross(x, np.roll(x, -1, axis=0)).sum(axis=0)
    return np.asarray(normal if normal @ area >= 0.0 else -normal, np.float64)


def posed(rows: Rows, p: str, R: str) -> Rows:
    """Return the rows that hold a pose; none where the columns are missing."""
    names = rows.dtype.names or ()
    if p not in names or R not in names:
        return rows[:0]
    found: Rows = rows[has_pose(rows, p, R)]
    return found


def legs(rows: Rows, base_joints: Array, platform_joints: Array) -> Array:
    """Return the ends of the legs (n, legs, 2, 3) m, base frame: a_i, and p + R b_i."""
    a, b = base_joints, platform_joints
    tops = rows["p"][:, None, :] + np.einsum("nij,kj->nki", rows["R"].reshape(-1, 3, 3), b)
    return np.stack((np.broadcast_to(a, tops.shape), tops), axis=2)
