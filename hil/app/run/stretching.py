"""A virtual bench whose time stands still while this machine holds one side up."""

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

STRANGER = "a foreign participant has sent on this channel: bench time did not stand still any more"
COUNTED_NS = 1_000_000
"""Shorter stretches are not counted: each wake-up of a busy machine is one."""
_LEAST_NS = 100_000


def bench_clock(c: Configuration, bus: Bus) -> BenchClock | None:
    """Return the clock that may stand still; None where time must not: hardware, or `on_stall: fault`."""
    clock = bus.clock
    # all on one clock: a bus of hardware among them goes by its own
    return clock if c.loop.on_stall == "stretch" and isinstance(clock, BenchClock) else None


def begin(clock: BenchClock, c: Configuration, protocol: Family, opening: Rows, window_ns: int) -> None:
    """Let time stand still from now on, and hold it.

    opening: the frames that start a tick. Of what these and the feedbacks leave of the feedback window, on
    the fullest bus, a part each is for the controller to wake up in, for the drives to do so, and two for
    these to answer; the rest is kept.
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
    """Return what is reported of ticks before each of which bench time stood still for so many ns."""
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
    """Return `stretches` as a line; empty where none counts."""
    if not bench_time["stretches"]:
        return ""
    times, longest = bench_time["stretches"], bench_time["longest_ms"]
    return (
        f"bench time stood still {times} times, {longest:g} ms at most, while this machine was late: "
        "a real drive goes on"
    )
