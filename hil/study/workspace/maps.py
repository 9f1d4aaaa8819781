"""Computes all maps of a workspace in one call."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hil.study.workspace.limits import Surveyor
from hil.study.workspace.orientation import OrientationMap, map_orientations
from hil.study.workspace.position import PLANES, CrossSection, PositionMap, cut, map_positions
from hil.study.workspace.shapes import Cylinder, Sphere, largest_cylinder, largest_sphere


class Workspace(NamedTuple):
    """All maps of a workspace, its largest sphere and cylinder, and the limits used."""

    surveyor: Surveyor
    positions: PositionMap
    sections: tuple[CrossSection, ...]
    """In the order of PLANES."""
    sphere: Sphere
    cylinder: Cylinder
    orientations: OrientationMap


def explore(
    surveyor: Surveyor, resolution: int, position: ArrayLike | None, progress: Callable[[str], None]
) -> Workspace:
    """Map positions and orientations, cut three sections through home, fit the largest sphere and cylinder.

    ``resolution``: see ``map_positions``, ``position``: see ``map_orientations``. Raises WorkspaceError: the
    legs leave no room about home, or ``position`` is not reached.
    """
    progress("positions")
    positions = map_positions(surveyor, resolution)
    progress("sections")
    sections = tuple(cut(surveyor, positions, plane) for plane in PLANES)
    reach = float(np.linalg.norm(positions.points - surveyor.p, axis=1).max()) + positions.step
    progress("largest sphere and cylinder")
    sphere = largest_sphere(surveyor, positions.step, reach)
    cylinder = largest_cylinder(surveyor, positions.step, reach)
    progress("orientations")
    orientations = map_orientations(surveyor, position, positions)
    return Workspace(surveyor, positions, sections, sphere, cylinder, orientations)
