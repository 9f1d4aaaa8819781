"""Timing of a logged loop: late wake-ups, computing time, and delay of the drives' feedback."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.errors import BusError
from drivers.protocol import BUS
from drivers.signals import Warn
from hil.record.log import Log

PERCENTILES = (50.0, 99.0, 99.9, 100.0)


class Traffic(NamedTuple):
    """Traffic on the CAN buses of a run, tick by tick."""

    answered_ns: Array
    """(n,) from the scheduled time of the tick to its last received frame; NaN without a frame."""
    busy_ns: dict[str, Array]
    """Bus name -> (n,) worst-case wire time of a tick's frames, sent and received; empty without timing."""


def traffic(log: Log, rows: Rows, timings: Sequence[BitTiming | None]) -> Traffic:
    """Bus traffic of a run from the frames in its log.

    timings : bit timing of each bus, None for datagrams; empty if frames take no bus time or an unknown one.
    """
    n = len(rows)
    answered = np.full(n, np.nan)
    busy: dict[str, Array] = {}
    names = [f"bus {name}" for name in log.can_channels]
    for k, tick in zip(range(n), log.ticks(), strict=False):  # a growing log may have more ticks by now
        if tick.received:
            answered[k] = max(r.t_ns for r in tick.received) - int(tick.row["t_ns"])
        if not timings:
            continue
        for frame in (*tick.sent, *(r.frame for r in tick.received)):
            bus = frame.flags // BUS
            timing = timings[min(bus, len(timings) - 1)]
            if timing is None:
                continue
            name = names[bus] if bus < len(names) else f"bus {bus}"
            if name not in busy:
                busy[name] = np.zeros(n)
            try:
                busy[name][k] += frame_time_ns(len(frame.data), frame.flags % BUS, timing)
            except BusError:  # an invalid frame takes no bus time
                continue
    return Traffic(answered, busy)


def spreads(rows: Rows, answered_ns: Array) -> list[tuple[str, Array]]:
    """Percentiles of wake-up, computing and feedback, ns at PERCENTILES; times not measured are left out."""
    times = {
        "wake-up, late by": rows["lateness_ns"],
        "computing of a tick": rows["compute_ns"][1:],
        "last feedback after the tick's start": answered_ns[np.isfinite(answered_ns)],
    }
    return [(name, np.percentile(ns, PERCENTILES)) for name, ns in times.items() if np.any(ns)]


def counts(rows: Rows) -> list[tuple[str, int]]:
    """Numbers of late wake-ups and of ticks missing from the log; other counts are figures of the run."""
    late = (rows["warnings"] & Warn.LATE) != 0
    missing = np.maximum(np.diff(rows["tick"]) - 1 - rows["skipped"][1:], 0)
    return [
        (f"late ticks ({Warn.LATE.name})", int(late.sum())),
        ("ticks missing from the log", int(missing.sum())),
    ]
