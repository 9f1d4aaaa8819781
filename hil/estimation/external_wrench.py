"""The external wrench for the control law: zero, from the observer, or from the sensor."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import Callee, address_of, call, data_at, pointed, reals_at
from drivers.frame_pointers import frames_at
from drivers.sensing.kernels import fill_columns, hear, latched_ns, slots_at
from drivers.sensing.layout import SENSORS, SLOTS
from drivers.sensing.layout import WRENCH as WRENCH_SENSOR
from drivers.signals import LEGS
from drivers.tick_columns import TICK, Record, part
from hil.estimation.observer import WrenchObserver
from hil.mathematics.vectors import at, rotate

_ALL_LEGS = (1 << LEGS) - 1
SENSOR_PATIENCE = 3.0
"""A wrench sensor that sends no sample for more than this number of sample periods causes a warning."""
WRENCH = np.dtype(
    [
        *((name, "<i8") for name in ("observe", "observer", "residual", "sensed", "read_at")),
        *((name, "<f8") for name in ("period_s", "rate_Hz")),
        *((name, "<f8", 6) for name in ("last", "reading")),
    ]
)
"""The observer's function, its record and the address of its estimate, 0 if it is not the source; whether the
sensor is the source, and the tick of its last sample."""


@pointed(record(WRENCH), INTEGER, record(TICK, "tick", "legs_used", "wrench", "wrench_sensor"))
def _fill(k: Any, fusing: int, tick: Any) -> int:
    late = False
    if k.observe:
        seen = 1 if fusing == 0 or tick.legs_used == _ALL_LEGS else 0
        call(k.observe, (k.observer, seen, address_of(tick)))
        k.last[:] = reals_at(k.residual, 6)
        tick.wrench[:] = k.last
    elif k.sensed:
        k.last[:] = k.reading
        tick.wrench[:] = k.last
        late = (tick.tick - k.read_at) * k.period_s * k.rate_Hz > SENSOR_PATIENCE
    tick.wrench_sensor[:] = k.reading
    return int(late)


@pointed(
    record(WRENCH),
    record(SENSORS),
    INTEGER,
    INTEGER,
    INTEGER,
    record(TICK, "tick", "t_ns", "lateness_ns", "latch_ns", "rejected", "sensors_rejected", *part("sensed")),
)
def hear_sensors(k: Any, sensors: Any, frames: int, count: int, R: int, tick: Any) -> int:
    """Read a tick's sensor samples from `count` FRAME records at an address; fill in their columns.

    R: address of the platform's rotation (3, 3), which turns the wrench sensor's samples to the base frame.
    """
    began_ns = tick.t_ns + tick.lateness_ns
    hear(sensors, frames_at(frames, count), tick.tick, began_ns, latched_ns(tick))
    of = slots_at(sensors.slots, SLOTS)[WRENCH_SENSOR]
    if of.count > 0:
        rotation = reals_at(R, (3, 3))
        for half in range(2):
            turned = rotate(rotation, at(of.last, 3 * half))
            for i in range(3):
                k.reading[3 * half + i] = turned[i]
        k.read_at = tick.tick
    tick.sensors_rejected = sensors.rejected
    tick.rejected += sensors.rejected
    fill_columns(sensors, tick, k.period_s)
    return 0


class ExternalWrench:
    """The wrench of the configured source, (6,) N, N m on the platform at its origin, base frame.

    Mutable state: the wrench of the last tick, the last reading of the sensor with its tick, and the
    observer's state. `reset` restores the initial state.
    """

    def __init__(
        self, observer: WrenchObserver | None, sensor_rate_Hz: float | None, period_s: float
    ) -> None:
        """Set the source: an observer, or a sensor of a rate, Hz; neither: zero wrench. period_s: s."""
        self.observer = observer
        self._record = np.zeros((), WRENCH)
        self._record["period_s"] = period_s
        if observer is not None:
            self._record["observe"], self._record["observer"] = observer.look[:2]
            self._record["residual"] = data_at(observer.residual)
        if sensor_rate_Hz is not None:
            self._record["sensed"], self._record["rate_Hz"] = 1, sensor_rate_Hz
        self.look = Callee(_fill.address, data_at(self._record), self)
        """Arguments: (wrench, fusing, tick); the compiled part of `fill`."""
        self.last: Array = self._record["last"]
        """Wrench (6,) N, N m of the last tick; a view that the next tick changes."""
        self.reset()

    def reset(self) -> None:
        """Restore the state before the first tick."""
        for name in ("last", "reading", "read_at"):
            self._record[name] = 0
        if self.observer is not None:
            self.observer.reset()

    def forget(self) -> None:
        """Clear the sensor's reading: a working sensor gives a new one before the brakes open."""
        self._record["reading"] = 0.0

    @property
    def has_source(self) -> bool:
        """True if an observer or a sensor is configured; without a source the wrench is zero."""
        return bool(self._record["observe"] or self._record["sensed"])

    def fill(self, tick: Record, *, fusing: bool) -> bool:
        """Fill in a tick's `wrench` and `wrench_sensor` (the sensor's last reading); call it once per tick.

        wrench: (6,) N, N m, load on the platform at its origin, base frame; zero without a source.
        fusing: the fusion filter runs; the observer then needs all six legs.

        True if the sensor is the source and its last sample is too old: that sample is held.
        """
        return bool(_fill(self._record, int(fusing), tick))
