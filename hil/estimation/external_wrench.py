"""The external wrench that the law counts on: none, the observer's, or the sensor's."""

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.signals import LEGS
from drivers.tick_columns import Record
from hil.estimation.observer import WrenchObserver
from hil.mathematics.rotations import turned

_ALL_LEGS = (1 << LEGS) - 1
SENSOR_PATIENCE = 3.0
"""Sample periods of the wrench sensor without a sample that warn."""


class ExternalWrench:
    """The wrench of the configured source, (6,) N, N m on the platform at its origin, base frame.

    Mutable state: the wrench of the last tick, the last reading of the sensor and when it came, whether it
    is late, and the observer's own. `reset` restores the initial one.
    """

    def __init__(
        self, observer: WrenchObserver | None, sensor_rate_Hz: float | None, period_s: float
    ) -> None:
        """observer: where it is the source; sensor_rate_Hz: set where the sensor is; neither: no source."""
        self.observer = observer
        self._sensor_rate_Hz = sensor_rate_Hz
        self._period_s = period_s
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        self.last = ZERO6
        """(6,): of the last tick."""
        self.reading = ZERO6
        """(6,): the last reading of the sensor, source or not."""
        self.read_at = 0
        self.late = False
        """Whether the sensor is the source and has left out samples: its last one is held."""
        if self.observer is not None:
            self.observer.reset()

    def forget(self) -> None:
        """Forget the reading: a sensor that is there gives another before the brakes open."""
        self.reading = ZERO6

    def hear(self, tick: int, values: tuple[float, ...], R: Array) -> None:
        """Take in a sample (6,) of the sensor, which turns with the platform: R (3, 3)."""
        self.reading = turned(R, np.array(values))
        self.read_at = tick

    @property
    def has_source(self) -> bool:
        """Whether anything gives the wrench; it is zero where nothing does."""
        return self.observer is not None or self._sensor_rate_Hz is not None

    def fill(self, tick: Record, *, fusing: bool) -> None:
        """Fill the wrench of a tick, zero without a source, and what the sensor last read; call it once."""
        number = int(tick["tick"])
        if self.observer is not None:
            seen = not fusing or tick["legs_used"] == _ALL_LEGS
            tick["wrench"] = self.last = self.observer.observe(tick, seen=bool(seen))
        elif self._sensor_rate_Hz is not None:
            tick["wrench"] = self.last = self.reading
            late_ticks = (number - self.read_at) * self._period_s * self._sensor_rate_Hz
            self.late = late_ticks > SENSOR_PATIENCE
        tick["wrench_sensor"] = self.reading
