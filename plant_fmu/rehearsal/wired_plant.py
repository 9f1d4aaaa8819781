"""A plant behind wrong cables: readings and effects of six drives, derived from six legs."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, OUT_VECTOR, VECTOR, helper, kernel, record
from drivers.compiled.pointed import call, data_at, pointed, reals_at
from drivers.signals import LEGS
from plant_fmu.drives.drive import moved
from plant_fmu.plant import Moved, Plant, PointedPlant, Truth
from plant_fmu.rehearsal.wiring import Wiring

_AS_WIRED = {
    "<i8": ("motor", "encoder", "stops", "frozen", "force_one_way", "brake_inverted"),
    "<f8": ("force_gain", "scale", "rate_scale", "offset_m", "jump_m", "play_m", "brake_share"),
}
WIRES = np.dtype(
    [(name, kind, LEGS) for kind, names in _AS_WIRED.items() for name in names]
    + [(name, "<i8", LEGS) for name in ("opens", "driven")]
    + [(name, "<i8") for name in ("move", "context")]
    + [(name, "<f8", LEGS) for name in ("most", "stuck", "origin", "at_start", "followed")]
)
"""Fields of `Wiring`. Bit mask of the brakes that each drive opens (bit i: leg i); 1 if the drive takes part.
The plant behind the cables by address, see `Moved`. Largest force of each drive, N. Of each leg, the position
of a stuck brake, NaN for one that works, and the length at which a scale has no effect, m. State of each
drive: reading of a frozen encoder, m, NaN before it is known; position of an encoder with play, m."""


@helper
def _connect(w: Any, force: Array, brake: Array, at_leg: Array, held: Array) -> None:
    """Fill in forces and brakes at the legs from forces (6,) N and brakes (6,) of the drives."""
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


@helper
def _read(w: Any, length: Array, rate: Array, reads: Array, rates: Array) -> None:
    """Fill in readings of the encoders, m and m/s, for legs at length (6,) m and rate (6,) m/s."""
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


_read_at = kernel(record(WIRES), VECTOR, VECTOR, OUT_VECTOR, OUT_VECTOR)(_read)


@pointed(record(WIRES), *[INTEGER] * 5)
def _move(w: Any, force: int, brake: int, wrench: int, steps: int, measured: int) -> int:
    at_leg, held, reads = np.empty(LEGS), np.empty(LEGS), reals_at(measured, 2 * LEGS)
    _connect(w, reals_at(force, LEGS), reals_at(brake, LEGS), at_leg, held)
    given = np.int64(at_leg.ctypes.data), np.int64(held.ctypes.data)
    status = call(w.move, (w.context, *given, wrench, steps, measured))
    legs = reads.copy()
    _read(w, legs[:LEGS], legs[LEGS:], reads[:LEGS], reads[LEGS:])
    return int(status)


@pointed(record(WIRES), INTEGER)
def _applied(_w: Any, _force: int) -> int:
    return 0


class WiredPlant(PointedPlant):
    """Plant: forces and brakes of drives act on, and encoders read, the legs to which they are wired.

    Mutable state: the plant behind the cables; from `reset` on the readings of frozen encoders, and the
    positions of encoders with play.
    """

    def __init__(self, plant: Plant, wiring: Wiring, origin: Array, rated_N: float = 1.0) -> None:
        """Create a wired plant.

        origin: leg lengths (6,) m at which an error of scale has no effect; rated_N: rated force of a drive.
        """
        w, self._wires = wiring, np.zeros((), WIRES)
        self._connect(plant)
        for names in _AS_WIRED.values():
            for name in names:
                self._wires[name] = getattr(w, name)
        self._wires["opens"] = [sum(1 << leg for leg in legs) for legs in w.brake]
        self._wires["driven"] = np.array(w.present) & ~np.array(w.other_protocol)
        self._wires["most"] = rated_N * np.array(w.force_most)
        self._wires["stuck"] = [np.nan if at is None else at for at in w.stuck]
        self._wires["origin"], self._wires["at_start"], self._wires["followed"] = origin, np.nan, np.inf
        self.internal_step_s = plant.internal_step_s

    def _connect(self, plant: Plant) -> None:
        self._plant, self._behind = plant, moved(plant)
        self._wires["move"], self._wires["context"] = self._behind.move, self._behind.context

    def exchange(self, plant: Plant) -> None:
        """Connect the cables to another plant with the same step, and reset it."""
        self._connect(plant)
        plant.reset()

    def reset(self) -> tuple[Array, Array]:
        """Reset the plant; return lengths (6,) m and rates (6,) m/s as the encoders read them."""
        self._wires["at_start"], self._wires["followed"] = np.nan, np.inf
        reads, rates = np.empty(LEGS), np.empty(LEGS)
        _read_at(self._wires, *self._plant.reset(), reads, rates)
        self._wires["at_start"] = reads
        return reads, rates

    def moved(self) -> Moved:
        """Functions and context of this plant by address."""
        return Moved(_move.address, _applied.address, data_at(self._wires), self._refused, self)

    def _refused(self, status: int, force: Array, brake: Array, wrench: Array, steps: int) -> BaseException:
        return self._behind.refused(status, force, brake, wrench, steps)

    def truth(self) -> Truth | None:
        """Truth of the plant behind the cables."""
        return self._plant.truth()

    def close(self) -> None:
        """Free the resources of the plant behind the cables."""
        self._plant.close()
