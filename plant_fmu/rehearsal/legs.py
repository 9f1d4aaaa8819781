"""Six legs on trestles: nothing between them, no weight on them, ends of travel, dry friction, hands.

A leg is a mass m under f, with friction and its brake as `plant_fmu.bench` has them. A hand on a leg is a
force; a lever on its brake lets it be moved anywhere; a gauge holds its end with a spring.
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import PlantError
from drivers.signals import LEGS
from plant_fmu.bench import advance
from plant_fmu.plant import Truth, whole_steps

GAUGE_YIELD_M = 5e-5
"""How far a gauge gives way under `LegBench.gauge_N`."""
HAND_M = 3e-3
"""A hand follows a leg that gives way so far."""
_DAMPING_N_s2_m2 = 2_000.0
_STEP_S = 1e-4


class LegBench(NamedTuple):
    """Figures of six legs on trestles; every array is (6,)."""

    mass_kg: Array
    friction_N: Array
    brake_N: Array
    """Force of an engaged brake."""
    shortest: Array
    """m, mechanical ends of travel."""
    longest: Array
    start: Array
    """m, lengths at power-up."""
    gauge_N: float
    """Force at which a gauge gives way by GAUGE_YIELD_M."""


class TrestleLegs:
    """Plant: six uncoupled legs at rest.

    Mutable state: lengths and rates, the hand's force on each leg, the leg at the gauge and where that is.
    """

    internal_step_s = _STEP_S

    def __init__(self, figures: LegBench) -> None:
        self._figures = figures
        self.reset()

    def reset(self) -> tuple[Array, Array]:
        """Back to rest at the first lengths; lengths (6,) m, rates (6,) m/s."""
        self._x = self._figures.start.copy()
        self._v = np.zeros(LEGS)
        self._hand, self._hand_from = np.zeros(LEGS), self._x.copy()
        self._gauge: tuple[int, float] | None = None
        return self._x.copy(), self._v.copy()

    def lengths(self) -> Array:
        """Return the lengths now, (6,) m."""
        return self._x.copy()

    def friction(self, leg: int) -> float:
        """Return the friction of a leg whose brake is open, N."""
        return float(self._figures.friction_N[leg])

    def place(self, leg: int, length: float) -> None:
        """Move a leg there, as far as it goes, with a lever on its brake."""
        f = self._figures
        self._x[leg] = min(max(length, f.shortest[leg]), f.longest[leg])
        self._v[leg] = 0.0

    def push(self, leg: int, force: float) -> None:
        """Lay a hand on a leg with so many N; it follows for HAND_M at most. 0 takes it away."""
        self._hand[leg] = force
        self._hand_from[leg] = self._x[leg]

    def pushed(self, leg: int) -> float:
        """Return the hand's force on a leg, N."""
        return float(self._hand[leg])

    def hold_at_gauge(self, leg: int | None) -> None:
        """Clamp the end of a leg to the force gauge; None takes it away."""
        self._gauge = None if leg is None else (leg, float(self._x[leg]))

    def gauge(self) -> float:
        """Return what the gauge reads, N, > 0 where the leg pushes. Raises PlantError without a leg there."""
        if self._gauge is None:
            raise PlantError("rehearsal: no leg is clamped to the force gauge")
        leg, origin = self._gauge
        return float(self._figures.gauge_N / GAUGE_YIELD_M * (self._x[leg] - origin))

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Hold force (6,) N and brake (6,) 0..1 for `dt_s`; lengths (6,) m and rates (6,) m/s at its end.

        Raises PlantError on a dt that is no multiple of the internal step, or a force that is not finite.
        """
        del wrench
        n, f = whole_steps(dt_s, _STEP_S), self._figures
        if not np.isfinite(force).all():
            raise PlantError(f"force {force}: a value is not finite")
        total, friction = force + self._hand, f.friction_N + brake * f.brake_N
        x, v = self._x, self._v
        for leg in range(LEGS):
            one = slice(leg, leg + 1)
            spring, origin = 0.0, 0.0
            if self._gauge is not None and self._gauge[0] == leg:
                spring, origin = f.gauge_N / GAUGE_YIELD_M, self._gauge[1]
            at = x[one] - origin
            m = float(f.mass_kg[leg])
            advance(at, v[one], total[one], friction[one], _STEP_S, n, m, _DAMPING_N_s2_m2, spring, 0.0)
            x[one] = at + origin
        low = np.where(self._hand < 0.0, np.maximum(f.shortest, self._hand_from - HAND_M), f.shortest)
        high = np.where(self._hand > 0.0, np.minimum(f.longest, self._hand_from + HAND_M), f.longest)
        v[(x < low) | (x > high)] = 0.0
        self._x = np.clip(x, low, high)
        return self._x.copy(), v.copy()

    def truth(self) -> Truth | None:
        """None: there is no platform."""
        return None

    def applied_force(self) -> Array | None:
        """None: there is no lag to know of."""
        return None

    def close(self) -> None:
        """Nothing to free."""
