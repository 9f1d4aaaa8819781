"""A plant behind wrong cables: what six drives see and do, made of what six legs do."""

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import MATRIX, OUT_INTEGER_MATRIX, OUT_VECTOR, VECTOR, direct
from drivers.signals import LEGS
from plant_fmu.plant import Plant, Truth
from plant_fmu.rehearsal.wiring import Wiring

_MOTOR, _ENCODER, _OPENS, _DRIVEN, _STOPS, _FROZEN, _ONE_WAY, _INVERTED = range(8)
"""Rows of a wiring's integers: leg of each drive's motor, and of its encoder; brakes that it opens (bit i:
leg i); 1 where it takes part, where its encoder stops at mid-stroke, where that is frozen, where it gives no
force below zero; of each leg: 1 where its brake shuts when it should open."""
_GAIN, _MOST, _SCALE, _RATE, _OFFSET, _JUMP, _PLAY, _STUCK, _SHARE, _ORIGIN = range(10)
"""Rows of its reals: of each drive N a N, most N, m a m, m/s a m/s, m of offset, jump and play; of each leg
where its brake is stuck, NaN for one that works, the brake's share, and the length at which a scale has no
effect."""


@direct(OUT_INTEGER_MATRIX, MATRIX, VECTOR, VECTOR, OUT_VECTOR, OUT_VECTOR)
def _connect(integers: Ints, reals: Array, force: Array, brake: Array, at_leg: Array, held: Array) -> None:
    """Fill in what forces (6,) N and brakes (6,) of the drives are at the legs."""
    at_leg[:], held[:] = 0.0, 1.0
    for drive in range(LEGS):
        if integers[_DRIVEN, drive]:
            low = 0.0 if integers[_ONE_WAY, drive] else -reals[_MOST, drive]
            given = min(max(force[drive], low), reals[_MOST, drive])
            at_leg[integers[_MOTOR, drive]] += reals[_GAIN, drive] * given
            for leg in range(LEGS):
                if integers[_OPENS, drive] >> leg & 1:
                    held[leg] = min(held[leg], brake[drive])
    for leg in range(LEGS):
        if integers[_INVERTED, leg]:
            held[leg] = 1.0 - held[leg]
        if not np.isnan(reals[_STUCK, leg]):
            held[leg] = reals[_STUCK, leg]
        held[leg] *= reals[_SHARE, leg]


@direct(OUT_INTEGER_MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, OUT_VECTOR, OUT_VECTOR, OUT_VECTOR)
def _read(
    integers: Ints,
    reals: Array,
    length: Array,
    rate: Array,
    at_start: Array,
    followed: Array,
    reads: Array,
    rates: Array,
) -> None:
    """Fill in what encoders read, m and m/s, of legs at length (6,) m and rate (6,) m/s.

    at_start (6,): m, what frozen encoders read, NaN before that is known. followed (6,): m, where the
    encoders stand that follow their legs with play; it is changed.
    """
    for drive in range(LEGS):
        leg = integers[_ENCODER, drive]
        behind = length[leg] - reals[_PLAY, drive]
        followed[drive] = min(max(followed[drive], behind), length[leg])
        place = followed[drive] - reals[_ORIGIN, leg]
        if place > 0.0:
            place = (0.0 if integers[_STOPS, drive] else place) + reals[_JUMP, drive]
        scale = reals[_SCALE, drive]
        reads[drive] = reals[_ORIGIN, leg] + scale * place + reals[_OFFSET, drive]
        rates[drive] = scale * reals[_RATE, drive] * rate[leg]
        if integers[_FROZEN, drive] and not np.isnan(at_start[drive]):
            reads[drive], rates[drive] = at_start[drive], 0.0


class WiredPlant:
    """Plant: forces and brakes of drives go to the legs that they are wired to, and encoders read theirs.

    Mutable state: the plant behind the cables, from `reset` on what frozen encoders read, and where
    those with play are.
    """

    def __init__(self, plant: Plant, wiring: Wiring, origin: Array, rated_N: float = 1.0) -> None:
        """Take the plant, lengths (6,) m of its legs at which a scale has no effect, and the rated force."""
        self._plant = plant
        w = wiring
        opens = [sum(1 << leg for leg in legs) for legs in w.brake]
        driven = [here and not other for here, other in zip(w.present, w.other_protocol, strict=True)]
        stuck = [np.nan if at is None else at for at in w.stuck]
        most = rated_N * np.array(w.force_most)
        self._integers = np.array(
            [w.motor, w.encoder, opens, driven, w.stops, w.frozen, w.force_one_way, w.brake_inverted],
            np.int64,
        )
        self._reals = np.array([
            w.force_gain, most, w.scale, w.rate_scale, w.offset_m, w.jump_m, w.play_m, stuck, w.brake_share,
            origin,
        ])  # fmt: skip
        self._at_start, self._followed = np.full(LEGS, np.nan), np.full(LEGS, np.inf)
        self.internal_step_s = plant.internal_step_s

    def exchange(self, plant: Plant) -> None:
        """Connect the cables to another plant of the same step, which begins anew."""
        self._plant = plant
        plant.reset()

    def reset(self) -> tuple[Array, Array]:
        """Reset the plant; lengths (6,) m and rates (6,) m/s as the encoders read them."""
        self._at_start[:], self._followed[:] = np.nan, np.inf
        reads, rates = self._read(*self._plant.reset())
        self._at_start[:] = reads
        return reads, rates

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Hold force (6,) N and brake (6,) of the drives for `dt_s`; what their encoders read at its end."""
        at_leg, held = np.empty(LEGS), np.empty(LEGS)
        _connect(self._integers, self._reals, force, brake, at_leg, held)
        return self._read(*self._plant.step(at_leg, held, wrench, dt_s))

    def _read(self, length: Array, rate: Array) -> tuple[Array, Array]:
        reads, rates = np.empty(LEGS), np.empty(LEGS)
        known = self._at_start, self._followed
        _read(self._integers, self._reals, length, rate, *known, reads, rates)
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
