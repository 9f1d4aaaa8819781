"""Six legs on trestles: nothing between them, no weight on them, ends of travel, dry friction, hands.

A leg is a mass m under f, with friction and its brake as `plant_fmu.bench` has them. A hand on a leg is a
force; a lever on its brake lets it be moved anywhere; a gauge holds its end with a spring.
"""

from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import data_at, pointed, reals_at
from drivers.errors import PlantError
from drivers.signals import LEGS
from drivers.tick_columns import Record
from plant_fmu.bench import advance_leg, all_finite, no_lag
from plant_fmu.plant import Moved, PointedPlant

GAUGE_YIELD_M = 5e-5
"""How far a gauge gives way under `LegBench.gauge_N`."""
HAND_M, HAND_m_s = 3e-3, 0.1
"""A hand follows a leg that gives way so far, and so fast."""
_DAMPING_N_s2_m2 = 2_000.0
_STEP_S = 1e-4
_NO_LEG = -1


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


TRESTLES = np.dtype(
    [(name, "<f8", (LEGS,)) for name in (*LegBench._fields[:-1], "x", "v", "hand", "hand_from")]
    + [("gauge_N", "<f8"), ("clamped", "<i8"), ("gauge_m", "<f8")]
)
"""Legs as `LegBench` has them. Their state: m, m/s, N of the hand on each, m where it was laid on. The leg at
the gauge and the length at which that holds it, m."""


@pointed(record(TRESTLES), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def _move(w: Any, force: int, brake: int, _wrench: int, steps: int, measured: int) -> int:
    """As `Moved.move`; 1 where forces are not finite: nothing moves. The gauge is a spring."""
    forces, brakes, into = reals_at(force, LEGS), reals_at(brake, LEGS), reals_at(measured, 2 * LEGS)
    if not all_finite(forces):
        return 1
    for leg in range(LEGS):
        k, origin = (w.gauge_N / GAUGE_YIELD_M, w.gauge_m) if leg == w.clamped else (0.0, 0.0)
        hand, from_m = w.hand[leg], w.hand_from[leg]
        f, friction = forces[leg] + hand, w.friction_N[leg] + brakes[leg] * w.brake_N[leg]
        damping = max(_DAMPING_N_s2_m2, abs(hand) / HAND_m_s**2)
        mass = w.mass_kg[leg]
        x, v = advance_leg(w.x[leg] - origin, w.v[leg], f, friction, _STEP_S, steps, mass, damping, k, 0.0)
        x += origin
        low, high = w.shortest[leg], w.longest[leg]
        if hand < 0.0:
            low = max(low, from_m - HAND_M)
        if hand > 0.0:
            high = min(high, from_m + HAND_M)
        w.v[leg] = 0.0 if x < low or x > high else v
        w.x[leg] = min(max(x, low), high)
        into[leg], into[LEGS + leg] = w.x[leg], w.v[leg]
    return 0


class TrestleLegs(PointedPlant):
    """Plant: six uncoupled legs at rest.

    Mutable state: lengths and rates, the hand's force on each leg, the leg at the gauge and where that is.
    """

    internal_step_s = _STEP_S

    def __init__(self, figures: LegBench) -> None:
        self.record: Record = np.zeros((), TRESTLES)
        for name, value in figures._asdict().items():
            self.record[name] = value
        self.reset()

    def reset(self) -> tuple[Array, Array]:
        """Back to rest at the first lengths; lengths (6,) m, rates (6,) m/s."""
        w = self.record
        w["x"] = w["hand_from"] = w["start"]
        w["v"] = w["hand"] = 0.0
        w["clamped"] = _NO_LEG
        return w["x"].copy(), w["v"].copy()

    def moved(self) -> Moved:
        """Return this plant by address."""
        return Moved(_move.address, no_lag.address, data_at(self.record), self._refused, self)

    def _refused(self, _status: int, force: Array, *_given: Any) -> PlantError:
        return PlantError(f"force {force}: a value is not finite")

    def lengths(self) -> Array:
        """Return the lengths now, (6,) m."""
        lengths: Array = self.record["x"].copy()
        return lengths

    def friction(self, leg: int) -> float:
        """Return the friction of a leg whose brake is open, N."""
        return float(self.record["friction_N"][leg])

    def place(self, leg: int, length: float) -> None:
        """Move a leg there, as far as it goes, with a lever on its brake."""
        w = self.record
        w["x"][leg] = min(max(length, w["shortest"][leg]), w["longest"][leg])
        w["v"][leg] = 0.0

    def push(self, leg: int, force: float) -> None:
        """Lay a hand on a leg with so many N; it follows for HAND_M at most. 0 takes it away."""
        w = self.record
        w["hand"][leg], w["hand_from"][leg] = force, w["x"][leg]

    def pushed(self, leg: int) -> float:
        """Return the hand's force on a leg, N."""
        return float(self.record["hand"][leg])

    def hold_at_gauge(self, leg: int | None) -> None:
        """Clamp the end of a leg to the force gauge; None takes it away."""
        w = self.record
        w["clamped"] = _NO_LEG if leg is None else leg
        w["gauge_m"] = w["x"][w["clamped"]]

    def gauge(self) -> float:
        """Return what the gauge reads, N, > 0 where the leg pushes. Raises PlantError without a leg there."""
        w = self.record
        if w["clamped"] == _NO_LEG:
            raise PlantError("rehearsal: no leg is clamped to the force gauge")
        return float(w["gauge_N"] / GAUGE_YIELD_M * (w["x"][w["clamped"]] - w["gauge_m"]))
