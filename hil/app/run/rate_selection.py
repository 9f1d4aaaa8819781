"""At which rate the loop runs on this machine, and whether a run ended because it was not kept."""

from __future__ import annotations

from drivers.errors import RunError
from drivers.signals import DriveFault, Measurement
from hil.app.configuration.configuration import Configuration
from hil.app.output import warn
from hil.loop.clock import (
    LATE_PERIODS,
    LATE_SHARE,
    STALL_S,
    SLOWEST_Hz,
    fifo_allowed,
    holdable_rate,
    late_share,
)
from hil.loop.daemon import Ending
from hil.signals import Fault, Mode

RELAXED_WATCHDOG_S = 0.2
"""Watchdog of emulated drives where the loop has no real time. Real drives keep the configured one."""


def pace(c: Configuration, *, with_plant: bool, lack: str = "") -> tuple[float, float]:
    """Return rate (Hz) and drive watchdog (s): the configured ones, or what holds without real time.

    `lack` says what real time lacks, where it is known. Raises RunError where the loop may not be slowed.
    """
    rate, watchdog_s = c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3
    lack = lack or _lack(c, with_plant=with_plant)
    if not lack:
        return rate, watchdog_s
    if c.loop.without_realtime == "refuse":
        raise RunError(f"{lack}, and loop.without_realtime is `refuse`: nothing was started")
    slow, worst_s = holdable_rate(rate, patience(c))
    if with_plant:
        watchdog_s = max(watchdog_s, RELAXED_WATCHDOG_S)
    elif 3.0 / slow > watchdog_s:
        raise RunError(
            f"{lack}: this machine holds {slow:g} Hz now, drives.watchdog_ms {watchdog_s * 1e3:g} needs at "
            f"least {3.0 / watchdog_s:.0f} Hz; grant SCHED_FIFO or lengthen the watchdog"
        )
    consequences = []
    if slow < rate:
        consequences.append(f"the loop runs at {slow:g} Hz instead of {rate:g} Hz")
    if with_plant:
        consequences.append(f"emulated drives' watchdog {watchdog_s * 1e3:g} ms")
    said = lack + (f": {', '.join(consequences)}" if consequences else "")
    if worst_s * slow > patience(c):
        stall_ms = worst_s * 1e3
        said += f"; stalls of {stall_ms:.0f} ms now: expect a controlled stop, or take load off this machine"
    warn(said)
    return slow, watchdog_s


def _lack(c: Configuration, *, with_plant: bool) -> str:
    """Say why the loop has no real time; empty if it has, or if the limits outlast what may come.

    With the plant on this machine, too, SCHED_FIFO has to be kept and not only granted: an answer that comes
    later than the feedback window is a stale leg.
    """
    if not fifo_allowed(c.loop.priority):
        return "no right to SCHED_FIFO (as root, or `ulimit -r 99` / rtprio in limits.conf)"
    if not with_plant or _patience_s(c) >= STALL_S:
        return ""
    late = late_share(c.loop.rate_Hz, c.loop.priority)
    if late <= LATE_SHARE:
        return ""
    late_us = 1e6 * LATE_PERIODS / c.loop.rate_Hz
    return (
        f"this machine does not keep SCHED_FIFO, {100 * late:.1f} % of its wake-ups are {late_us:.0f} us late"
    )


def patience(c: Configuration) -> int:
    """Return how many periods a stall may last that ends no run."""
    return min(c.limits.missed_stop_ticks, c.limits.stale_fault_ticks)


def _patience_s(c: Configuration) -> float:
    """Return the longest stall that ends no run at the configured rate."""
    return min(patience(c) / c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)


def stalled(
    c: Configuration, measurement: Measurement, ending: Ending, rate: float, watchdog_s: float
) -> bool:
    """Tell whether a run at the configured rate ended as a stall ends it that a slower loop outlasts.

    That is: legs not heard in time, drives that missed their commands (the reference may have left them
    behind), or missed periods, and nothing else. `measurement` is the last one, `rate` (Hz) and `watchdog_s`
    what was used. Only on localcan, where all that answers is a process of this machine.
    """
    if c.bus.interface != "localcan" or c.loop.without_realtime == "refuse" or ending.raised:
        return False
    if rate < c.loop.rate_Hz:
        return False
    slower_outlasts_more = rate >= 2.0 * SLOWEST_Hz and patience(c) / rate < STALL_S
    if ending.mode is not Mode.FAULT:
        return ending.missed and slower_outlasts_more
    of_a_stall = Fault.STALE
    reported = set(measurement.fault.tolist()) - {DriveFault.NONE}
    if reported == {DriveFault.WATCHDOG} and (slower_outlasts_more or watchdog_s < STALL_S):
        of_a_stall |= Fault.DRIVE | Fault.FOLLOWING
    elif reported or not slower_outlasts_more:
        return False
    return bool(ending.faults) and not ending.faults & ~of_a_stall
