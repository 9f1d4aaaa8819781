"""Reaching and boundary layers: proven properties of sliding mode and the Lyapunov redesign.

Under the model error (module disturbance) s = de + lambda e of the legs, and y = de + K_D / 2 e
over all legs at once, obey

::

    ds/dt = (I - Gamma) lambda de - k Gamma sat(s / phi) - d
    dy/dt = -(Gamma - I/2) K_D y + ((Gamma - I/2) K_D^2 / 2 - Gamma K_P) e - rho Gamma y / |y| - d

Outside the layer |s| decreases at least by gamma k - |d|, reduced by alpha lambda |de|. Inside, the law is
linear; if its |s| stays below phi, s never leaves the layer. Derived in docs/theory/stability.md.
"""

from math import inf
from typing import NamedTuple


class Reaching(NamedTuple):
    """Proven bounds on how a law with a boundary layer reaches the layer and stays in it."""

    surplus: float
    """m/s^2, smallest rate at which s approaches the layer while leg errors are small; <= 0: not
    guaranteed."""
    room: float
    """Largest leg error at which s approaches the layer with half of `surplus`: any |de| in m/s (sliding
    mode), the norm of e in m (redesign); inf: no error reduces `surplus`."""
    inside: float
    """m/s, largest |s| after s has entered the layer."""
    layer: float
    """m/s, boundary layer of the law."""

    @property
    def covered(self) -> bool:
        """True if the sliding variable s is proven to reach the layer and never leave it."""
        return self.surplus > 0.0 and self.inside <= self.layer

    def time_s(self, s: float) -> float:
        """Longest time from |s| m/s to the layer, with leg errors within `room`; inf: never."""
        way = max(abs(s) - self.layer, 0.0)
        pace = self.surplus if self.room == inf else 0.5 * self.surplus
        return way / pace if pace > 0.0 else inf


def sliding(
    slope: float, k: float, layer: float, *, gamma: float, alpha: float, d: float, inside: float
) -> Reaching:
    """Reaching of s = de + slope e of a leg under a correction of up to k m/s^2, linear in its layer.

    gamma: smallest share of a requested acceleration that the robot executes; alpha: largest deviation from
    all of it; d: m/s^2, largest disturbance; inside: m/s, the largest |s| of the linear loop.
    """
    surplus = gamma * k - d
    room = inf if alpha <= 1e-9 else 0.5 * surplus / (alpha * slope)
    return Reaching(surplus, room, inside, layer)


def redesign(
    K_P: float, K_D: float, rho: float, layer: float, *, gamma: float, alpha: float, d: float, inside: float
) -> Reaching:
    """Reaching of y = de + K_D / 2 e of all legs under a correction of up to rho m/s^2.

    K_P, K_D: of the law outside its layer; the other arguments as for `sliding`, over all legs.
    """
    surplus = gamma * rho - d + (gamma - 0.5) * K_D * layer
    coupling = abs(K_D**2 / 4.0 - K_P) + alpha * abs(K_D**2 / 2.0 - K_P)
    room = inf if coupling <= 1e-9 * K_P else 0.5 * surplus / coupling
    return Reaching(surplus, room, inside, layer)
