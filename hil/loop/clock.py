"""Fixed-rate deadlines, and the operating system's real-time settings."""

import contextlib
import ctypes
import gc
import os
import struct
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from drivers.clock import MONOTONIC, Clock

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4


class Wake(NamedTuple):
    """One wake-up of the loop: tick number, scheduled time and lateness."""

    tick: int
    t_ns: int
    """Scheduled time of the tick, ns."""
    lateness_ns: int
    skipped: int
    """Whole periods that had passed before the loop came back."""


class Deadlines:
    """Absolute deadlines t0 + k T that keep phase: missed periods are skipped, never caught up.

    Mutable state: the last tick. Times are those of `clock`, ns.
    """

    def __init__(
        self, rate_Hz: float, spin_us: float, start_ns: int | None = None, clock: Clock = MONOTONIC
    ) -> None:
        self.clock = clock
        self.period_ns = round(1e9 / rate_Hz)
        self.spin_ns = round(spin_us * 1e3)
        self.start_ns = clock.now() + 2 * self.period_ns if start_ns is None else start_ns
        self.tick = -1

    def wait(self) -> Wake:
        """Sleep, then busy-wait, until the next deadline in the future."""
        tick = self.tick + 1
        now = self.clock.now()
        skipped = max(0, (now - self.start_ns) // self.period_ns - tick)
        tick += skipped
        due = self.start_ns + tick * self.period_ns
        self.clock.sleep_until(due, self.spin_ns)
        now = self.clock.now()
        self.tick = tick
        return Wake(tick, due, now - due, skipped)


@dataclass
class RealTime:
    """Real-time settings that the kernel granted, and those that are missing."""

    granted: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    @property
    def fifo(self) -> bool:
        """True if the kernel granted SCHED_FIFO to the loop."""
        return "SCHED_FIFO" in self.granted


@contextlib.contextmanager
def collector_paused() -> Iterator[None]:
    """Disable the garbage collector: a full collection takes ms; the loop makes no reference cycles."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextlib.contextmanager
def real_time(priority: int, cpu: int | None) -> Iterator[RealTime]:
    """Request real-time scheduling by `real_time_rights`; freeze and disable the garbage collector.

    Undone on exit; objects frozen before stay frozen. Compile and allocate before entering.
    """
    with real_time_rights(priority, cpu) as report:
        others = gc.get_freeze_count()
        gc.collect()
        gc.freeze()
        try:
            with collector_paused():
                yield report
        finally:
            if not others:
                gc.unfreeze()


@contextlib.contextmanager
def real_time_rights(priority: int, cpu: int | None) -> Iterator[RealTime]:
    """Request real-time scheduling of this process, each setting as far as the user's permissions allow.

    The settings are SCHED_FIFO (reset on fork), and with it CPU pinning, memory locked on fault, no deep CPU
    sleep. On exit, policy and priority are restored as far as the permissions allow.
    """
    report = RealTime()
    if not hasattr(os, "sched_getscheduler"):
        report.missing.append(f"all of it, which needs Linux and not {sys.platform}")
        yield report
        return
    latency = None
    before, scheduling = os.sched_getaffinity(0), _scheduling()
    _attempt(report, "SCHED_FIFO", lambda: _fifo(priority))
    if report.fifo and cpu is not None:
        _attempt(report, f"CPU {cpu}", lambda: os.sched_setaffinity(0, {cpu}))
    _attempt(report, "locked memory", lambda: _mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT))
    try:
        latency = os.open("/dev/cpu_dma_latency", os.O_WRONLY)
        os.write(latency, struct.pack("i", 0))
        report.granted.append("cpu_dma_latency 0")
    except OSError as error:
        report.missing.append(f"cpu_dma_latency ({error.strerror})")
    try:
        yield report
    finally:
        if latency is not None:
            os.close(latency)
        if report.fifo:
            _reschedule(*scheduling)
        os.sched_setaffinity(0, before)
        with contextlib.suppress(OSError):
            _mlockall(0)


def fifo_allowed(priority: int) -> bool:
    """True if this process may use SCHED_FIFO at this priority; then restores its policy if permitted."""
    scheduling = _scheduling()
    try:
        _fifo(priority)
    except OSError:
        return False
    _reschedule(*scheduling)
    return True


def _attempt(report: RealTime, name: str, action: Callable[[], None]) -> None:
    try:
        action()
    except OSError as error:
        report.missing.append(f"{name} ({error.strerror})")
    else:
        report.granted.append(name)


def _fifo(priority: int) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _scheduling() -> "tuple[int, os.sched_param]":
    """Scheduling policy, including its reset-on-fork flag, and its parameters."""
    return os.sched_getscheduler(0), os.sched_getparam(0)


def _reschedule(policy: int, parameters: "os.sched_param") -> None:
    """Restore the scheduling policy from before `_fifo`, as far as permitted.

    An ordinary user may not remove the reset-on-fork flag.
    """
    try:
        os.sched_setscheduler(0, policy, parameters)
    except PermissionError:
        with contextlib.suppress(
            PermissionError
        ):  # nor, once below it, go back to a priority above the limit
            os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, parameters)


def _mlockall(flags: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    result = libc.mlockall(flags) if flags else libc.munlockall()
    if result != 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))


STALL_S = 0.040
"""Longest stall expected on a machine without real-time scheduling (32 ms was measured)."""
LATE_PERIODS = 0.1
"""A wake-up is late beyond this share of the period."""
LATE_SHARE = 0.01
"""With a larger share of late wake-ups under SCHED_FIFO, a machine does not keep real time."""
SLOWEST_Hz = 100.0
"""Lowest rate that is proposed: a slower loop has a delay that uses up the phase margin of a usual control
law."""


def holdable_rate(rate_Hz: float, periods: int, seconds: float = 1.0) -> tuple[float, float]:
    """Highest of rate, rate/2, rate/4 ..., Hz, that is safe without real-time scheduling; worst wake-up, s.

    Measures the worst lateness of a wake-up for `seconds`, under the present load. A stall of `periods`
    periods ends a run: at the returned rate these take at least STALL_S and twice the worst lateness. Not
    below SLOWEST_Hz.
    """
    deadlines = Deadlines(rate_Hz, 0.0)
    wakes = [deadlines.wait() for _ in range(round(seconds * rate_Hz))]
    worst = max(w.lateness_ns + w.skipped * deadlines.period_ns for w in wakes) * 1e-9
    rate = rate_Hz
    while periods / rate < max(STALL_S, 2.0 * worst) and rate / 2.0 >= SLOWEST_Hz:
        rate /= 2.0
    return rate, worst


def late_share(rate_Hz: float, priority: int, seconds: float = 0.5) -> float:
    """Share (0..1) of late wake-ups under SCHED_FIFO, measured for `seconds` under the present load."""
    with real_time(priority, None):
        deadlines = Deadlines(rate_Hz, 0.0)
        wakes = [deadlines.wait() for _ in range(round(seconds * rate_Hz))]
    limit_ns = LATE_PERIODS * deadlines.period_ns
    return sum(w.lateness_ns > limit_ns or w.skipped > 0 for w in wakes) / len(wakes)


def resident_MB() -> float:
    """Peak resident memory of this process, MB."""
    import resource  # noqa: PLC0415 - not on Windows

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
