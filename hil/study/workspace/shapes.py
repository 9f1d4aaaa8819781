"""Largest sphere and cylinder of translations about home, within which all positions are reachable.

Reachable means on straight lines from home, or from the cylinder's axis.
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.study.workspace.limits import Surveyor, levels

DIRECTIONS = 1000
CAPS = 6
"""Refinements about the shortest ray, each in a cap a quarter as wide."""
LAYERS = 30
"""Heights tested on either side of home."""
AZIMUTHS = 36


class Sphere(NamedTuple):
    """Sphere about home of the translations that are reachable in every direction; radius in m."""

    radius: float
    direction: Array
    """(3,) unit, of the shortest ray."""
    kind: int
    """Index into KINDS: limit at the end of that ray."""


class Cylinder(NamedTuple):
    """Vertical cylinder (base frame z) with its axis through home, all of whose positions are reachable."""

    radius: float
    """m."""
    low: float
    """m, lowest z relative to home."""
    high: float
    """m, highest z relative to home."""

    @property
    def volume(self) -> float:
        """Volume pi r^2 h, m^3."""
        return float(np.pi * self.radius**2 * (self.high - self.low))


def largest_sphere(surveyor: Surveyor, step: float, reach: float) -> Sphere:
    """Largest sphere about home's position, at home's orientation, whose rays stay inside the limits.

    ``step``: m, along the rays; ``reach``: m, largest length of a ray.
    """
    directions = fibonacci(DIRECTIONS)
    width = 2.0 / np.sqrt(DIRECTIONS)
    best = Sphere(np.inf, directions[0], 0)
    for _ in range(CAPS + 1):
        t, kinds = surveyor.rays(np.zeros((len(directions), 3)), directions, step, reach)
        k = int(np.argmin(t))
        if t[k] < best.radius:
            best = Sphere(float(t[k]), directions[k], int(kinds[k]))
        directions = best.direction + width * fibonacci(200)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        width /= 4.0
    return best


def largest_cylinder(surveyor: Surveyor, step: float, reach: float) -> Cylinder:
    """Vertical cylinder of largest volume about home's axis, at home's orientation, inside the limits.

    Its axis and its radii at 2 x LAYERS heights and AZIMUTHS directions stay inside. The result is checked
    with eight times as many directions, and its radius reduced if needed. step, reach: see `largest_sphere`.
    """
    up = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    (above, below), _ = surveyor.rays(np.zeros((2, 3)), up, step, reach)
    z = levels(below, above, LAYERS)
    free = _radii(surveyor, z, AZIMUTHS, step, reach)
    # the radius of a cylinder is the least at the heights in it: from home down, and from home up
    down, up = np.minimum.accumulate(free[LAYERS::-1]), np.minimum.accumulate(free[LAYERS:])
    radius, height = np.minimum.outer(down, up), np.subtract.outer(-z[LAYERS::-1], -z[LAYERS:])
    first, last = np.unravel_index(int(np.argmax(radius**2 * height)), radius.shape)
    best = Cylinder(float(radius[first, last]), float(z[LAYERS - first]), float(z[LAYERS + last]))
    if best.volume > 0:
        inner = np.linspace(best.low, best.high, 2 * LAYERS // 4 + 1)
        least = float(_radii(surveyor, inner, 8 * AZIMUTHS, step, reach).min())
        best = best._replace(radius=min(best.radius, least))
    return best


def fibonacci(count: int) -> Array:
    """Unit vectors (count, 3) spread evenly over the sphere, poles included."""
    k = np.arange(count)
    z = 1.0 - 2.0 * k / (count - 1)
    rho = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    phi = np.pi * (3.0 - np.sqrt(5.0)) * k
    return np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=1)


def _radii(surveyor: Surveyor, z: Array, azimuths: int, step: float, reach: float) -> Array:
    """Free radius (n,) m at each height z (n,) m, relative to home."""
    phi = 2.0 * np.pi * np.arange(azimuths) / azimuths
    rim = np.stack([np.cos(phi), np.sin(phi), np.zeros(azimuths)], axis=1)
    start = np.zeros((len(z) * azimuths, 3))
    start[:, 2] = np.repeat(z, azimuths)
    t, _ = surveyor.rays(start, np.tile(rim, (len(z), 1)), step, reach)
    radii: Array = t.reshape(len(z), azimuths).min(axis=1)
    return radii
