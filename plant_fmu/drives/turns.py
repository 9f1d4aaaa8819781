"""What the emulated drives forget at power-off: how often their motors have turned."""

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
        self._uncounted_m = np.zeros(LEGS)
        self._transmission = None if settings is None else transmission
        self._forgets = np.broadcast_to(1.0 if settings is None else settings.forgotten_turns, LEGS)
        for leg in range(LEGS):
            self.switch_on(leg, length)

    def switch_on(self, leg: int, length: Array) -> None:
        """Switch one drive on, the legs having lengths (6,) m."""
        if self._transmission is not None:
            turns, unit = self._transmission.turns(length)[leg], self._forgets[leg]
            self._uncounted_m[leg] = self._transmission.m_per_turn[leg] * unit * round(turns / unit)

    def counted(self, length: Array) -> Array:
        """Return as what the drives report lengths (6,) m."""
        return length - self._uncounted_m
