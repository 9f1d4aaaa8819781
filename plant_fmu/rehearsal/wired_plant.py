"""A plant behind wrong cables: readings and forces of six drives, derived from those of six legs."""

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
    "<f8": (
        *("force_gain", "scale", "rate_scale", "offset_m", "jump_m", "play_m", "brake_share"),
        *("brake_late_s", "force_lag_s"),
    ),
}
WIRES = np.dtype(
    [(name, kind, LEGS) for kind, names in _AS_WIRED.items() for name in names]
    + [(name, "<i8", LEGS) for name in ("opens", "driven", "late")]
    + [(name, "<i8") for name in ("move", "context", "timed", "past", "room", "k")]
    + [(name, "<f8", LEGS) for name in ("most", "coupling", "stuck", "origin", "at_start", "followed")]
    + [(name, "<f8", LEGS) for name in ("shut_s", "lagged", "slipped", "slips")]
    + [(name, "<f8") for name in ("h_s", "rated")]
)
"""Fields of `Wiring`. Bit mask of the brakes that each drive opens (bit i: leg i); 1 if the drive takes part;
age of its encoder reading, steps. The plant behind the cables by address, see `Moved`; 1 to take steps one by
one. Buffer of past lengths and rates by address, its number of rows, and the number of steps so far. Largest
force of each drive and of its coupling, N. Of each leg, position of a stuck brake, NaN for one that works;
length at which a scale has no effect, m. State of each drive: reading of a frozen encoder, m, NaN before it
is known; position of an encoder with play, m. Of each leg, time since its brake was closed, s. Of each drive,
lagging force, N; slip of its coupling, m, and its rate, m/s. Step of the plant, s; rated force, N."""
SLIP_m_s = 2.0
"""Speed at which a coupling slips, per rated force in excess of what it carries."""


@helper
def _late(w: Any, drive: int, given: float) -> float:
    """Force, N, of a drive after its lag and its slipping coupling; updates the slip of the coupling."""
    if w.force_lag_s[drive] > 0.0:
        w.lagged[drive] += (given - w.lagged[drive]) * min(1.0, w.h_s / w.force_lag_s[drive])
        given = w.lagged[drive]
    carried = min(max(given, -w.coupling[drive]), w.coupling[drive])
    w.slips[drive] = SLIP_m_s * (given - carried) / w.rated
    w.slipped[drive] += w.slips[drive] * w.h_s
    return float(carried)


@helper
def _connect(w: Any, force: Array, brake: Array, at_leg: Array, held: Array) -> None:
    """Fill in forces (6,) N and brakes (6,) at the legs from those that the drives apply."""
    at_leg[:], held[:] = 0.0, 1.0
    for drive in range(LEGS):
        if w.driven[drive]:
            low = 0.0 if w.force_one_way[drive] else -w.most[drive]
            given = min(max(force[drive], low), w.most[drive])
            if w.timed:
                given = _late(w, drive, given)
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
        if w.timed:
            w.shut_s[leg] = w.shut_s[leg] + w.h_s if held[leg] > 0.0 else 0.0
            if w.shut_s[leg] <= w.brake_late_s[leg]:
                held[leg] = 0.0


@helper
def _read(w: Any, length: Array, rate: Array, reads: Array, rates: Array) -> None:
    past, now = reals_at(w.past, w.room * 2 * LEGS), w.k % w.room * 2 * LEGS
    for leg in range(LEGS):
        past[now + leg], past[now + LEGS + leg] = length[leg], rate[leg]
    for drive in range(LEGS):
        leg = w.encoder[drive]
        then = (w.k - w.late[drive]) % w.room * 2 * LEGS
        if np.isnan(past[then]):
            then = 0
        l, dl = past[then + leg], past[then + LEGS + leg]
        w.followed[drive] = min(max(w.followed[drive], l - w.play_m[drive]), l)
        place = w.followed[drive] - w.origin[leg]
        if place > 0.0:
            place = (0.0 if w.stops[drive] else place) + w.jump_m[drive]
        reads[drive] = w.origin[leg] + w.scale[drive] * (place + w.slipped[drive]) + w.offset_m[drive]
        rates[drive] = w.scale[drive] * w.rate_scale[drive] * (dl + w.slips[drive])
        if w.frozen[drive] and not np.isnan(w.at_start[drive]):
            reads[drive], rates[drive] = w.at_start[drive], 0.0
    w.k += 1


_read_at = kernel(record(WIRES), VECTOR, VECTOR, OUT_VECTOR, OUT_VECTOR)(_read)


