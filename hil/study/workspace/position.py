"""Translations at home's orientation: a grid flooded from home, its boundary, its volume, its sections.

Path: along the grid, from node to neighbour; a step counts if its middle and its end keep all limits.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from drivers.arrays import Array, Flags, Ints
from hil.study.workspace.limits import CHUNK, KINDS, Progress, Surveyor, WorkspaceError, silent

PLANES = (("x", "z"), ("y", "z"), ("x", "y"))
ZOOMS = 6
"""Coarse floods that look for the box of the workspace."""
COARSE = 16
"""Their steps along the longest side."""


class Flood(NamedTuple):
    """A grid flooded from its seeds. Arrays over the grid have one axis for each direction of the grid."""

    axes: tuple[Array, ...]
    """Coordinates of the nodes along each direction, m, relative to home."""
    reached: Flags
    crossings: tuple[Array, ...]
    """Along each direction: (n, 3) of points where a step leaves the workspace, relative to home, m."""
    kinds: tuple[Ints, ...]
    """The limit that stops each of these steps."""
    joined: tuple[Flags, ...]
    """Along each direction: whether the step from a node to the next one stays inside."""
    parts: tuple[tuple[Ints, Array], ...]
    """Along each direction: node from which each of the crossings was met, and the length of that step."""


class PositionMap(NamedTuple):
    """Constant-orientation workspace at home's orientation, base frame."""

    step: float
    """m, of the grid."""
    flood: Flood
    points: Array
    """(n, 3) m, on the boundary to 1e-9 of a step, just inside."""
    kinds: Ints
    """(n,) index into KINDS: the limit met there."""
    volume: float
    """m^3."""
    volume_error: float
    """m^3: how far the volume from a quarter of the lines, twice as far apart, lies away. No bound."""
    volumes: tuple[tuple[float, float], ...]
    """(step, volume) of every fourth line, every second, all: how it converges."""
    extents: Array
    """(3, 2) m, lowest and highest x, y, z."""
    nodes: Array
    """(n, 3) m, grid nodes reached."""

    @property
    def shares(self) -> dict[str, float]:
        """Share of the boundary that each kind of limit makes up, seen along the grid's lines."""
        counts = np.bincount(self.kinds, minlength=len(KINDS))
        return {kind: float(n) / max(len(self.kinds), 1) for kind, n in zip(KINDS, counts, strict=True)}


class CrossSection(NamedTuple):
    """A plane through home, on a finer grid."""

    plane: tuple[str, str]
    u: Array
    """(n,) m, first coordinate of the plane's nodes, base frame."""
    v: Array
    """(m,) m, second coordinate."""
    reached: Flags
    """(n, m)."""
    condition: Array
    """(n, m), 2-norm condition number; nan where not reached."""
    points: Array
    """(k, 2) m, on the boundary."""
    kinds: Ints
    """(k,) index into KINDS."""


def map_positions(surveyor: Surveyor, resolution: int = 40, progress: Progress = silent) -> PositionMap:
    """Map the translations that can be reached from home with home's orientation.

    Grid: home is a node; ``resolution`` steps along the longest side of the workspace's box. The volume is
    the sum of the lengths of the grid's lines inside, whose ends are exact, along x, y and z: the mean of
    the three, weighted with how well neighbouring lines of each agree.

    Raises
    ------
    WorkspaceError
        Where the lengths leave no room at all about home.
    """
    box = stroke_box(surveyor)
    for _ in range(ZOOMS):
        size = box[:, 1] - box[:, 0]
        step = float(size.max()) / COARSE
        flood = flood_grid(surveyor, box_axes(box, step))
        seen = _extents(surveyor, flood)
        wider = np.stack([seen[:, 0] - step, seen[:, 1] + step], axis=1) - surveyor.p[:, None]
        smaller = np.stack([np.maximum(wider[:, 0], box[:, 0]), np.minimum(wider[:, 1], box[:, 1])], axis=1)
        shrink = float(np.prod((smaller[:, 1] - smaller[:, 0]) / size))
        box = smaller
        if shrink > 0.6:
            break
    while True:
        step = float((box[:, 1] - box[:, 0]).max()) / resolution
        flood = flood_grid(surveyor, box_axes(box, step), progress=progress)
        open_sides = [flood.reached.take(end, axis=k).any() for k in range(3) for end in (0, -1)]
        if not any(open_sides):
            break
        box = np.clip(2.0 * box, *stroke_box(surveyor).T[:, :, None])  # a coarse flood missed a passage
    return _measure(surveyor, flood, step)


