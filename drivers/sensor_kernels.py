"""Kernels for sensor samples at both ends: encoding of a sample, and decoding of a tick's samples."""

from math import pi
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER, REAL, VECTOR, helper, kernel, record
from drivers.compiled.pointed import FAILED, data_at, records_at
from drivers.frame_array import FRAME, SENT
from drivers.frame_pointers import signed
from drivers.legs.kernels import STRANGE, check_of, intact, natural, put
from drivers.tick_columns import Record

TRACKER, IMU, WRENCH = range(3)
QUANTITIES = 6
FIELDS = QUANTITIES + 4
"""Fields of a sample, in order of position: quantities, Offset, Cycle, Counter, Validity; then its CRC."""
OLDEST = 127
"""Most ticks: Cycle counts to 255, and an older stamp looks like one in the future."""
MOST = 256
"""Most samples of one kind in one tick; further ones are refused."""
NEVER = NOBODY = -1
"""Counter before the first frame; identifier of a missing sensor."""
SAMPLE = np.dtype([("tick", "<i8"), ("offset_s", "<f8"), ("values", "<f8", (QUANTITIES,))])
"""One measurement: tick of the SYNC before it, time from the end of that SYNC in steps of 1 us, and values.
Tracker: position m in the base frame, rotation vector rad from platform to base. IMU: angular rate rad/s,
specific force m/s^2. Wrench: force N, moment N m. IMU and wrench are in the platform frame."""
SENSORS = np.dtype(
    [
        *((name, "<i8", (3,)) for name in ("id", "flags", "bus", "length")),
        ("start", "<i8", (3, FIELDS)), ("bits", "<i8", (3, FIELDS)),
        ("scale", "<f8", (3, QUANTITIES + 1)),
        ("low", "<f8", (3, QUANTITIES)), ("high", "<f8", (3, QUANTITIES)),
        ("counter", "<i8", (3,)),
        ("count", "<i8", (3,)), ("rejected", "<i8"), ("lost", "<i8"),
        ("samples", "<i8"),
    ]
)  # fmt: skip
"""Tracker, IMU, wrench sensor: identifier (-1: none), flags, bus, bytes; position of each field in bits;
steps and ranges in SI. Then the reception: counter of each sensor's last frame; of the present tick the
numbers of samples, of refused frames, and of samples missing by the counters. `samples`: address of (3, MOST)
SAMPLE records."""
_HALF_TURN_2 = (pi * (1 + 1e-6)) ** 2
_samples_at = records_at(record(SAMPLE))
_KIND_BYTES = MOST * SAMPLE.itemsize


def no_sensors() -> Record:
    """Record of SENSORS for a configuration without sensors."""
    record = np.zeros((), SENSORS)
    record["id"], record["counter"] = NOBODY, NEVER
    return record


def unheard(tables: Record) -> tuple[Record, Rows]:
    """(record of SENSORS before any frame, array of samples to which it points) for these tables."""
    record, samples = tables.copy(), np.zeros((3, MOST), SAMPLE)
    record["samples"] = data_at(samples)
    return record, samples


@helper
def samples_of(s: Any, kind: int) -> Any:
    """Samples of one kind of sensor received in this tick, oldest first."""
    return _samples_at(s.samples + _KIND_BYTES * kind, s.count[kind])


@helper
def _is_later(one: Any, tick: int, offset_s: float, values: Array) -> bool:
    if one.tick != tick:
        return bool(one.tick > tick)
    if one.offset_s != offset_s:
        return bool(one.offset_s > offset_s)
    for k in range(QUANTITIES):
        if one.values[k] != values[k]:
            return bool(one.values[k] > values[k])
    return False


