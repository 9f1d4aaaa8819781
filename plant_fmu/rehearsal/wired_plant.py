"""A plant behind wrong cables: readings and forces of six drives, derived from those of six legs."""

from collections import deque
from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from plant_fmu.plant import Plant, Truth, whole_steps
from plant_fmu.rehearsal.wiring import Wiring

SLIP_m_s = 2.0
"""Speed at which a coupling slips, per rated force in excess of what it carries."""


class WiredPlant(Plant):
    """Plant in which drives act on, and encoders read, the legs to which a `Wiring` connects them.

    Mutable state: the cables and the plant behind them; from `reset` on the readings of frozen encoders, the
    positions of encoders with play, past readings, and brakes, forces and couplings with a delay.
    """

    def __init__(self, plant: Plant, wiring: Wiring, origin: Array, rated_N: float = 1.0) -> None:
        """Connect a plant to the cables of a wiring.

        origin: leg lengths (6,) m at which an error of scale has no effect; rated_N: rated force of a drive.
        """
        self._plant, self._origin, self._rated_N = plant, origin, rated_N
        self.internal_step_s = plant.internal_step_s
        self.wire(wiring)

    def wire(self, wiring: Wiring) -> None:
        """Change the wiring and reset its state. Frozen encoders freeze at the next `reset`."""
        self._w: Any = SimpleNamespace(**{f.name: np.array(getattr(wiring, f.name)) for f in fields(wiring)})
        w = self._w
        w.driven = w.present & ~w.other_protocol
        w.opens = (
            np.array([[leg in legs for leg in range(LEGS)] for legs in wiring.brake]) & w.driven[:, None]
        )
        w.stuck = w.stuck.astype(float)
        w.most, w.coupling = self._rated_N * w.force_most, self._rated_N * w.coupling
        w.late = np.rint(w.encoder_late_s / self.internal_step_s).astype(int)
        delays = (*wiring.brake_late_s, *wiring.encoder_late_s, *wiring.force_lag_s)
        self._timed = any(delays) or min(wiring.coupling) < np.inf
        self._begin()

    def _begin(self) -> None:
        self._past: deque[tuple[Array, Array]] = deque(maxlen=int(self._w.late.max()) + 1)
        self._at_start, self._given = np.full(LEGS, np.nan), np.zeros(LEGS)
        self._followed, self._shut_s = np.full(LEGS, np.inf), np.full(LEGS, np.inf)
        self._lagged, self._slipped, self._slips = np.zeros(LEGS), np.zeros(LEGS), np.zeros(LEGS)

    def _connect(self, force: Array, brake: Array) -> tuple[Array, Array]:
        """Forces (6,) N and brakes (6,) at the legs from those that the drives apply."""
        w, h_s = self._w, self.internal_step_s
        given = np.clip(force, np.where(w.force_one_way, 0.0, -w.most), w.most)
        if self._timed:
            lags = w.force_lag_s > 0.0
            share = np.minimum(1.0, h_s / np.where(lags, w.force_lag_s, h_s))
            self._lagged += (given - self._lagged) * share
            given = np.where(lags, self._lagged, given)
            carried = np.clip(given, -w.coupling, w.coupling)
            self._slips = SLIP_m_s * (given - carried) / self._rated_N
            self._slipped += self._slips * h_s
            given = carried
        at_leg: Any = np.bincount(w.motor, w.force_gain * given * w.driven, LEGS)
        held = np.where(w.opens, brake[:, None], 1.0).min(axis=0)
        held = np.where(w.brake_inverted, 1.0 - held, held)
        held = np.where(np.isnan(w.stuck), held, w.stuck) * w.brake_share
        if self._timed:
            self._shut_s = np.where(held > 0.0, self._shut_s + h_s, 0.0)
            held = np.where(self._shut_s <= w.brake_late_s, 0.0, held)
        return at_leg, held

    def _read(self, length: Array, rate: Array) -> tuple[Array, Array]:
        """Lengths (6,) m and rates (6,) m/s that the encoders read, from those of the legs."""
        w = self._w
        self._past.append((length.copy(), rate.copy()))
        then = np.maximum(len(self._past) - 1 - w.late, 0)
        l, dl = np.array(self._past)[then, :, w.encoder].T
        self._followed = np.clip(self._followed, l - w.play_m, l)
        origin = self._origin[w.encoder]
        place = self._followed - origin
        place = np.where(place > 0.0, np.where(w.stops, 0.0, place) + w.jump_m, place)
        reads = origin + w.scale * (place + self._slipped) + w.offset_m
        rates = w.scale * w.rate_scale * (dl + self._slips)
        frozen = w.frozen & ~np.isnan(self._at_start)
        return np.where(frozen, self._at_start, reads), np.where(frozen, 0.0, rates)

    def exchange(self, plant: Plant) -> None:
        """Connect the cables to another plant with the same step, and reset it."""
        self._plant = plant
        plant.reset()

    def reset(self) -> tuple[Array, Array]:
        """Reset the plant; return lengths (6,) m and rates (6,) m/s as the encoders read them."""
        self._begin()
        reads, rates = self._read(*self._plant.reset())
        self._at_start = reads
        return reads, rates

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Step as `Plant.step`; delays and lags advance with each internal step."""
        self._given = force.copy()
        steps = whole_steps(dt_s, self.internal_step_s) if self._timed else 1
        for _ in range(steps):
            at_leg, held = self._connect(force, brake)
            found = self._read(*self._plant.step(at_leg, held, wrench, dt_s / steps))
        return found

    def truth(self) -> Truth | None:
        """True pose and twist of the plant behind the cables; forces of the drives in front of them."""
        truth = self._plant.truth()
        return None if truth is None else truth._replace(applied_force=self._given)

    def close(self) -> None:
        """Free the resources of the plant behind the cables."""
        self._plant.close()
