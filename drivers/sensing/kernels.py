"""Sensor samples in compiled code, at both ends: the frame of a sample, and a tick's samples in order."""

from math import pi
from typing import Any

import numpy as np

from drivers.arrays import Array, Bytes, Ints
from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import FAILED, records_at
from drivers.frame_array import SENT
from drivers.frame_pointers import signed
from drivers.legs.crc import check_of, intact
from drivers.legs.kernels import natural, put
from drivers.protocol import ERROR, EXTENDED, REMOTE
from drivers.rotations import rotation_vector_kernel, times, turn
from drivers.sensing.layout import (
    COUNTER,
    CYCLE,
    FIELDS,
    FLOAT,
    FORCE,
    FREE,
    IMU,
    INCLINATION,
    LENGTH,
    MOST,
    NEVER,
    OFFSET,
    QUANTITIES,
    ROW,
    SAMPLE,
    SELECTS,
    SIGNED,
    SKIPS,
    SLOT,
    SLOTS,
    STAMPED,
    SYNCED,
    TRACKER,
    VALIDITY,
    WRENCH,
)
from drivers.signals import LEGS

OLDEST = 127
"""Most ticks: Cycle counts to 255, and an older stamp looks like one in the future."""
LATEST_S = 0.1
"""A sample that took longer than the fastest one by more than this is refused."""
DRIFT = 1e-4
"""Largest difference of the rates of two clocks."""
_HALF_TURN_2 = (pi * (1 + 1e-6)) ** 2
rows_at, slots_at = records_at(record(ROW)), records_at(record(SLOT))
_samples_at = records_at(record(SAMPLE))
_SLOT_BYTES = MOST * SAMPLE.itemsize
_FLOAT_BITS = 32


@helper
def latched_ns(tick: Any) -> int:
    """Instant at which the first encoder of a tick was latched, ns."""
    first = np.int64(0)
    for leg in range(LEGS):
        at_ns = tick.latch_ns[leg]
        if at_ns and (first == 0 or at_ns < first):
            first = at_ns
    return tick.t_ns + tick.lateness_ns + first  # type: ignore[no-any-return]


@helper
def count_of(s: Any, slot: int) -> int:
    """Number of samples of a slot in a tick."""
    return int(slots_at(s.slots, SLOTS)[slot].count)


@helper
def samples_of(s: Any, slot: int) -> Any:
    """Samples of a tick, oldest first."""
    return _samples_at(s.samples + _SLOT_BYTES * slot, count_of(s, slot))


@helper
def field_of(data: Any, start: int, bits: int, big: int) -> int:
    """Field as a natural number, by its first bit; `big`: by its highest one, byte by byte downwards."""
    if not big:
        return natural(data, start, bits)
    skipped = 7 - (start & 7)
    size, number = (skipped + bits + 7) >> 3, np.int64(0)
    for k in range(size):
        number = number << 8 | np.int64(data[(start >> 3) + k])
    return int((number >> (8 * size - skipped - bits)) & ((1 << bits) - 1 if bits < 64 else -1))


@helper
def put_field(value: int, data: Bytes, start: int, bits: int, big: int) -> None:
    """Write the low bits of an integer into a field that is 0, see `field_of`."""
    if not big:
        put(value, data, start, bits)
        return
    skipped = 7 - (start & 7)
    size = (skipped + bits + 7) >> 3
    raw = value if bits == 64 else (value & ((1 << bits) - 1)) << (8 * size - skipped - bits)
    for k in range(size):
        data[(start >> 3) + k] |= (raw >> (8 * (size - 1 - k))) & 0xFF


@helper
def real_of(row: Any, k: int, data: Any, word: Ints) -> float:
    """Raw value of a field; `word` (1,) is scratch."""
    bits, kind = row.bits[k], row.kind[k]
    number = field_of(data, row.start[k], bits, row.big[k])
    if kind == FLOAT:
        word[0] = number
        return float(word.view(np.float32)[0] if bits == _FLOAT_BITS else word.view(np.float64)[0])
    return float(signed(number, bits) if kind == SIGNED else number)


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
def _keep(s: Any, of: Any, slot: int, tick: int, offset_s: float, values: Array) -> None:
    place = of.count
    of.count += 1
    samples = samples_of(s, slot)
    while place > 0 and _is_later(samples[place - 1], tick, offset_s, values):
        before, here = samples[place - 1], samples[place]
        here.tick, here.offset_s = before.tick, before.offset_s
        here.values[:] = before.values
        place -= 1
    sample = samples[place]
    sample.tick, sample.offset_s = tick, offset_s
    sample.values[:] = values


@helper
def selected(row: Any, data: Any) -> tuple[bool, bool]:
    """Two flags: the frame is this message; its conditions of validity hold."""
    valid = True
    for k in range(row.conditions):
        bits = field_of(data, row.at[k], row.wide[k], row.from_top[k])
        equal = (bits & row.mask[k]) == row.equals[k]
        if row.selects[k] and equal != (row.selects[k] == SELECTS):
            return False, False
        valid = valid and (equal or row.selects[k] != 0)
    return True, valid