@helper
def _keep(s: Any, kind: int, tick: int, offset_s: float, values: Array) -> None:
    place = s.count[kind]
    s.count[kind] += 1
    samples = samples_of(s, kind)
    while place > 0 and _is_later(samples[place - 1], tick, offset_s, values):
        before, here = samples[place - 1], samples[place]
        here.tick, here.offset_s = before.tick, before.offset_s
        here.values[:] = before.values
        place -= 1
    sample = samples[place]
    sample.tick, sample.offset_s = tick, offset_s
    sample.values[:] = values


@helper
def _take(s: Any, kind: int, data: Any, tick: int) -> bool:
    start, bits = s.start[kind], s.bits[kind]
    behind = (tick - natural(data, start[7], bits[7])) & 0xFF
    counter = natural(data, start[8], bits[8])
    validity = natural(data, start[9], bits[9])
    if behind > OLDEST or tick < behind or validity > 1 or s.count[kind] == MOST:
        return False
    v = np.empty(QUANTITIES)
    for k in range(QUANTITIES):
        v[k] = signed(natural(data, start[k], bits[k]), bits[k]) * s.scale[kind, k]
        if not s.low[kind, k] <= v[k] <= s.high[kind, k]:
            return False
    if kind == TRACKER and v[3] * v[3] + v[4] * v[4] + v[5] * v[5] > _HALF_TURN_2:
        return False
    if counter == s.counter[kind]:
        return True  # a repetition
    if s.counter[kind] != NEVER:
        s.lost += (counter - s.counter[kind] - 1) & 0xF
    s.counter[kind] = counter
    if validity == 0:
        offset_s = natural(data, start[6], bits[6]) * s.scale[kind, 6]
        _keep(s, kind, tick - behind, offset_s, v)
    return True


@helper
def hear(s: Any, frames: Any, tick: int) -> None:
    """Decode the sensor samples among a tick's frames, FRAME records.

    A frame with the counter of the one before is a repetition and is skipped; a gap in the counter counts as
    lost, whatever the reason. A sample that its node marks invalid does not count. Refused, and counted in
    `rejected`: wrong length or CRC, a stamp in the future, before tick 0 or more than OLDEST ticks back, an
    unknown validity, a rotation of more than pi, a value outside the range of sensors.dbc. Foreign frames are
    ignored.
    """
    s.rejected = s.lost = 0
    s.count[:] = 0
    for n in range(frames.shape[0]):
        frame = frames[n]
        for kind in range(3):
            if np.int64(frame.id) != s.id[kind] or frame.flags & STRANGE or frame.bus != s.bus[kind]:
                continue
            whole = frame.length == s.length[kind] and intact(frame)
            if not (whole and _take(s, kind, frame.data, tick)):
                s.rejected += 1


@helper
def put_sample(s: Any, kind: int, v: Array, cycle: int, offset_s: float, counter: int, frame: Any) -> int:
    """Encode a sample `v` (6,) in a frame without time; returns 0, or FAILED for NaN or a bad offset."""
    start, bits, data = s.start[kind], s.bits[kind], frame.data
    offset = np.rint(offset_s / s.scale[kind, QUANTITIES])
    if not 0 <= offset <= 0xFFFF:
        return FAILED
    frame.id, frame.kind, frame.length = s.id[kind], SENT, s.length[kind]
    frame.flags, frame.bus = s.flags[kind], s.bus[kind]
    data[:] = 0
    invalid = 0
    for k in range(QUANTITIES):
        if np.isnan(v[k]):
            return FAILED
        bounded = min(max(v[k], s.low[kind, k]), s.high[kind, k])
        invalid |= bounded != v[k]
        put(int(np.rint(bounded / s.scale[kind, k])), data, start[k], bits[k])
    trailer = (int(offset), cycle, counter, invalid)
    for k in range(len(trailer)):
        put(trailer[k], data, start[QUANTITIES + k], bits[QUANTITIES + k])
    last = s.length[kind] - 1
    data[last] = check_of(s.id[kind], data, last, 1)
    return 0


encode = kernel(record(SENSORS), INTEGER, VECTOR, INTEGER, REAL, INTEGER, record(FRAME))(put_sample)
