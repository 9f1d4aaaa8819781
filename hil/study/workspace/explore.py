"""All maps of a workspace at once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hil.study.workspace.limits import Progress, Surveyor, silent
from hil.study.workspace.orientation import OrientationMap, map_orientations
from hil.study.workspace.position import PLANES, CrossSection, PositionMap, cut, map_positions
from hil.study.workspace.shapes import Cylinder, Sphere, largest_cylinder, largest_sphere


class Workspace(NamedTuple):
    """All that was mapped, and the limits that were asked."""

    surveyor: Surveyor
    positions: PositionMap
    sections: tuple[CrossSection, ...]
    """In the order of PLANES."""
    sphere: Sphere
    cylinder: Cylinder
    orientations: OrientationMap


def explore(
    surveyor: Surveyor, resolution: int = 60, position: ArrayLike | None = None, progress: Progress = silent
) -> Workspace:
    """Map positions and orientations, cut the three sections through home, fit the largest bodies.

    ``resolution`` as in ``map_positions``, ``position`` as in ``map_orientations``.

    Raises
    ------
    WorkspaceError
        Where the legs leave no room about home, or ``position`` is not reached.
    """
    positions = map_positions(surveyor, resolution, progress)
    sections = []
    for k, plane in enumerate(PLANES):
        progress("sections", k / len(PLANES))
        sections.append(cut(surveyor, positions, plane))
    reach = float(np.linalg.norm(positions.points - surveyor.p, axis=1).max()) + positions.step
    progress("largest sphere and cylinder", 0.0)
    sphere = largest_sphere(surveyor, positions.step, reach)
    progress("largest sphere and cylinder", 0.5)
    cylinder = largest_cylinder(surveyor, positions.step, reach)
    progress("orientations", 0.0)
    orientations = map_orientations(surveyor, position, positions)
    return Workspace(surveyor, positions, tuple(sections), sphere, cylinder, orientations)