def stroke_box(surveyor: Surveyor) -> Array:
    """Return (3, 2) m, relative to home: no leg can be short enough outside it."""
    R, lim = surveyor.R, surveyor.limits
    centres = surveyor.platform.base_joints - surveyor.platform.platform_joints @ R.T
    low = (centres - lim.length_max).max(axis=0) - surveyor.p
    high = (centres + lim.length_max).min(axis=0) - surveyor.p
    box = np.stack([np.minimum(low, 0.0), np.maximum(high, 0.0)], axis=1)
    if not (box[:, 1] - box[:, 0]).max() > 0:
        raise WorkspaceError("workspace", ("the legs leave no room to move about home",))
    return box


def box_axes(box: Array, step: float) -> tuple[Array, ...]:
    """Return coordinates of a grid with a node at home that covers the box and one step more on each side."""
    return tuple(
        step * np.arange(np.floor(low / step) - 1, np.ceil(high / step) + 2, dtype=np.float64)
        for low, high in box
    )


def flood_grid(
    surveyor: Surveyor, axes: tuple[Array, ...], seeds: Flags | None = None, progress: Progress = silent
) -> Flood:
    """Flood a grid of translations about home from its ``seeds`` (default: home's node).

    A node is reached if neighbours lead there, each step with end and middle inside the limits; a step over
    a singularity does not count, since det J has another sign beyond it.
    """
    shape = tuple(len(x) for x in axes)
    X = np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")], axis=1)
    inside = surveyor.inside(X + surveyor.p, surveyor.R, "nodes", progress)
    number = np.arange(len(X)).reshape(shape)
    links: list[tuple[Ints, Ints]] = []
    good: list[Flags] = []
    for k in range(3):
        first = number.take(range(shape[k] - 1), axis=k).ravel()
        second = number.take(range(1, shape[k]), axis=k).ravel()
        both = inside[first] & inside[second]
        middle = 0.5 * (X[first[both]] + X[second[both]])
        passes = np.zeros(len(first), np.bool_)
        what = f"steps along {'xyz'[k]}"
        passes[both] = surveyor.inside(middle + surveyor.p, surveyor.R, what, progress)
        links.append((first, second))
        good.append(passes)
    rows = np.concatenate([f[g] for (f, _), g in zip(links, good, strict=True)])
    columns = np.concatenate([s[g] for (_, s), g in zip(links, good, strict=True)])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(len(X), len(X)))
    _, label = connected_components(graph, directed=False)
    if seeds is None:
        home = int(np.ravel_multi_index(tuple(int(np.argmin(np.abs(x))) for x in axes), shape))
        reached = inside & (label == label[home])
    else:
        reached = inside & np.isin(label, np.unique(label[seeds.ravel() & inside]))
    points, kinds, parts, joined = [], [], [], []
    for k in range(3):
        first, second = links[k]
        start, end, half = _leaving(first, second, good[k], reached, inside)
        found, kind = _cross(surveyor, X[start], X[end], half, f"boundary along {'xyz'[k]}", progress)
        points.append(found)
        kinds.append(kind)
        parts.append((start, np.linalg.norm(found - X[start], axis=1)))
        steps = list(shape)
        steps[k] -= 1
        joined.append((good[k] & reached[first]).reshape(steps))
    return Flood(axes, reached.reshape(shape), tuple(points), tuple(kinds), tuple(joined), tuple(parts))


def cut(
    surveyor: Surveyor, positions: PositionMap, plane: tuple[str, str], resolution: int = 160
) -> CrossSection:
    """Return a section of the workspace through home.

    The plane's own grid is finer than the map's by a whole factor, so that the nodes of the map are among
    its own: it is flooded from those, and parts that are reached around the plane are there, too.
    """
    u, v = ("xyz".index(name) for name in plane)
    normal = 3 - u - v
    coarse = positions.flood.axes
    longest = max(len(coarse[u]), len(coarse[v]))
    factor = max(1, round(resolution / longest))
    axes: list[Array] = [np.zeros(1)] * 3
    for k in (u, v):
        count = factor * (len(coarse[k]) - 1) + 1
        axes[k] = coarse[k][0] + positions.step / factor * np.arange(count)
    home = int(np.argmin(np.abs(coarse[normal])))
    seeds = np.zeros([len(x) for x in axes], np.bool_)
    every = [slice(None, None, factor)] * 3
    every[normal] = slice(None)
    seeds[tuple(every)] = positions.flood.reached.take([home], axis=normal)
    flood = flood_grid(surveyor, tuple(axes), seeds)
    reached = flood.reached.transpose(u, v, normal)[:, :, 0]
    where = np.argwhere(flood.reached)
    P = np.stack([axes[k][where[:, k]] for k in range(3)], axis=1) + surveyor.p
    number, _ = surveyor.dexterity(P, surveyor.R)
    condition = np.full(reached.shape, np.nan)
    condition[where[:, u], where[:, v]] = number
    points = np.concatenate([flood.crossings[u], flood.crossings[v]]) + surveyor.p
    kinds = np.concatenate([flood.kinds[u], flood.kinds[v]])
    return CrossSection(
        plane,
        axes[u] + surveyor.p[u],
        axes[v] + surveyor.p[v],
        reached,
        condition,
        points[:, [u, v]],
        kinds,
    )


