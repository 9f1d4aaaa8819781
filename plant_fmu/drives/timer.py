"""What six drives send by a timer of their own, one drive after the other."""

from drivers.signals import LEGS
from plant_fmu.drives.kernels import NEVER_NS


class Timer:
    """When the next of six drives speaks.

    Mutable state: how often one has spoken, and when the next one does; without a period never.
    """

    def __init__(self, period_ns: float, t0_ns: int, first: int = 0) -> None:
        """Take the period of each drive, and how many sixths of it after `t0_ns` leg 0 speaks first."""
        self._share_ns, self._t0_ns, self._first, self._spoken = period_ns / LEGS, t0_ns, first, 0
        self.next_ns = self._at()

    def _at(self) -> int:
        if self._share_ns <= 0.0:
            return NEVER_NS
        return self._t0_ns + round((self._first + self._spoken) * self._share_ns)

    def speak(self) -> int:
        """Return the leg whose drive speaks at `next_ns`, and go on to the next one."""
        leg = self._spoken % LEGS
        self._spoken += 1
        self.next_ns = self._at()
        return leg
