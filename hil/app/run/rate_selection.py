"""Selects the loop rate that this machine can hold."""

from drivers.errors import RunError
from hil.app.configuration.configuration import Configuration
from hil.app.output import warn
from hil.loop.clock import LATE_PERIODS, LATE_SHARE, STALL_S, fifo_allowed, holdable_rate, late_share

RELAXED_WATCHDOG_S = 0.2
"""Watchdog of emulated drives in a loop without real time. Real drives keep the configured one."""


def select_rate(c: Configuration, *, with_plant: bool, stretching: bool = False) -> tuple[float, float]:
    """(rate Hz, drive watchdog s): as configured, or as this machine can hold.

    with_plant: the drives are emulated on this machine. stretching: the bench's time pauses while this
    machine is late, so the configured values stay. Raises RunError: the loop may not be slowed down.
    """
    rate, watchdog_s = c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3
    if stretching and c.loop.without_realtime == "slow":
        return rate, watchdog_s
    lack = _lack(c, with_plant=with_plant)
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
    text = f"{lack}: the loop runs at {slow:g} Hz instead of {rate:g} Hz" if slow < rate else lack
    if with_plant:
        text += f", emulated drives' watchdog {watchdog_s * 1e3:g} ms"
    if worst_s * slow > patience(c):
        text += f"; stalls of {1e3 * worst_s:.0f} ms now: expect a controlled stop, or free this machine"
    warn(text)
    return slow, watchdog_s


def _lack(c: Configuration, *, with_plant: bool) -> str:
    """Reason why this machine cannot run the loop in real time; empty if it can, or if limits allow stalls.

    With the plant on the same machine SCHED_FIFO must be granted and kept: late feedback makes a leg stale.
    """
    if not fifo_allowed(c.loop.priority):
        return "no right to SCHED_FIFO (as root, or `ulimit -r 99` / rtprio in limits.conf)"
    stall_s = min(patience(c) / c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)  # longest stall that ends no run
    if not with_plant or stall_s >= STALL_S:
        return ""
    late = late_share(c.loop.rate_Hz, c.loop.priority)
    if late <= LATE_SHARE:
        return ""
    late_us = 1e6 * LATE_PERIODS / c.loop.rate_Hz
    return (
        f"this machine does not keep SCHED_FIFO, {100 * late:.1f} % of its wake-ups are {late_us:.0f} us late"
    )


def patience(c: Configuration) -> int:
    """Longest stall of the loop, in periods, that does not end a run."""
    return min(c.limits.missed_stop_ticks, c.limits.stale_fault_ticks)
