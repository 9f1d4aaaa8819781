"""Six legs on trestles: nothing between them, no weight on them, ends of travel, dry friction, hands.

A hand on a leg is a force. A lever on its brake lets it be moved anywhere. A gauge holds its end by a spring.
"""

from typing import Any

import numpy as np

from drivers.errors import PlantError
from plant_fmu.bench import UncoupledLegs

GAUGE_YIELD_M = 5e-5
"""How far a gauge gives way under its force."""
_DAMPING_N_s2_m2 = 2_000.0
_STEP_S = 1e-4


class TrestleLegs(UncoupledLegs):
    """Plant: six uncoupled legs at rest, x their lengths."""

    def __init__(self, gauge_N: float, **figures: Any) -> None:
        """Take the force at which a gauge gives way by GAUGE_YIELD_M, and fields of BENCH."""
        super().__init__(_STEP_S, damping=_DAMPING_N_s2_m2, **figures)
        self._gauge_N_m = gauge_N / GAUGE_YIELD_M

    def place(self, leg: int, length: float) -> None:
        """Move a leg there, as far as it goes, with a lever on its brake."""
        at = self.legs
        at["x"][leg] = min(max(length, at["shortest"][leg]), at["longest"][leg])
        at["v"][leg] = 0.0

    def push(self, leg: int, force: float) -> None:
        """Lay a hand on a leg with so many N; it follows for HAND_M at most. 0 takes it away."""
        self.legs["hand"][leg], self.legs["hand_from"][leg] = force, self.legs["x"][leg]

    def hold_at_gauge(self, leg: int | None) -> None:
        """Clamp the end of a leg to the force gauge; None takes it away."""
        self.legs["stiffness"] = self.legs["origin"] = 0.0
        if leg is not None:
            self.legs["stiffness"][leg], self.legs["origin"][leg] = self._gauge_N_m, self.legs["x"][leg]

    def gauge(self) -> float:
        """Return what the gauge reads, N, > 0 where the leg pushes. Raises PlantError without a leg there."""
        legs = self.legs
        if not legs["stiffness"].any():
            raise PlantError("rehearsal: no leg is clamped to the force gauge")
        return float(np.sum(legs["stiffness"] * (legs["x"] - legs["origin"])))
