"""Reachable translations at home's orientation: a flood-filled grid, its boundary, volume and sections.

A path follows the grid, node by node; a step counts if its middle and end are within all limits.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import label

from drivers.arrays import Array, Flags, Ints
from hil.study.workspace.limits import KINDS, Surveyor, WorkspaceError

PLANES = (("x", "z"), ("y", "z"), ("x", "y"))
ZOOMS = 6
"""Coarse flood fills that find the box of the workspace."""
COARSE = 16
"""Steps of a coarse flood fill along the longest side."""


class Flood(NamedTuple):
    """A grid of translations, flood-filled from home. Arrays over the grid have one axis per direction."""

    axes: tuple[Array, ...]
    """Coordinates of the nodes along each direction, m, relative to home."""
    reached: Flags
    crossings: tuple[Array, ...]
    """Along each direction: points (n, 3) m, relative to home, where a step leaves the workspace."""
    kinds: tuple[Ints, ...]
    """Limit that stops each of these steps."""
    lengths: Array
    """Over the grid of x and y: length, m, inside the workspace of the grid's line along z."""


class PositionMap(NamedTuple):
    """Reachable translations at home's orientation (constant-orientation workspace), base frame."""

    step: float
    """Step of the grid, m."""
    flood: Flood
    points: Array
    """(n, 3) m, on the boundary to 1e-9 of a step, just inside."""
    kinds: Ints
    """(n,) index into KINDS: limit at the point."""
    volume: float
    """m^3."""
    volume_error: float
    """m^3: largest difference from the volumes of a quarter of the lines, twice as far apart. Not a bound."""
    volumes: tuple[tuple[float, float], ...]
    """(step, volume) from every fourth line, every second, all: shows the convergence."""
    extents: Array
    """(3, 2) m, lowest and highest x, y, z."""
    nodes: Array
    """(n, 3) m, reached nodes of the grid."""

    @property
    def shares(self) -> dict[str, float]:
        """Share, 0 to 1, of each kind of limit in the boundary, counted along the grid's lines."""
        counts = np.bincount(self.kinds, minlength=len(KINDS))
        return {kind: float(n) / max(len(self.kinds), 1) for kind, n in zip(KINDS, counts, strict=True)}


class CrossSection(NamedTuple):
    """A section of the reachable translations in a plane through home."""

    plane: tuple[str, str]
    u: Array
    """(n,) m, first coordinate of the plane's nodes, base frame."""
    v: Array
    """(m,) m, second coordinate."""
    condition: Array
    """(n, m), 2-norm condition number; NaN if not reached."""
    points: Array
    """(k, 2) m, on the boundary."""
    kinds: Ints
    """(k,) index into KINDS."""


def map_positions(surveyor: Surveyor, resolution: int) -> PositionMap:
    """Map the translations that the platform can reach from home with home's orientation.

    The grid has a node at home and ``resolution`` steps along the longest side of the workspace's box. The
    volume is the sum of the lengths inside of the grid's lines along z, whose ends are exact.

    Raises WorkspaceError: the leg lengths leave no room about home.
    """
    whole = stroke_box(surveyor)
    low, high = whole
    for _ in range(ZOOMS):
        step, size = float((high - low).max()) / COARSE, high - low
        seen = np.concatenate(flood_grid(surveyor, low, high, step).crossings)
        low, high = np.maximum(seen.min(axis=0) - step, low), np.minimum(seen.max(axis=0) + step, high)
        if np.prod((high - low) / size) > 0.6:
            break
    while True:
        step = float((high - low).max()) / resolution
        flood = flood_grid(surveyor, low, high, step)
        if not any(flood.reached.take([0, -1], axis=k).any() for k in range(3)):
            return _measure(surveyor, flood, step)
        low, high = np.maximum(2.0 * low, whole[0]), np.minimum(2.0 * high, whole[1])  # a missed passage


def stroke_box(surveyor: Surveyor) -> tuple[Array, Array]:
    """Corners (3,) m, relative to home, of a box outside which some leg is longer than its stroke."""
    R, lim = surveyor.R, surveyor.limits
    centres = surveyor.platform.base_joints - surveyor.platform.platform_joints @ R.T
    low = np.minimum((centres - lim.length_max).max(axis=0) - surveyor.p, 0.0)
    high = np.maximum((centres + lim.length_max).min(axis=0) - surveyor.p, 0.0)
    if not (high - low).max() > 0:
        raise WorkspaceError("workspace: the legs leave no room to move about home")
    return low, high