@pointed(record(WIRES), *[INTEGER] * 5)
def _move(w: Any, force: int, brake: int, wrench: int, steps: int, measured: int) -> int:
    at_leg, held, reads = np.empty(LEGS), np.empty(LEGS), reals_at(measured, 2 * LEGS)
    at_legs, brakes, status = np.int64(at_leg.ctypes.data), np.int64(held.ctypes.data), 0
    for _ in range(steps if w.timed else 1):
        _connect(w, reals_at(force, LEGS), reals_at(brake, LEGS), at_leg, held)
        by = 1 if w.timed else steps
        status = call(w.move, (w.context, at_legs, brakes, wrench, by, measured))
        if status:
            break
        legs = reads.copy()
        _read(w, legs[:LEGS], legs[LEGS:], reads[:LEGS], reads[LEGS:])
    return int(status)


@pointed(record(WIRES), INTEGER)
def _applied(_w: Any, _force: int) -> int:
    return 0


class WiredPlant(PointedPlant):
    """Plant in which drives act on, and encoders read, the legs to which a `Wiring` connects them.

    Mutable state: the cables and the plant behind them; from `reset` on the readings of frozen encoders, the
    positions of encoders with play, past readings, and brakes, forces and couplings with a delay.
    """

    def __init__(self, plant: Plant, wiring: Wiring, origin: Array, rated_N: float = 1.0) -> None:
        """Connect a plant to the cables of a wiring.

        origin: leg lengths (6,) m at which an error of scale has no effect; rated_N: rated force of a drive.
        """
        self._wires = np.zeros((), WIRES)
        self._connect(plant)
        self.internal_step_s = self._wires["h_s"] = plant.internal_step_s
        self._wires["origin"], self._wires["rated"] = origin, rated_N
        self.wire(wiring)

    def wire(self, wiring: Wiring) -> None:
        """Change the wiring and reset its state. Frozen encoders freeze at the next `reset`."""
        w, wires = wiring, self._wires
        for names in _AS_WIRED.values():
            for name in names:
                wires[name] = getattr(w, name)
        wires["opens"] = [sum(1 << leg for leg in legs) for legs in w.brake]
        wires["driven"] = np.array(w.present) & ~np.array(w.other_protocol)
        wires["most"] = wires["rated"] * np.array(w.force_most)
        wires["coupling"] = wires["rated"] * np.array(w.coupling)
        wires["stuck"] = [np.nan if at is None else at for at in w.stuck]
        wires["late"] = np.rint(np.array(w.encoder_late_s) / self.internal_step_s)
        delays = *w.brake_late_s, *w.encoder_late_s, *w.force_lag_s
        wires["timed"] = any(delays) or min(w.coupling) < np.inf
        self._past = np.empty((int(wires["late"].max()) + 1, 2 * LEGS))
        wires["past"], wires["room"] = data_at(self._past), len(self._past)
        self._begin()

    def _begin(self) -> None:
        wires = self._wires
        wires["at_start"], wires["followed"], wires["shut_s"] = np.nan, np.inf, np.inf
        wires["lagged"] = wires["slipped"] = wires["slips"] = wires["k"] = 0
        self._past[:] = np.nan

    def _connect(self, plant: Plant) -> None:
        self._plant, self._behind = plant, moved(plant)
        self._wires["move"], self._wires["context"] = self._behind.move, self._behind.context

    def exchange(self, plant: Plant) -> None:
        """Connect the cables to another plant with the same step, and reset it."""
        self._connect(plant)
        plant.reset()

    def reset(self) -> tuple[Array, Array]:
        """Reset the plant; return lengths (6,) m and rates (6,) m/s as the encoders read them."""
        self._begin()
        reads, rates = np.empty(LEGS), np.empty(LEGS)
        _read_at(self._wires, *self._plant.reset(), reads, rates)
        self._wires["at_start"] = reads
        return reads, rates

    def moved(self) -> Moved:
        """Addresses of the compiled functions of this plant and of its state, for compiled callers."""
        return Moved(_move.address, _applied.address, data_at(self._wires), self._refused, self)

    def _refused(self, status: int, force: Array, brake: Array, wrench: Array, steps: int) -> BaseException:
        return self._behind.refused(status, force, brake, wrench, steps)

    def truth(self) -> Truth | None:
        """True pose, twist and forces of the plant behind the cables."""
        return self._plant.truth()

    def close(self) -> None:
        """Free the resources of the plant behind the cables."""
        self._plant.close()
