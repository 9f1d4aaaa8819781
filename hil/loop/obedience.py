"""A drive that does not obey: its leg gets faster against the force that should slow it, by that alone.

After a fault the forces hold the platform while the brakes close, so no leg that moves against its force gets
faster by itself. With swapped wires, or a wrong sign, the force works against the brake, and is taken off. A
load moves the legs in another proportion than an error of one leg's force does, which is that of a column of
J M^-1 J^T, or that leg alone on closed brakes; along one leg it looks the same.
"""

from collections import deque

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from drivers.tick_columns import Record
from hil.mathematics.linear_algebra import solve
from hil.robot.dynamics import Model

FASTER_m_s = 0.1
"""Within `WITHIN_s`: beyond noise, and what the motion of the others does to a leg."""
WITHIN_s = 0.02
UNLIKE = 0.3
"""So large a share of the change of the six rates may be that of something else."""


class Obedience:
    """Watches the legs while the force holds them after a fault. State: their last rates, who is refused."""

    def __init__(self, model: Model, rate_Hz: float) -> None:
        self._model = model
        self._rates: deque[Array] = deque(maxlen=max(2, round(WITHIN_s * rate_Hz)))
        self.reset()

    def reset(self) -> None:
        """Believe all drives."""
        self.refused: int | None = None
        """The leg that gets no force any more; the sparsest cause is one."""
        self.forget()

    def forget(self) -> None:
        """Begin anew: the force has not held before."""
        self._rates.clear()

    def watch(self, tick: Record, tau: Array) -> bool:
        """Take in a tick's rates, and the forces (6,) N that were sent last; tell whether one is refused."""
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
        """Tell whether the change (6,) m/s of the rates is that of one leg's force: brakes open, or shut."""
        J, M = tick["J"], self._model.mass_matrix(tick["p"], tick["R"])
        coupled = (J * solve(M, J[leg])).sum(axis=1)
        for of in (coupled, np.eye(LEGS)[leg]):
            rest = change - of * float((change * of).sum() / (of * of).sum())
            if float(np.sqrt((rest * rest).sum() / (change * change).sum())) <= UNLIKE:
                return True
        return False