def flood_grid(surveyor: Surveyor, low: Array, high: Array, step: float) -> Flood:
    """Flood-fill a grid of translations from a node at home; low, high (3,) m: corners of its box.

    A node is reached from a neighbour if the end and the middle of the step are inside the limits. A step
    over a singularity does not count, since det J changes its sign there.
    """
    first, last = np.floor(low / step) - 1, np.ceil(high / step) + 1
    axes = tuple(step * np.arange(a, b + 1, dtype=np.float64) for a, b in zip(first, last, strict=True))
    X = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = surveyor.inside(X.reshape(-1, 3) + surveyor.p, surveyor.R).reshape(X.shape[:3])
    doubled = np.zeros(2 * np.array(inside.shape) - 1, np.bool_)  # nodes, and the middles of steps between
    doubled[::2, ::2, ::2] = inside
    steps = []
    for k in range(3):
        a, b = _along(k, slice(None, -1)), _along(k, slice(1, None))
        passes = inside[a] & inside[b]
        passes[passes] = surveyor.inside(0.5 * (X[a][passes] + X[b][passes]) + surveyor.p, surveyor.R)
        steps.append((a, b, _along(k, slice(1, None, 2), slice(None, None, 2))))
        doubled[steps[k][2]] = passes
    parts, _ = label(doubled)
    found = parts == parts[tuple((-2 * first).astype(int))]
    reached = found[::2, ::2, ::2]
    crossings, kinds = [], []
    for a, b, middle in steps:
        joined = found[middle]
        length = np.zeros(inside.shape)
        length[a] = step * joined
        points, met = [], []
        for start, end in ((a, b), (b, a)):
            leaves = reached[start] & ~joined
            x, d = X[start][leaves], X[end][leaves] - X[start][leaves]
            t, kind = surveyor.rays(x, d, 0.5, 1.0)
            length[start][leaves] += step * t
            points.append(x + t[:, None] * d)
            met.append(kind)
        crossings.append(np.concatenate(points))
        kinds.append(np.concatenate(met))
    return Flood(axes, reached, tuple(crossings), tuple(kinds), length.sum(axis=2))


def _along(k: int, part: slice, rest: slice = slice(None)) -> tuple[slice, ...]:
    """Index of `part` along direction k, and of `rest` along the others."""
    return tuple(part if m == k else rest for m in range(3))


def cut(surveyor: Surveyor, positions: PositionMap, plane: tuple[str, str]) -> CrossSection:
    """Section of the reachable translations in a plane through home."""
    u, v = ("xyz".index(name) for name in plane)
    normal, flood = 3 - u - v, positions.flood
    home = int(np.argmin(np.abs(flood.axes[normal])))
    reached = flood.reached.take(home, axis=normal)
    here = np.abs(positions.nodes[:, normal] - surveyor.p[normal]) < 1e-9 * positions.step
    condition = np.full(reached.shape, np.nan)
    condition[reached] = surveyor.dexterity(positions.nodes[here], surveyor.R)[0]
    points = np.concatenate([flood.crossings[u], flood.crossings[v]])
    kinds = np.concatenate([flood.kinds[u], flood.kinds[v]])
    here = np.abs(points[:, normal]) < 1e-9 * positions.step
    return CrossSection(
        plane,
        flood.axes[u] + surveyor.p[u],
        flood.axes[v] + surveyor.p[v],
        condition,
        (points[here] + surveyor.p)[:, [u, v]],
        kinds[here],
    )


def _measure(surveyor: Surveyor, flood: Flood, step: float) -> PositionMap:
    home = [int(np.argmin(np.abs(x))) for x in flood.axes]

    def volume(n: int, i: int = 0, j: int = 0) -> float:
        """Volume, m^3, from every n-th line of the grid, counted from home and an offset (i, j)."""
        lines = flood.lengths[(home[0] + i) % n :: n, (home[1] + j) % n :: n]
        return float(lines.sum()) * (step * n) ** 2

    volumes = [(step * n, volume(n)) for n in (4, 2, 1)]
    points, where, best = np.concatenate(flood.crossings), np.argwhere(flood.reached), volumes[-1][1]
    return PositionMap(
        step,
        flood,
        points + surveyor.p,
        np.concatenate(flood.kinds),
        best,
        max(abs(volume(2, i, j) - best) for i in (0, 1) for j in (0, 1)),
        tuple(volumes),
        np.stack([points.min(axis=0), points.max(axis=0)], axis=1) + surveyor.p[:, None],
        np.stack([flood.axes[k][where[:, k]] for k in range(3)], axis=1) + surveyor.p,
    )
