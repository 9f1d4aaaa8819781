"""What the emulated drives forget at power-off: how often their motors have turned."""

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array
from drivers.config import HomingSettings
from drivers.signals import LEGS
from drivers.transmission import Transmission


class Turns:
    """Six encoders that count turns only while they are powered.

    Each begins within half of `forgotten_turns` of zero, whatever the motor has done before.

    Mutable state: the leg lengths that are not counted.
    """

    def __init__(
        self, settings: HomingSettings | None, transmission: Transmission | None, length: Array
    ) -> None:
        """Switch on at lengths (6,) m; encoders without settings forget nothing."""
        self.uncounted_m = np.zeros(LEGS)
        """(6,) m that the drives do not report."""
        self._transmission = None if settings is None else transmission
        self._forgets = np.broadcast_to(1.0 if settings is None else settings.forgotten_turns, LEGS)
        self.switch_on([True] * LEGS, length)

    def switch_on(self, which: Sequence[bool], length: Array) -> None:
        """Switch six drives on, or those of them that are, the legs having lengths (6,) m."""
        if self._transmission is not None and any(which):
            whole = np.round(self._transmission.turns(length) / self._forgets) * self._forgets
            uncounted_m = self._transmission.m_per_turn * whole
            self.uncounted_m = np.where(which, uncounted_m, self.uncounted_m)
