"""Rotations at one position: how far the platform tilts in each direction, and turns about its own axis.

Path: turn by the torsion without tilt, then tilt.

Tilt and torsion (Bonev and Ryu, 2001): R = R_home Rz(phi) Ry(theta) Rz(sigma - phi). The platform's z axis
leans by the tilt theta towards the azimuth phi, with the torsion sigma about it; all zero at home.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array, Ints
from hil.robot.kinematics import check_vector
from hil.study.workspace.limits import KINDS, Surveyor, WorkspaceError
from hil.study.workspace.position import PositionMap
from hil.study.workspace.rays import FREE, first_exit, levels

STEP = np.deg2rad(1.0)
"""Of the paths."""
LEVELS = 24
"""Torsions on either side of zero."""


class OrientationMap(NamedTuple):
    """Orientation workspace at one position; angles in rad."""

    position: Array
    """(3,) m, base frame."""
    azimuth: Array
    """(n,) phi."""
    torsion: Array
    """(m,) sigma, from the least to the largest that is reached without tilt; zero is in the middle."""
    tilt: Array
    """(m, n) largest theta at each torsion and azimuth."""
    kinds: Ints
    """(m, n) index into KINDS, or FREE where the tilt ends at 180 degrees."""
    torsion_kinds: tuple[int, int]
    """The limits met by the least and the largest torsion."""

    @property
    def level(self) -> Array:
        """Largest tilt (n,) at each azimuth without torsion."""
        tilt: Array = self.tilt[len(self.torsion) // 2]
        return tilt

    @property
    def guaranteed(self) -> Array:
        """Tilt (m,) that is free in all directions, at each torsion."""
        tilt: Array = self.tilt.min(axis=1)
        return tilt


def tilt_torsion(phi: Array, theta: Array, sigma: Array) -> Array:
    """Return (n, 3, 3) of the rotations Rz(phi) Ry(theta) Rz(sigma - phi); angles (n,) rad."""
    zero, one = np.zeros_like(theta), np.ones_like(theta)

    def about_z(angle: Array) -> Array:
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)

    c, s = np.cos(theta), np.sin(theta)
    about_y = np.stack([c, zero, s, zero, one, zero, -s, zero, c], axis=1).reshape(-1, 3, 3)
    R: Array = about_z(phi) @ about_y @ about_z(sigma - phi)
    return R


def map_orientations(
    surveyor: Surveyor,
    position: ArrayLike | None = None,
    positions: PositionMap | None = None,
    azimuths: int = 72,
) -> OrientationMap:
    """Map the rotations that can be reached at a position (3,) m, default home's.

    The position itself has to be reached from home at home's orientation: on a straight line, or over the
    nodes of ``positions``.

    Raises
    ------
    WorkspaceError
        Where it is not; with the limit that the straight line meets.
    """
    p = surveyor.p if position is None else check_vector("position", position, 3)
    _refuse_unreachable(surveyor, p, positions)

    def turns(t: Array, which: Ints) -> tuple[Array, Array]:
        zero = np.zeros_like(t)
        sigma = np.where(which == 0, -t, t)
        return np.tile(p, (len(t), 1)), surveyor.R @ tilt_torsion(zero, zero, sigma)

    (least, largest), stops = first_exit(surveyor, turns, 2, STEP, np.pi)
    torsion = levels(least, largest, LEVELS)
    azimuth = 2.0 * np.pi * np.arange(azimuths) / azimuths
    phi = np.tile(azimuth, len(torsion))
    sigma = np.repeat(torsion, azimuths)

    def tilts(t: Array, which: Ints) -> tuple[Array, Array]:
        return np.tile(p, (len(t), 1)), surveyor.R @ tilt_torsion(phi[which], t, sigma[which])

    tilt, kinds = first_exit(surveyor, tilts, len(phi), STEP, np.pi)
    shape = (len(torsion), azimuths)
    ends = (int(stops[0]), int(stops[1]))
    return OrientationMap(p, azimuth, torsion, tilt.reshape(shape), kinds.reshape(shape), ends)


def _refuse_unreachable(surveyor: Surveyor, p: Array, positions: PositionMap | None) -> None:
    starts = surveyor.p[None]
    if positions is not None and len(positions.nodes):
        near = np.abs(positions.nodes - p).max(axis=1) <= positions.step
        starts = np.concatenate([starts, positions.nodes[near]])
    kind = FREE
    for start in starts:
        distance = float(np.linalg.norm(p - start))
        if distance == 0:
            return
        direction = (p - start) / distance
        step = distance / np.ceil(distance / 5e-3)

        def line(t: Array, which: Ints, x: Array = start, d: Array = direction) -> tuple[Array, Array]:
            return x + t[:, None] * d[None].repeat(len(which), 0), surveyor.R

        _, (end,) = first_exit(surveyor, line, 1, step, distance)
        if end == FREE:
            return
        kind = int(end) if kind == FREE else kind
    raise WorkspaceError(
        f"position {p.tolist()} m",
        (f"not reached from home: the straight line meets the limit {KINDS[kind]}",),
    )
