"""Which poses the platform can reach, and how well it moves and carries there.

A pose counts as reachable if it can be reached from home, on the path that each file names, without leaving
the limits: a pose on the far side of a singularity or of a gap does not count, however good its lengths are.
"""

from hil.workspace.explore import Workspace, explore
from hil.workspace.limits import KINDS, Limits, Surveyor, WorkspaceError
from hil.workspace.orientation import OrientationMap, map_orientations
from hil.workspace.position import PositionMap, Section, cut, map_positions
from hil.workspace.shapes import Cylinder, Sphere, largest_cylinder, largest_sphere

__all__ = [
    "KINDS",
    "Cylinder",
    "Limits",
    "OrientationMap",
    "PositionMap",
    "Section",
    "Sphere",
    "Surveyor",
    "Workspace",
    "WorkspaceError",
    "cut",
    "explore",
    "largest_cylinder",
    "largest_sphere",
    "map_orientations",
    "map_positions",
]
