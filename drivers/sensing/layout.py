"""Records of the sensors' codec: the table that both ends share, and the state of the reception."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.compiled.pointed import data_at
from drivers.signals import LEGS
from drivers.tick_columns import Record

TRACKER, IMU, WRENCH, INCLINATION, LENGTH = range(5)
FORCE = LENGTH + LEGS
SLOTS = FORCE + LEGS
"""A slot is one measurement: the pose, ..., the length of leg i in LENGTH + i, its force in FORCE + i."""
SLOTS_OF = {
    "tracker": (TRACKER,), "imu": (IMU,), "wrench": (WRENCH,), "inclination": (INCLINATION,),
    "lengths": tuple(range(LENGTH, LENGTH + LEGS)), "forces": tuple(range(FORCE, FORCE + LEGS)),
}  # fmt: skip
"""Role of a sensor, a key of section `sensors` -> its slots."""
QUANTITIES = 6
OFFSET, CYCLE, COUNTER, VALIDITY, QUALITY = range(QUANTITIES, QUANTITIES + 5)
"""Targets of a field after the quantities: time after SYNC and its Cycle, counter of samples, validity, and a
value that has to be in its range. With FREE, the time is that of the sensor's own clock."""
FIELDS = QUANTITIES + 5
UNSIGNED, SIGNED, FLOAT = range(3)
"""Kinds of a field; FLOAT has 32 or 64 bits."""
STAMPED, SYNCED, FREE = range(3)
"""Instant of a sample: in its frame; the SYNC or poll that it answers; its arrival less the latency."""
CONDITIONS = 4
SELECTS, SKIPS = 1, 2
"""`selects` of a condition: a frame in which it does not hold, or in which it holds, is another message."""
MOST = 256
"""Most samples of one slot in one tick; further ones are refused."""
NEVER = -1
"""Counter before the first frame."""

SAMPLE = np.dtype([("tick", "<i8"), ("offset_s", "<f8"), ("values", "<f8", (QUANTITIES,))])
"""One measurement: tick of the SYNC before it, time from the end of that SYNC, and values in SI. Tracker:
position in the base frame, rotation vector from platform to base. IMU: angular rate, specific force. Wrench:
force, moment. IMU and wrench are in the platform frame. Inclination: roll, pitch. Leg: length, or force."""
ROW = np.dtype(
    [
        *((name, "<i8") for name in ("id", "flags", "bus", "length", "exact", "slot", "part", "checked")),
        ("fields", "<i8"), ("conditions", "<i8"),
        *((name, "<i8", (FIELDS,)) for name in ("start", "bits", "big", "kind", "to")),
        *((name, "<f8", (FIELDS,)) for name in ("scale", "offset", "low", "high")),
        *((name, "<i8", (CONDITIONS,)) for name in ("at", "wide", "from_top", "mask", "equals", "selects")),
    ]
)  # fmt: skip
"""One message of a slot. Bytes: `length` of them, or with `exact` 0 at least so many; `part`: its bit among
the messages of a sample; `checked`: it ends in the CRC-8 of sensors.dbc. A field goes from raw to SI by
scale and offset; values outside low .. high are refused. A condition compares masked bits: SELECTS, SKIPS, or
0: if they differ, the sample is invalid."""
SLOT = np.dtype(
    [
        *((name, "<i8") for name in ("present", "parts", "timing", "clocked", "mixes", "gap_ns")),
        ("latency_s", "<f8"), ("lag_s", "<f8"),
        ("mix", "<f8", (QUANTITIES, QUANTITIES)), ("shift", "<f8", (QUANTITIES,)),
        ("placed", "<i8"), ("frame", "<f8", (3, 3)), ("target", "<f8", (3, 3)), ("lever", "<f8", (3,)),
        ("limit", "<f8", (QUANTITIES,)), ("time_s", "<f8"), ("patience_s", "<f8"),
        *((name, "<i8") for name in ("got", "valid", "began_ns", "counter", "count", "last_tick")),
        ("last_s", "<f8"), ("raw", "<f8", (QUANTITIES,)), ("last", "<f8", (QUANTITIES,)),
        ("compared", "<i8"), ("share", "<f8"), ("gap", "<f8", (QUANTITIES,)), ("mean", "<f8", (QUANTITIES,)),
    ]
)  # fmt: skip
"""A measurement. Table: bits of all its messages; STAMPED, SYNCED or FREE; with FREE, whether its frames
carry the time of its own clock; longest time between the messages of one sample; if `mixes`, values = mix
fields + shift; if `placed`, the orientation is that of frame (sensor) target and the position that of the
point -lever of it; limits of the mean difference from the legs, inf for none; error of a sample's instant;
age of a silent sensor. Reception: least time from a stamp of its clock to an arrival; parts of the sample,
whether they are valid, its first frame; counter of the last frame; samples of this tick; the last sample;
samples compared with the legs, share of the limit, the last difference, and the mean one."""
SENSORS = np.dtype([(name, "<i8") for name in ("rows", "size", "slots", "samples", "rejected", "lost")])
"""Addresses of `size` elements of ROW, of SLOTS elements of SLOT and of (SLOTS, MOST) elements of SAMPLE; in
this tick refused frames, and samples missing by their counters."""


def raw_ends(bits: int, kind: int) -> tuple[float, float]:
    """Smallest and largest raw value of a field."""
    if kind == FLOAT:
        most = float(np.finfo(np.float32 if bits == 32 else np.float64).max)
        return -most, most
    return (-float(1 << bits - 1), float((1 << bits - 1) - 1)) if kind else (0.0, float((1 << bits) - 1))


class Tables(NamedTuple):
    """Tables of a configuration's sensors, without any reception."""

    rows: Rows
    """Elements of ROW."""
    slots: Rows
    """SLOTS elements of SLOT."""


def no_sensors() -> Tables:
    """Tables without any sensor."""
    return Tables(np.zeros(0, ROW), np.zeros(SLOTS, SLOT))


class Reception(NamedTuple):
    """A record of SENSORS, and the arrays at its addresses."""

    record: Record
    rows: Rows
    slots: Rows
    samples: Rows

    def compare_again(self) -> None:
        """Forget how the sensors differed from the legs."""
        self.slots["compared"] = 0

    def forget(self) -> None:
        """Back to the state before any frame."""
        self.compare_again()
        s = self.slots
        s["counter"], s["last"], s["last_s"], s["got"], s["lag_s"] = NEVER, np.nan, -np.inf, 0, np.nan


def unheard(tables: Tables) -> Reception:
    """Reception before any frame."""
    rows, slots, record = tables.rows, tables.slots.copy(), np.zeros((), SENSORS)
    found = Reception(record, rows, slots, np.zeros((SLOTS, MOST), SAMPLE))
    for name, array in (("rows", rows), ("slots", slots), ("samples", found.samples)):
        record[name] = data_at(array)
    record["size"] = len(rows)
    found.forget()
    return found
