"""A plant behind wrong cables: what six drives see and do, made of what six legs do."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import OUT_VECTOR, VECTOR, direct, record
from drivers.signals import LEGS
from plant_fmu.plant import Plant, Truth
from plant_fmu.rehearsal.wiring import Wiring

_AS_WIRED = {
    "<i8": ("motor", "encoder", "stops", "frozen", "force_one_way", "brake_inverted"),
    "<f8": ("force_gain", "scale", "rate_scale", "offset_m", "jump_m", "play_m", "brake_share"),
}
WIRES = np.dtype(
    [(name, kind, LEGS) for kind, names in _AS_WIRED.items() for name in names]
    + [(name, "<i8", LEGS) for name in ("opens", "driven")]
    + [(name, "<f8", LEGS) for name in ("most", "stuck", "origin", "at_start", "followed")]
)
"""Fields of `Wiring`; brakes that each drive opens (bit i: leg i); 1 where it takes part; its most force, N;
of each leg where its brake is stuck, NaN for one that works, and the length at which a scale has no effect,
m. State of each drive: m, what a frozen encoder reads, NaN before that is known; m, where an encoder stands
that follows its leg with play."""


@direct(record(WIRES), VECTOR, VECTOR, OUT_VECTOR, OUT_VECTOR)
def _connect(w: Any, force: Array, brake: Array, at_leg: Array, held: Array) -> None:
    """Fill in what forces (6,) N and brakes (6,) of the drives are at the legs."""
    at_leg[:], held[:] = 0.0, 1.0
    for drive in range(LEGS):
        if w.driven[drive]:
            low = 0.0 if w.force_one_way[drive] else -w.most[drive]
            given = min(max(force[drive], low), w.most[drive])
            at_leg[w.motor[drive]] += w.force_gain[drive] * given
            for leg in range(LEGS):
                if w.opens[drive] >> leg & 1:
                    held[leg] = min(held[leg], brake[drive])
    for leg in range(LEGS):
        if w.brake_inverted[leg]:
            held[leg] = 1.0 - held[leg]
        if not np.isnan(w.stuck[leg]):
            held[leg] = w.stuck[leg]
        held[leg] *= w.brake_share[leg]


@direct(record(WIRES), VECTOR, VECTOR, OUT_VECTOR, OUT_VECTOR)
def _read(w: Any, length: Array, rate: Array, reads: Array, rates: Array) -> None:
    """Fill in what encoders read, m and m/s, of legs at length (6,) m and rate (6,) m/s."""
    for drive in range(LEGS):
        leg = w.encoder[drive]
        w.followed[drive] = min(max(w.followed[drive], length[leg] - w.play_m[drive]), length[leg])
        place = w.followed[drive] - w.origin[leg]
        if place > 0.0:
            place = (0.0 if w.stops[drive] else place) + w.jump_m[drive]
        reads[drive] = w.origin[leg] + w.scale[drive] * place + w.offset_m[drive]
        rates[drive] = w.scale[drive] * w.rate_scale[drive] * rate[leg]
        if w.frozen[drive] and not np.isnan(w.at_start[drive]):
            reads[drive], rates[drive] = w.at_start[drive], 0.0


class WiredPlant(Plant):
    """Plant: forces and brakes of drives go to the legs that they are wired to, and encoders read theirs.

    Mutable state: the plant behind the cables, from `reset` on what frozen encoders read, and where
    those with play are.
    """

    def __init__(self, plant: Plant, wiring: Wiring, origin: Array, rated_N: float = 1.0) -> None:
        """Take the plant, lengths (6,) m of its legs at which a scale has no effect, and the rated force."""
        self._plant = plant
        w, self._wires = wiring, np.zeros((), WIRES)
        for names in _AS_WIRED.values():
            for name in names:
                self._wires[name] = getattr(w, name)
        self._wires["opens"] = [sum(1 << leg for leg in legs) for legs in w.brake]
        self._wires["driven"] = np.array(w.present) & ~np.array(w.other_protocol)
        self._wires["most"] = rated_N * np.array(w.force_most)
        self._wires["stuck"] = [np.nan if at is None else at for at in w.stuck]
        self._wires["origin"], self._wires["at_start"], self._wires["followed"] = origin, np.nan, np.inf
        self.internal_step_s = plant.internal_step_s

    def exchange(self, plant: Plant) -> None:
        """Connect the cables to another plant of the same step, which begins anew."""
        self._plant = plant
        plant.reset()

    def reset(self) -> tuple[Array, Array]:
        """Reset the plant; lengths (6,) m and rates (6,) m/s as the encoders read them."""
        self._wires["at_start"], self._wires["followed"] = np.nan, np.inf
        reads, rates = self._read(*self._plant.reset())
        self._wires["at_start"] = reads
        return reads, rates

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Hold force (6,) N and brake (6,) of the drives for `dt_s`; what their encoders read at its end."""
        at_leg, held = np.empty(LEGS), np.empty(LEGS)
        _connect(self._wires, force, brake, at_leg, held)
        return self._read(*self._plant.step(at_leg, held, wrench, dt_s))

    def _read(self, length: Array, rate: Array) -> tuple[Array, Array]:
        reads, rates = np.empty(LEGS), np.empty(LEGS)
        _read(self._wires, length, rate, reads, rates)
        return reads, rates

    def truth(self) -> Truth | None:
        """Return what the plant knows."""
        return self._plant.truth()

    def close(self) -> None:
        """Free what the plant holds."""
        self._plant.close()