def _leaving(
    first: Ints, second: Ints, good: Flags, reached: Flags, inside: Flags
) -> tuple[Ints, Ints, Flags]:
    """Return steps that leave from a reached node: its number, the next one's, whether it fails half way."""
    forth = reached[first] & ~good
    back = reached[second] & ~good
    start = np.concatenate([first[forth], second[back]])
    end = np.concatenate([second[forth], first[back]])
    return start, end, inside[end]


def _cross(
    surveyor: Surveyor, start: Array, end: Array, half: Flags, what: str, progress: Progress
) -> tuple[Array, Ints]:
    """Return where steps leave the workspace, (n, 3) relative to home, and the limits met."""
    points = np.empty_like(start)
    kinds = np.empty(len(start), np.int64)
    for k in range(0, len(start), CHUNK):
        progress(what, k / len(start))
        x, d = start[k : k + CHUNK], end[k : k + CHUNK] - start[k : k + CHUNK]
        high = np.where(half[k : k + CHUNK], 0.5, 1.0)
        t, kinds[k : k + CHUNK] = surveyor.leave(_line(surveyor, x, d), np.zeros(len(x)), high)
        points[k : k + CHUNK] = x + t[:, None] * d
    return points, kinds


def _line(surveyor: Surveyor, x: Array, d: Array) -> Callable[[Array], tuple[Array, Array]]:
    return lambda t: (surveyor.p + x + t[:, None] * d, surveyor.R)


def _extents(surveyor: Surveyor, flood: Flood) -> Array:
    points = np.concatenate(flood.crossings)
    return np.stack([points.min(axis=0), points.max(axis=0)], axis=1) + surveyor.p[:, None]


def _measure(surveyor: Surveyor, flood: Flood, step: float) -> PositionMap:
    # Lines in each direction, as four sets of every second line: sets that differ tell how far the lines of
    # that direction can be trusted. A flat face along them, between two layers, costs them half a step.
    sets = np.array([[_volume(flood, k, step, 2, (m, n)) for m in (0, 1) for n in (0, 1)] for k in range(3)])
    spread = np.ptp(sets, axis=1)
    weight = 1.0 / np.maximum(spread, 1e-12 * max(sets.mean(), 1e-30)) ** 2
    weight /= weight.sum()
    volumes = [(step * n, float(weight @ [_volume(flood, k, step, n) for k in range(3)])) for n in (4, 2, 1)]
    volume = volumes[-1][1]
    where = np.argwhere(flood.reached)
    nodes = np.stack([flood.axes[k][where[:, k]] for k in range(3)], axis=1) + surveyor.p
    return PositionMap(
        step,
        flood,
        np.concatenate(flood.crossings) + surveyor.p,
        np.concatenate(flood.kinds),
        volume,
        float(np.abs(weight @ sets - volume).max()),
        tuple(volumes),
        _extents(surveyor, flood),
        nodes,
    )


def _volume(flood: Flood, k: int, step: float, stride: int, offset: tuple[int, int] = (0, 0)) -> float:
    """Integrate along direction k over every ``stride``-th line, counted from home and the offset."""
    shape = flood.reached.shape
    inner = np.zeros(shape)
    index = [slice(None)] * 3
    index[k] = slice(0, shape[k] - 1)
    inner[tuple(index)] = step * flood.joined[k]
    start, rest = flood.parts[k]
    length = inner.ravel()
    np.add.at(length, start, rest)
    across = [m for m in range(3) if m != k]
    pick = [slice(None)] * 3
    for m, n in zip(across, offset, strict=True):
        home = int(np.argmin(np.abs(flood.axes[m])))
        pick[m] = slice((home + n) % stride, None, stride)
    return float(length.reshape(shape)[tuple(pick)].sum()) * (step * stride) ** 2
