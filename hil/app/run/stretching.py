"""Bench time that stands still while this machine delays the controller or the drives."""

from typing import Any

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.can.localcan.bench_clock import BenchClock
from drivers.family import Family
from drivers.frame_array import sent_frames
from hil.app.configuration.configuration import Configuration
from hil.safety.signals import HARMFUL_STRETCH_NS

STRANGER = "another participant has sent on this channel: from then on bench time did not stand still"
COUNTED_NS = 1_000_000
"""Shortest counted stretch: on a busy machine each wake-up causes a shorter one."""
_LEAST_NS = 100_000


def bench_clock(c: Configuration, bus: Bus) -> BenchClock | None:
    """Clock that may stand still; None for hardware and for `on_stall: fault`."""
    clock = bus.clock
    # all buses share one clock; with a hardware bus among them it is not a bench clock
    return clock if c.loop.on_stall == "stretch" and isinstance(clock, BenchClock) else None


def begin(clock: BenchClock, c: Configuration, protocol: Family, opening: Rows, window_ns: int) -> None:
    """Enable stretched time from now on; this side can hold the clock.

    opening: the frames that start a tick. The spare time is the feedback window without the bus time of these
    and of the feedback frames, on the fullest bus. A sixth of it is the wake-up time of either end, a third
    the time for answers.
    """
    bus_ns = max(
        sum(
            frame_time_ns(len(f.data), f.flags, BitTiming.of(each))
            for f in (*sent_frames(opening), *protocol.traits.feedbacks)
            if f.bus == index
        )
        for index, each in enumerate(c.bus.buses)
    )
    spare_ns = max(window_ns - bus_ns, _LEAST_NS)
    clock.begin(wake_ns=spare_ns // 6, work_ns=spare_ns // 3)
    clock.holds = True


def stretches(stood_ns: Ints) -> dict[str, Any]:
    """Summary of stretched time. stood_ns: time for which bench time stood still before each tick."""
    counted_ns = stood_ns[stood_ns >= COUNTED_NS]
    harmful = int(np.count_nonzero(counted_ns >= HARMFUL_STRETCH_NS))
    note = f"with real drives this machine would have ended the run: {harmful} of them are 4 ms or more"
    return {
        "stretches": len(counted_ns),
        "stood_still_ms": round(1e-6 * float(stood_ns.sum()), 1),
        "longest_ms": round(1e-6 * float(stood_ns.max(initial=0)), 1),
        "note": note if harmful else None,
    }


def stood_still_line(bench_time: dict[str, Any]) -> str:
    """The summary of `stretches` as a line; empty without a counted stretch."""
    if not bench_time["stretches"]:
        return ""
    times, longest = bench_time["stretches"], bench_time["longest_ms"]
    return (
        f"bench time stood still {times} times, {longest:g} ms at most, while this machine was late: "
        "a real drive would have gone on"
    )
