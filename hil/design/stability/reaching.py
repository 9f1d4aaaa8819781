"""Reaching and boundary layers: what sliding mode and the Lyapunov redesign promise, with the figures stated.

Under what the model does not know (module disturbance) s = de + lambda e of the legs, and y = de + K_D / 2 e
over all legs at once, obey

::

    ds/dt = (I - Gamma) lambda de - k Gamma sat(s / phi) - d
    dy/dt = -(Gamma - I/2) K_D y + ((Gamma - I/2) K_D^2 / 2 - Gamma K_P) e - rho Gamma y / |y| - d

Outside the layer |s| falls by gamma k - |d| at least, and by alpha lambda |de| less; inside, the law is
linear, and where its |s| stays below phi the layer is never left. Derived in docs/theory/stability.md.
"""

from math import inf
from typing import NamedTuple


class Reaching(NamedTuple):
    """What a law with a boundary layer promises."""

    surplus: float
    """m/s^2, by which s approaches the edge of the layer at least while legs are hardly off; not above 0: it
    need not."""
    room: float
    """How much the legs may be off for half of that: any |de| in m/s (sliding mode), the norm of e in m
    (redesign); inf: by anything, for all of it."""
    inside: float
    """m/s, the largest |s| once inside."""
    layer: float
    """m/s."""

    @property
    def covered(self) -> bool:
        """Tell whether the layer is reached, and never left."""
        return self.surplus > 0.0 and self.inside <= self.layer

    def time_s(self, s: float) -> float:
        """Return how long it takes at most from |s| m/s to the layer, within that room; inf for ever."""
        way = max(abs(s) - self.layer, 0.0)
        pace = self.surplus if self.room == inf else 0.5 * self.surplus
        return way / pace if pace > 0.0 else inf


def sliding(
    slope: float, k: float, layer: float, *, gamma: float, alpha: float, d: float, inside: float
) -> Reaching:
    """Return what s = de + slope e of a leg does under a correction of up to k m/s^2, linear in its layer.

    gamma: share of what is asked for that the robot does at least; alpha: how far it is from all of it; d:
    m/s^2, largest disturbance; inside: m/s, the largest |s| of the loop that is linear.
    """
    surplus = gamma * k - d
    room = inf if alpha <= 1e-9 else 0.5 * surplus / (alpha * slope)
    return Reaching(surplus, room, inside, layer)


def redesign(
    K_P: float, K_D: float, rho: float, layer: float, *, gamma: float, alpha: float, d: float, inside: float
) -> Reaching:
    """Return what y = de + K_D / 2 e of all legs does under a correction of up to rho m/s^2.

    K_P, K_D: of the law outside its layer; the rest as for `sliding`, over all legs.
    """
    surplus = gamma * rho - d + (gamma - 0.5) * K_D * layer
    coupling = abs(K_D**2 / 4.0 - K_P) + alpha * abs(K_D**2 / 2.0 - K_P)
    room = inf if coupling <= 1e-9 * K_P else 0.5 * surplus / coupling
    return Reaching(surplus, room, inside, layer)
