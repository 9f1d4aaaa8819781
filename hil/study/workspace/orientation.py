"""Reachable rotations at one position: tilt in each direction, and torsion about the platform's axis.

A path turns to the torsion without tilt, then tilts.

Tilt and torsion (Bonev and Ryu, 2001): R = R_home Rz(phi) Ry(theta) Rz(sigma - phi). The platform's z axis
leans by the tilt theta towards the azimuth phi, with the torsion sigma about it; all zero at home.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from drivers.arrays import Array, Ints
from hil.robot.kinematics import check_vector
from hil.study.workspace.limits import FREE, KINDS, Surveyor, WorkspaceError, levels
from hil.study.workspace.position import PositionMap

STEP = np.deg2rad(1.0)
"""Step along a path."""
LEVELS = 24
"""Torsions on either side of zero."""
AZIMUTHS = 72


class OrientationMap(NamedTuple):
    """Orientation workspace at one position; angles in rad."""

    position: Array
    """(3,) m, base frame."""
    azimuth: Array
    """(n,) phi."""
    torsion: Array
    """(m,) sigma, from the smallest to the largest reached without tilt; zero is in the middle."""
    tilt: Array
    """(m, n) largest theta at each torsion and azimuth."""
    kinds: Ints
    """(m, n) index into KINDS, or FREE if the tilt reaches 180 degrees."""
    torsion_kinds: tuple[int, int]
    """Limits at the smallest and the largest torsion."""

    @property
    def level(self) -> Array:
        """Largest tilt (n,), rad, at each azimuth without torsion."""
        tilt: Array = self.tilt[len(self.torsion) // 2]
        return tilt

    @property
    def guaranteed(self) -> Array:
        """Tilt (m,), rad, that is reachable in all directions, at each torsion."""
        tilt: Array = self.tilt.min(axis=1)
        return tilt


def tilt_torsion(phi: Array, theta: Array, sigma: Array) -> Array:
    """Rotations Rz(phi) Ry(theta) Rz(sigma - phi) as (n, 3, 3); angles (n,) rad."""
    R: Array = Rotation.from_euler("ZYZ", np.stack([phi, theta, sigma - phi], axis=1)).as_matrix()
    return R


def map_orientations(
    surveyor: Surveyor, position: ArrayLike | None = None, positions: PositionMap | None = None
) -> OrientationMap:
    """Map the rotations that the platform can reach at a position (3,) m, default home's.

    The position itself must be reachable at home's orientation: on a straight line from home or the nearest
    of the nodes of ``positions``. Raises WorkspaceError: the line meets a limit.
    """
    p = surveyor.p if position is None else check_vector("position", position, 3)
    known = surveyor.p[None] if positions is None else np.vstack([surveyor.p, positions.nodes])
    start = known[np.argmin(np.linalg.norm(known - p, axis=1))]
    steps = np.ceil(np.linalg.norm(p - start) / 5e-3)
    if steps > 0:
        _, (end,) = surveyor.rays((start - surveyor.p)[None], (p - start)[None], 1.0 / steps, 1.0)
        if end != FREE:
            meets = f"not reached from home: the straight line meets the limit {KINDS[end]}"
            raise WorkspaceError(f"position {p.tolist()} m: {meets}")

    def turns(t: Array, which: Ints) -> tuple[Array, Array]:
        zero = np.zeros_like(t)
        sigma = np.where(which == 0, -t, t)
        return np.tile(p, (len(t), 1)), surveyor.R @ tilt_torsion(zero, zero, sigma)

    (least, largest), stops = surveyor.first_exit(turns, 2, STEP, np.pi)
    torsion = levels(least, largest, LEVELS)
    azimuth = 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    phi = np.tile(azimuth, len(torsion))
    sigma = np.repeat(torsion, AZIMUTHS)

    def tilts(t: Array, which: Ints) -> tuple[Array, Array]:
        return np.tile(p, (len(t), 1)), surveyor.R @ tilt_torsion(phi[which], t, sigma[which])

    tilt, kinds = surveyor.first_exit(tilts, len(phi), STEP, np.pi)
    shape = (len(torsion), AZIMUTHS)
    ends = (int(stops[0]), int(stops[1]))
    return OrientationMap(p, azimuth, torsion, tilt.reshape(shape), kinds.reshape(shape), ends)
