"""Six legs on trestles: nothing between them, no weight on them, ends of travel, dry friction, hands.

A leg is a mass m under f, with friction and its brake as `plant_fmu.bench` has them. A hand on a leg is a
force; a lever on its brake lets it be moved anywhere; a gauge holds its end with a spring.
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, OUT_MATRIX, REAL, VECTOR, direct
from drivers.errors import PlantError
from drivers.signals import LEGS
from plant_fmu.bench import advance_leg
from plant_fmu.plant import Plant, whole_steps

GAUGE_YIELD_M = 5e-5
"""How far a gauge gives way under `LegBench.gauge_N`."""
HAND_M, HAND_m_s = 3e-3, 0.1
"""A hand follows a leg that gives way so far, and so fast."""
_DAMPING_N_s2_m2 = 2_000.0
_STEP_S = 1e-4
_NO_LEG = -1
_MASS, _FRICTION, _BRAKE, _SHORTEST, _LONGEST = range(5)
"""Rows of what the legs are: kg, N, N of an engaged brake, m, m."""
_X, _V, _HAND, _HAND_FROM = range(4)
"""Rows of their state: m, m/s, N of the hand on each, m where it was laid on."""


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


@direct(MATRIX, OUT_MATRIX, VECTOR, VECTOR, INTEGER, REAL, REAL, INTEGER)
def _advance(
    legs: Array, state: Array, force: Array, brake: Array, clamped: int, spring: float, gauge_m: float, n: int
) -> bool:
    """Hold force (6,) N and brake (6,) for n steps; return whether forces are finite, else nothing moves.

    The gauge is a spring, N/m, that holds leg `clamped` at the length gauge_m.
    """
    for leg in range(LEGS):
        if not np.isfinite(force[leg]):
            return False
    for leg in range(LEGS):
        k, origin = (spring, gauge_m) if leg == clamped else (0.0, 0.0)
        hand, from_m = state[_HAND, leg], state[_HAND_FROM, leg]
        f, friction = force[leg] + hand, legs[_FRICTION, leg] + brake[leg] * legs[_BRAKE, leg]
        x, v = state[_X, leg] - origin, state[_V, leg]
        damping = max(_DAMPING_N_s2_m2, abs(hand) / HAND_m_s**2)
        x, v = advance_leg(x, v, f, friction, _STEP_S, n, legs[_MASS, leg], damping, k, 0.0)
        x += origin
        low, high = legs[_SHORTEST, leg], legs[_LONGEST, leg]
        if hand < 0.0:
            low = max(low, from_m - HAND_M)
        if hand > 0.0:
            high = min(high, from_m + HAND_M)
        state[_V, leg] = 0.0 if x < low or x > high else v
        state[_X, leg] = min(max(x, low), high)
    return True


class TrestleLegs(Plant):
    """Plant: six uncoupled legs at rest.

    Mutable state: lengths and rates, the hand's force on each leg, the leg at the gauge and where that is.
    """

    internal_step_s = _STEP_S

    def __init__(self, figures: LegBench) -> None:
        self._figures = f = figures
        self._legs = np.array([f.mass_kg, f.friction_N, f.brake_N, f.shortest, f.longest])
        self.reset()

    def reset(self) -> tuple[Array, Array]:
        """Back to rest at the first lengths; lengths (6,) m, rates (6,) m/s."""
        self._state = np.zeros((_HAND_FROM + 1, LEGS))
        self._x, self._v, self._hand, self._hand_from = self._state
        self._x[:] = self._hand_from[:] = self._figures.start
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
        n = whole_steps(dt_s, _STEP_S)
        clamped, gauge_m = self._gauge or (_NO_LEG, 0.0)
        spring = self._figures.gauge_N / GAUGE_YIELD_M
        if not _advance(self._legs, self._state, force, brake, clamped, spring, gauge_m, n):
            raise PlantError(f"force {force}: a value is not finite")
        return self._x.copy(), self._v.copy()
