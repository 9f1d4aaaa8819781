"""Pauses of the bench's time while this machine delays the controller or the emulated drives."""

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

STRANGER = "another participant has sent on this channel: from then on simulated time was not paused"
COUNTED_NS = 1_000_000
"""Shortest counted stretch: on a busy machine each wake-up causes a shorter one."""
_LEAST_NS = 100_000


def bench_clock(c: Configuration, bus: Bus) -> BenchClock | None:
    """Clock of a virtual bus whose time may pause; None for hardware and for `on_stall: fault`."""
    clock = bus.clock
    # all buses share one clock; with a hardware bus among them it is not a bench clock
    return clock if c.loop.on_stall == "stretch" and isinstance(clock, BenchClock) else None


def begin(clock: BenchClock, c: Configuration, protocol: Family, opening: Rows, window_ns: int) -> None:
    """Enable pauses of the bench's time from now on, held by this side as well.

    opening: the frames that start a tick; window_ns: feedback window, ns. The spare time is the window
    without the bus time of these and of the feedback frames, on the fullest bus. A sixth of it is the wake-up
    time of either end, a third the time for answers.
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
    """Summary of pauses of the bench's time; stood_ns (n,): pause before each tick, ns."""
    counted_ns = stood_ns[stood_ns >= COUNTED_NS]
    harmful = int(np.count_nonzero(counted_ns >= HARMFUL_STRETCH_NS))
    note = f"with real drives this machine would have ended the run: {harmful} of them are 4 ms or more"
    return {
        "stretches": len(counted_ns),
        "stood_still_ms": round(1e-6 * float(counted_ns.sum()), 1),
        "longest_ms": round(1e-6 * float(counted_ns.max(initial=0)), 1),
        "note": note if harmful else None,
    }


def stood_still_line(bench_time: dict[str, Any]) -> str:
    """The summary of `stretches` as a line of text; empty without a counted pause."""
    if not bench_time["stretches"]:
        return ""
    times, longest = bench_time["stretches"], bench_time["longest_ms"]
    return (
        f"simulated time paused {times} times, {longest:g} ms at most, while this machine was late: "
        "a real drive would have continued"
    )
