"""Detection of a drive that does not obey: its leg accelerates against the force that should slow it.

After a fault the forces hold the platform while the brakes close, so no leg accelerates against its own
force. With swapped wires or a wrong sign, the force works against the brake, and must be switched off. An
error of one leg's force changes the leg rates in the proportion of a column of J M^-1 J^T, or changes that
leg's rate alone on closed brakes. A load changes them in another proportion, except a load along one leg.
"""

from collections import deque

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from drivers.tick_columns import Record
from hil.mathematics.linear_algebra import solve
from hil.robot.dynamics import Model

FASTER_m_s = 0.1
"""Increase of speed within `WITHIN_s` that noise and the motion of the other legs cannot cause."""
WITHIN_s = 0.02
UNLIKE = 0.3
"""Largest residual share of the change of the six rates that another cause may explain."""


class Obedience:
    """Checks that no leg accelerates against its force. Mutable state: last rates, refused leg."""

    def __init__(self, model: Model, rate_Hz: float) -> None:
        self._model = model
        self._rates: deque[Array] = deque(maxlen=max(2, round(WITHIN_s * rate_Hz)))
        self.reset()

    def reset(self) -> None:
        """Trust all drives again, and forget the rates."""
        self.refused: int | None = None
        """The leg that no longer gets a force; at most one, as the simplest explanation."""
        self.forget()

    def forget(self) -> None:
        """Forget the stored rates, as a new holding force begins."""
        self._rates.clear()

    def watch(self, tick: Record, tau: Array) -> bool:
        """Add a tick's rates, given the forces (6,) N sent last; True if a leg is newly found to disobey."""
        rate = tick["rate"]
        if self.refused is not None or tick["age"].any():
            return False
        self._rates.append(rate.copy())
        before = self._rates[0]
        faster = np.where(tau * rate < 0.0, np.abs(rate) - np.abs(before), 0.0)
        leg = int(np.argmax(faster))
        if faster[leg] <= FASTER_m_s or not self._alone(leg, rate - before, tick):
            return False
        self.refused = leg
        return True

    def _alone(self, leg: int, change: Array, tick: Record) -> bool:
        """True if one leg's force explains the change (6,) m/s of all rates, with brakes open or closed."""
        J, M = tick["J"], self._model.mass_matrix(tick["p"], tick["R"])
        coupled = (J * solve(M, J[leg])).sum(axis=1)
        for of in (coupled, np.eye(LEGS)[leg]):
            rest = change - of * float((change * of).sum() / (of * of).sum())
            if float(np.sqrt((rest * rest).sum() / (change * change).sum())) <= UNLIKE:
                return True
        return False
