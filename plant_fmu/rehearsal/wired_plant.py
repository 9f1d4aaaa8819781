"""A plant behind wrong cables: what six drives see and do, made of what six legs do."""

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from plant_fmu.plant import Plant, Truth
from plant_fmu.rehearsal.wiring import Wiring


class WiredPlant:
    """Plant: forces and brakes of drives go to the legs that they are wired to, and encoders read theirs.

    Mutable state: the plant behind the cables, from `reset` on what frozen encoders read, and where
    those with play are.
    """

    def __init__(self, plant: Plant, wiring: Wiring, origin: Array) -> None:
        """Take the plant, and the lengths (6,) m of its legs at which a scale has no effect."""
        self._plant = plant
        self._wiring = wiring
        self._origin = origin
        self._frozen: Array | None = None
        self._followed = np.full(LEGS, np.inf)
        self.internal_step_s = plant.internal_step_s

    def exchange(self, plant: Plant) -> None:
        """Connect the cables to another plant of the same step, which begins anew."""
        self._plant = plant
        plant.reset()

    def reset(self) -> tuple[Array, Array]:
        """Reset the plant; lengths (6,) m and rates (6,) m/s as the encoders read them."""
        self._frozen, self._followed = None, np.full(LEGS, np.inf)
        read = self._read(*self._plant.reset())
        self._frozen = read[0].copy()
        return read

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Hold force (6,) N and brake (6,) of the drives for `dt_s`; what their encoders read at its end."""
        w = self._wiring
        at_leg, held = np.zeros(LEGS), np.ones(LEGS)
        for drive in range(LEGS):
            if w.present[drive] and not w.other_protocol[drive]:
                at_leg[w.motor[drive]] += w.force_gain[drive] * force[drive]
                for leg in w.brake[drive]:
                    held[leg] = min(held[leg], brake[drive])
        for leg, stuck in enumerate(w.stuck):
            if stuck is not None:
                held[leg] = stuck
        held *= w.brake_share
        return self._read(*self._plant.step(at_leg, held, wrench, dt_s))

    def _read(self, length: Array, rate: Array) -> tuple[Array, Array]:
        w = self._wiring
        legs = list(w.encoder)
        scale = np.array(w.scale)
        self._followed = np.clip(self._followed, length[legs] - np.array(w.play_m), length[legs])
        place = self._followed - self._origin[legs]
        beyond = place > 0.0
        place = np.where(np.array(w.stops) & beyond, 0.0, place) + np.where(beyond, w.jump_m, 0.0)
        reads = self._origin[legs] + scale * place + np.array(w.offset_m)
        rates = scale * rate[legs]
        if self._frozen is not None:
            stands = np.array(w.frozen)
            reads, rates = np.where(stands, self._frozen, reads), np.where(stands, 0.0, rates)
        return reads, rates

    def truth(self) -> Truth | None:
        """Return what the plant knows."""
        return self._plant.truth()

    def applied_force(self) -> Array | None:
        """None: drives report what they believe to give."""
        return None

    def close(self) -> None:
        """Free what the plant holds."""
        self._plant.close()
