"""A plant behind wrong cables: what six drives see and do, made of what six legs do."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from plant_fmu.plant import Plant, Truth
from plant_fmu.rehearsal.wiring import Wiring


class WiredPlant(Plant):
    """Plant: forces and brakes of drives go to the legs that they are wired to, and encoders read theirs.

    Mutable state: the plant behind the cables, from `reset` on what frozen encoders read, and where
    those with play are.
    """

    def __init__(self, plant: Plant, wiring: Wiring, origin: Array, rated_N: float = 1.0) -> None:
        """Take the plant, lengths (6,) m of its legs at which a scale has no effect, and the rated force."""
        self._plant = plant
        arrays = {name: np.array(each) for name, each in vars(wiring).items()}
        self._wires: Any = SimpleNamespace(**arrays)
        w = self._wires
        w.driven = w.present & ~w.other_protocol
        opens = [[leg in legs for leg in range(LEGS)] for legs in wiring.brake]
        w.opens = np.array(opens) & w.driven[:, None]
        w.most = rated_N * w.force_most
        w.least = np.where(w.force_one_way, 0.0, -w.most)
        w.stuck = np.array(wiring.stuck, float)  # NaN for None
        self._origin = origin[w.encoder]
        self._at_start: Array | None = None
        self._followed = np.full(LEGS, np.inf)
        self.internal_step_s = plant.internal_step_s

    def exchange(self, plant: Plant) -> None:
        """Connect the cables to another plant of the same step, which begins anew."""
        self._plant = plant
        plant.reset()

    def reset(self) -> tuple[Array, Array]:
        """Reset the plant; lengths (6,) m and rates (6,) m/s as the encoders read them."""
        self._at_start, self._followed = None, np.full(LEGS, np.inf)
        reads, rates = self._read(*self._plant.reset())
        self._at_start = reads.copy()
        return reads, rates

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Hold force (6,) N and brake (6,) of the drives for `dt_s`; what their encoders read at its end."""
        w, at_leg = self._wires, np.zeros(LEGS)
        given = w.force_gain * np.minimum(np.maximum(force, w.least), w.most)
        np.add.at(at_leg, w.motor, np.where(w.driven, given, 0.0))
        held = np.where(w.opens, brake[:, None], 1.0).min(axis=0)
        held = np.where(w.brake_inverted, 1.0 - held, held)
        held = w.brake_share * np.where(np.isnan(w.stuck), held, w.stuck)
        return self._read(*self._plant.step(at_leg, held, wrench, dt_s))

    def _read(self, length: Array, rate: Array) -> tuple[Array, Array]:
        """Return what encoders read, m and m/s, of legs at length (6,) m and rate (6,) m/s."""
        w = self._wires
        at = length[w.encoder]
        self._followed = np.minimum(np.maximum(self._followed, at - w.play_m), at)
        place = self._followed - self._origin
        place = np.where(place > 0.0, np.where(w.stops, 0.0, place) + w.jump_m, place)
        reads = self._origin + w.scale * place + w.offset_m
        rates = w.scale * w.rate_scale * rate[w.encoder]
        if self._at_start is not None:
            reads, rates = np.where(w.frozen, self._at_start, reads), np.where(w.frozen, 0.0, rates)
        return reads, rates

    def truth(self) -> Truth | None:
        """Return what the plant knows."""
        return self._plant.truth()

    def close(self) -> None:
        """Free what the plant holds."""
        self._plant.close()