@helper
def _take(s: Any, row: Any, frame: Any, tick: int, began_ns: int, latched_ns: int) -> bool:
    """Take a sample, or a part of one, from an intact frame; True if it is plausible."""
    of, data, slot = slots_at(s.slots, SLOTS)[row.slot], frame.data, row.slot
    is_message, valid = selected(row, data)
    if not is_message:
        return True
    v, word = np.zeros(FIELDS), np.zeros(1, np.int64)
    counts = 0
    for k in range(row.fields):
        to = row.to[k]
        value = real_of(row, k, data, word) * row.scale[k] + row.offset[k]
        if not row.low[k] <= value <= row.high[k]:
            return False
        v[to] = value
        counts = row.bits[k] if to == COUNTER else counts
    behind = (tick - int(v[CYCLE])) & 0xFF if of.timing == STAMPED else 0
    if behind > OLDEST or tick < behind or of.count == MOST:
        return False
    if slot == TRACKER and of.parts == 1 and v[3] * v[3] + v[4] * v[4] + v[5] * v[5] > _HALF_TURN_2:
        return False
    if counts:
        counter = int(v[COUNTER])
        if counter == of.counter:
            return True  # a repetition
        if of.counter != NEVER:
            s.lost += (counter - of.counter - 1) & ((1 << counts) - 1)
        of.counter = counter
    mine = 1 << row.part
    if of.got & mine or frame.t_ns - of.began_ns > of.gap_ns:
        of.got = 0
    if of.got == 0:
        of.began_ns, of.valid = frame.t_ns, 1
    of.got |= mine
    if not valid or v[VALIDITY] != 0.0:
        of.valid = 0
    for k in range(row.fields):
        if row.to[k] < QUANTITIES:
            of.raw[row.to[k]] = v[row.to[k]]
    if of.got == of.parts:
        of.got = 0
        return not of.valid or _end(s, of, slot, tick - behind, v[OFFSET], began_ns, latched_ns)
    return True


@helper
def _place(of: Any, v: Array) -> None:
    """Turn a tracker's pose to base and platform frame, and move it from the target to the origin."""
    R = turn(v[3:], of.target)
    for k in range(3):
        R[:, k] = times(of.frame, R[:, k])
    v[3:] = rotation_vector_kernel(R)
    v[:3] -= times(R, of.lever)


@helper
def _delay(of: Any, lag_s: float) -> float:
    """By how much longer than the fastest one a sample took, s; lag_s: its arrival less its stamp.

    The least lag grows by DRIFT between samples, so it follows clocks that drift. After a sample that is late
    by more than LATEST_S it begins with that one: the clock may have been set back.
    """
    least = of.lag_s + DRIFT * 2e-9 * of.gap_ns
    if not lag_s > least:  # NaN before the first one
        least = lag_s
    late_s = lag_s - least
    of.lag_s = lag_s if late_s > LATEST_S else least
    return late_s  # type: ignore[no-any-return]


@helper
def _end(s: Any, of: Any, slot: int, tick: int, offset_s: float, began_ns: int, latched_ns: int) -> bool:
    """Keep a complete sample; False for a rotation of more than half a turn."""
    values = of.raw.copy()
    if of.mixes:
        for i in range(QUANTITIES):
            values[i] = of.shift[i]
            for j in range(QUANTITIES):
                if of.mix[i, j] != 0.0:  # a quantity that a device does not give is NaN
                    values[i] += of.mix[i, j] * of.raw[j]
    r = values[3:]
    if slot == TRACKER and r[0] * r[0] + r[1] * r[1] + r[2] * r[2] > _HALF_TURN_2:
        return False
    if of.placed:
        _place(of, values)
    late_s = of.latency_s
    if of.clocked:
        late_s += _delay(of, of.began_ns * 1e-9 - offset_s)
        offset_s = 0.0
        if late_s > of.latency_s + LATEST_S:
            return False
    offset_s -= late_s
    if of.timing == FREE:
        offset_s += (of.began_ns - latched_ns) * 1e-9
    elif of.timing == SYNCED and of.began_ns < began_ns:
        tick -= 1
    _keep(s, of, slot, tick, offset_s, values)
    return True


@helper
def hear(s: Any, frames: Any, tick: int, began_ns: int, latched_ns: int) -> None:
    """Take the samples among a tick's frames, elements of FRAME.

    began_ns, latched_ns: begin of the tick, and the end of its SYNC. A frame with the counter of the one
    before is a repetition and is skipped; a gap in the counter counts as lost, whatever the reason. A sample
    that its node marks invalid does not count. The messages of one sample arrive within `gap_ns`, else the
    sample is dropped. Refused, and counted in `rejected`: wrong length or CRC, a stamp in the future, before
    tick 0 or more than OLDEST ticks back, an unknown validity, a rotation of more than pi, a value outside
    its range, and a stamp of its own clock that is late by more than LATEST_S. Foreign frames are ignored.
    """
    s.rejected = s.lost = 0
    slots, rows = slots_at(s.slots, SLOTS), rows_at(s.rows, s.size)
    for slot in range(SLOTS):
        slots[slot].count = 0
    for n in range(frames.shape[0]):
        frame = frames[n]
        for k in range(s.size):
            row = rows[k]
            if np.int64(frame.id) != row.id or frame.bus != row.bus or (frame.flags ^ row.flags) & EXTENDED:
                continue
            if frame.flags & (REMOTE | ERROR):
                continue
            length = np.int64(frame.length)
            whole = length == row.length or (length > row.length and not row.exact)
            if row.checked:
                whole = whole and intact(frame)
            if not (whole and _take(s, row, frame, tick, began_ns, latched_ns)):
                s.rejected += 1
    for slot in range(SLOTS):
        of = slots[slot]
        if of.count > 0:
            newest = samples_of(s, slot)[of.count - 1]
            of.last_tick, of.last_s = newest.tick, newest.offset_s
            of.last[:] = newest.values


