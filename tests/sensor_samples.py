"""Samples of sensors as values for tests; compiled code has them in records of SENSORS."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER, REAL, VECTOR, kernel, record, records
from drivers.compiled.pointed import FAILED, data_at
from drivers.frame_array import FRAME, sent_frames
from drivers.sensing.kernels import hear, put_sample
from drivers.sensing.layout import (
    IMU,
    NEVER,
    ROW,
    SAMPLE,
    SENSORS,
    TRACKER,
    WRENCH,
    Reception,
    no_sensors,
    unheard,
)
from drivers.sensors import KINDS, SensorProtocol
from drivers.signals import LEGS
from drivers.tick_columns import Record
from hil.estimation.fusion import FusedEstimator
from hil.estimation.fusion_tick import fuse


class Sample(NamedTuple):
    """One element of SAMPLE."""

    tick: int
    offset_s: float
    values: tuple[float, ...]

    def ticks(self, period_s: float) -> float:
        """Instant of the sample in ticks; k is the latching of tick k."""
        return self.tick + self.offset_s / period_s


class Readings(NamedTuple):
    """Samples of all sensors in one tick."""

    tracker: tuple[Sample, ...] = ()
    imu: tuple[Sample, ...] = ()
    wrench: tuple[Sample, ...] = ()
    rejected: int = 0
    lost: int = 0
    counters: tuple[int, int, int] = (NEVER, NEVER, NEVER)


class Health(NamedTuple):
    """Quantities by which a tick of the filter is judged."""

    lost: tuple[bool, ...]
    slipped: tuple[bool, ...]
    position_std: float
    gap_s: float
    missed: bool


hear_frames = kernel(record(SENSORS), records(FRAME), INTEGER, INTEGER, INTEGER)(hear)
"""Arguments: (record of SENSORS, elements of FRAME, tick, its begin, end of its SYNC); reads the samples."""
_SLOTS = [TRACKER, IMU, WRENCH]


_put = kernel(record(ROW), VECTOR, INTEGER, REAL, INTEGER, record(FRAME))(put_sample)


def encode(
    protocol: SensorProtocol, kind: str, values: Any, cycle: int, offset_s: float, counter: int
) -> Any:
    """Frame of a sample of a role with one message; None if it has none. offset_s: its time after SYNC."""
    rows, frame = protocol.tables.rows, np.zeros(1, FRAME)
    row = rows[rows["slot"] == _SLOTS[KINDS.index(kind)]][:1].reshape(())
    failed = _put(row, np.array(values, float), cycle, offset_s, counter, frame.reshape(())) == FAILED
    return None if failed else sent_frames(frame)[0]


def decode(protocol: SensorProtocol, frames: Rows, tick: int, before: Readings) -> Readings:
    """Samples among a tick's frames."""
    sensors = unheard(protocol.tables)
    sensors.slots["counter"][_SLOTS] = before.counters
    hear_frames(sensors.record, frames, tick, 0, 0)
    return of_record(sensors)


def of_record(sensors: Reception) -> Readings:
    kinds = [
        tuple(
            Sample(int(s["tick"]), float(s["offset_s"]), tuple(s["values"].tolist()))
            for s in sensors.samples[slot, : sensors.slots["count"][slot]]
        )
        for slot in _SLOTS
    ]
    counters = tuple(sensors.slots["counter"][_SLOTS].tolist())
    return Readings(*kinds, int(sensors.record["rejected"]), int(sensors.record["lost"]), counters)  # type: ignore[arg-type, call-arg]


def as_record(readings: Readings) -> Reception:
    """Readings as a reception."""
    sensors = unheard(no_sensors())
    for slot, own in zip(_SLOTS, readings[:3], strict=True):
        sensors.slots["count"][slot] = len(own)
        sensors.samples[slot, : len(own)] = np.array([tuple(sample) for sample in own], SAMPLE)
    sensors.record["rejected"] = readings.rejected
    return sensors


def update(
    found: FusedEstimator, tick: Record, t_ns: int | None, readings: Readings, command: Array, wrench: Array
) -> Health:
    """Fill a tick, latched at t_ns, as the compiled pass does; return the health of the filter."""
    sensors = as_record(readings)
    if t_ns is not None:
        tick["t_ns"], tick["lateness_ns"], tick["latch_ns"] = t_ns, 0, 0
    force, load = (np.ascontiguousarray(each, np.float64) for each in (command, wrench))
    assert fuse(found.record, sensors.record, data_at(force), data_at(load), tick) == 0
    f: Any = found.record
    lost, slipped = (
        tuple(bool(bits >> leg & 1) for leg in range(LEGS))
        for bits in (int(f["lost"]), int(tick["legs_slipped"]))
    )
    return Health(lost, slipped, float(f["position_std_m"]), float(f["gap_s"]), bool(f["missed"]))
