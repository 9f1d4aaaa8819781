"""The external wrench that the law is told: nobody's, the observer's, or the sensor's."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS, Measurement
from hil.estimation.observer import WrenchObserver
from hil.mathematics.rotations import turned
from hil.signals import NO_WRENCH, Estimate

_ALL_LEGS = (1 << LEGS) - 1
_ZERO6 = np.zeros(6)
_ZERO6.flags.writeable = False
SENSOR_PATIENCE = 3.0
"""Sample periods of the wrench sensor without a sample that warn."""


class ExternalWrench:
    """The wrench of the configured source, (6,) N, N m on the platform at its origin, base frame.

    Mutable state: the wrench of the last tick, what the sensor last said and when, whether it is late, and
    the observer's own. `reset` restores the initial one.
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
        self.last = NO_WRENCH
        """(6,): of the last tick."""
        self.said = _ZERO6
        """(6,): what the sensor last said, source or not."""
        self.said_tick = 0
        self.late = False
        """Whether the sensor is the source and has left out samples: its last one is held."""
        if self.observer is not None:
            self.observer.reset()

    def forget(self) -> None:
        """Forget what the sensor said: one that is there says it anew before the brakes open."""
        self.said = _ZERO6

    def hear(self, tick: int, values: tuple[float, ...], R: Array) -> None:
        """Take in a sample (6,) of the sensor, which turns with the platform: R (3, 3)."""
        self.said = turned(R, np.array(values))
        self.said_tick = tick

    def told(self, tick: int, estimate: Estimate, measurement: Measurement, *, fusing: bool) -> Estimate:
        """Return the estimate with the wrench, as it is without a source; call it once a tick."""
        if self.observer is not None:
            seen = not fusing or estimate.fusion.used == _ALL_LEGS
            drives = measurement.state.tolist()
            self.last = self.observer.observe(tick, estimate.state, drives, seen=seen)
        elif self._sensor_rate_Hz is not None:
            self.last = self.said
            self.late = (tick - self.said_tick) * self._period_s * self._sensor_rate_Hz > SENSOR_PATIENCE
        else:
            return estimate
        return estimate._replace(state=estimate.state._replace(wrench=self.last))