@helper
def fill_columns(s: Any, tick: Any, period_s: float) -> None:
    """Fill the columns of part `sensed` from the last samples."""
    slots = slots_at(s.slots, SLOTS)
    tick.tracker_pose[:] = slots[TRACKER].last
    tick.imu[:] = slots[IMU].last
    tick.tracker_age = age_of(slots[TRACKER], tick.tick, period_s)
    tick.imu_age = age_of(slots[IMU], tick.tick, period_s)
    tick.wrench_sensor_age = age_of(slots[WRENCH], tick.tick, period_s)
    tick.inclination[:] = slots[INCLINATION].last[:2]
    tick.inclination_age = age_of(slots[INCLINATION], tick.tick, period_s)
    for leg in range(LEGS):
        tick.length_sensor[leg] = slots[LENGTH + leg].last[0]
        tick.length_sensor_age[leg] = age_of(slots[LENGTH + leg], tick.tick, period_s)
        tick.force_sensor[leg] = slots[FORCE + leg].last[0]
        tick.force_sensor_age[leg] = age_of(slots[FORCE + leg], tick.tick, period_s)


@helper
def age_of(of: Any, tick: int, period_s: float) -> float:
    """Time, s, from the last sample of a slot to the SYNC of a tick; inf before its first sample."""
    return (tick - of.last_tick) * period_s - of.last_s  # type: ignore[no-any-return]


@helper
def _put(row: Any, k: int, raw: float, data: Bytes) -> None:
    """Write a raw value, whole unless it is a FLOAT, into a field of a row."""
    word = np.zeros(1, np.int64)
    if row.kind[k] != FLOAT:
        word[0] = np.int64(raw)
    elif row.bits[k] == _FLOAT_BITS:
        word.view(np.float32)[0] = raw
    else:
        word.view(np.float64)[0] = raw
    put_field(word[0], data, row.start[k], row.bits[k], row.big[k])


@helper
def put_sample(row: Any, v: Array, cycle: int, offset_s: float, counter: int, frame: Any) -> int:
    """Fill in one message of a sample, except its time, from the quantities of its fields.

    A value beyond its range saturates, and marks the sample as invalid if a field says so. FAILED for NaN,
    and for a stamp that does not fit.
    """
    data, invalid = frame.data, 0
    frame.id, frame.kind, frame.length = row.id, SENT, row.length
    frame.flags, frame.bus = row.flags, row.bus
    data[:] = 0
    for k in range(row.fields):
        to = row.to[k]
        if to < QUANTITIES:
            if np.isnan(v[to]):
                return FAILED
            bounded = min(max(v[to], row.low[k]), row.high[k])
            invalid |= bounded != v[to]
            real = (bounded - row.offset[k]) / row.scale[k]
        elif to == OFFSET:
            real = np.rint(offset_s / row.scale[k])
            if not 0.0 <= real < 2.0 ** row.bits[k]:
                return FAILED
        else:
            given = cycle if to == CYCLE else counter if to == COUNTER else invalid if to == VALIDITY else 0
            real = float(given)
        _put(row, k, np.rint(real) if row.kind[k] != FLOAT else real, data)
    for k in range(row.conditions):
        if row.selects[k] != SKIPS:
            put_field(row.equals[k], data, row.at[k], row.wide[k], row.from_top[k])
    if row.checked:
        data[row.length - 1] = check_of(row.id, data, row.length - 1, 1)
    return 0


@helper
def put_single(value: float, data: Bytes, at: int) -> None:
    """Write a float32 into four bytes of data from index `at`, little-endian."""
    word = np.empty(1, np.float32)
    word[0] = value
    raw = int(word.view(np.uint32)[0])
    for k in range(4):
        data[at + k] = raw >> 8 * k & 0xFF


@helper
def put_real(row: Any, k: int, x: float, data: Bytes) -> None:
    """Write a value into a field of a row, truncated to its steps and saturated."""
    raw = (x - row.offset[k]) / row.scale[k]
    if row.kind[k] != FLOAT:
        raw += 1e-3 if raw > 0.0 else -1e-3  # a value on a step keeps its code, even if rounded to a single
        signed = row.kind[k] == SIGNED
        top = 2.0 ** (row.bits[k] - signed) - 1.0
        raw = np.trunc(min(max(raw, -top - 1.0 if signed else 0.0), top))
    _put(row, k, raw, data)
