"""Reaching and boundary layers: what sliding mode and the Lyapunov redesign promise, with the figures stated.

Under what the model does not know (hil.stability.disturbance: gamma, |d|) the sliding variable
s = de + lambda e of a leg obeys

::

    ds/dt = (1 - gamma) lambda de - gamma k sat(s / phi) - d

- Outside the layer |s| falls by gamma k - |d| at least, and by |1 - gamma| lambda |de| less: the layer is
  reached.
- Inside, the law is linear, K_P = lambda k / phi and K_D = lambda + k / phi, and so is the loop. |s| stays
  below its peak gain from d times |d|: where that is no more than phi the layer is never left, and the
  ultimate bound of the linear loop holds. With gamma = 1 both conditions are one, k >= |d|.

The Lyapunov redesign has y = de + K_D / 2 e over all legs at once, rho for k, epsilon for phi, and a linear
part of its own that helps:

::

    dy/dt = -(gamma - 1/2) K_D y + ((gamma - 1/2) K_D^2 / 2 - gamma K_P) e - gamma rho y / |y| - d
"""

from math import inf
from typing import NamedTuple

from hil.stability.reachable import peak_gain


class Reaching(NamedTuple):
    """What a law with a boundary layer promises."""

    surplus: float
    """m/s^2, by which s approaches the edge of the layer at least; not above 0: it need not."""
    room: float
    """How much the legs may be off for that: |de| in m/s (sliding mode), |e| in m (redesign)."""
    inside: float
    """m/s, the largest |s| once inside; inf without a layer."""
    layer: float
    """m/s."""

    @property
    def covered(self) -> bool:
        """Tell whether the layer is reached, and never left."""
        return self.surplus > 0.0 and (self.layer == 0.0 or self.inside <= self.layer)

    def time_s(self, s: float) -> float:
        """Return how long it takes at most from |s| m/s to the layer, within that room; inf for ever."""
        way = max(abs(s) - self.layer, 0.0)
        return way / self.surplus if self.surplus > 0.0 else inf


def sliding(
    slope: float, k: float, layer: float, *, gamma: float, d: float, linear: tuple[float, float]
) -> Reaching:
    """Return what s = de + slope e of a leg does under a correction of up to k m/s^2, linear in its layer.

    gamma: share of what is asked for that the robot does; d: m/s^2, largest disturbance; linear: K_P and
    K_D inside the layer.

    Raises ModelError where the linear loop is not stable.
    """
    surplus = gamma * k - d
    room = inf if gamma == 1.0 else surplus / (abs(1.0 - gamma) * slope)
    return Reaching(surplus, room, _inside(slope, layer, gamma, d, linear), layer)


def redesign(
    K_P: float, K_D: float, rho: float, layer: float, *, gamma: float, d: float, linear: tuple[float, float]
) -> Reaching:
    """Return what y = de + K_D / 2 e of all legs does under a correction of up to rho m/s^2.

    K_P, K_D: of the law outside its layer; the rest as for `sliding`, d over all legs.

    Raises ModelError where the linear loop is not stable.
    """
    surplus = gamma * rho - d + (gamma - 0.5) * K_D * layer
    coupling = abs((gamma - 0.5) * K_D**2 / 2.0 - gamma * K_P)
    room = inf if coupling <= 1e-9 * K_P else surplus / coupling
    return Reaching(surplus, room, _inside(K_D / 2.0, layer, gamma, d, linear), layer)


def _inside(slope: float, layer: float, gamma: float, d: float, linear: tuple[float, float]) -> float:
    K_P, K_D = linear
    return inf if layer == 0.0 else peak_gain(gamma * K_P, gamma * K_D, slope, 1.0) * d
