"""Deadlines keep phase and never catch up; missing rights are reported; all rights are undone at the end."""

from __future__ import annotations

import contextlib
import errno
import gc
import itertools
import os
import time
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import pytest

from drivers.clock import Clock
from hil.loop import clock
from hil.loop.clock import Deadlines, Wake, fifo_allowed, holdable_rate, late_share, real_time

MS = 1_000_000


def policy() -> int:
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


def test_tick_deadlines_are_absolute_keep_their_phase_and_are_never_early() -> None:
    start = time.monotonic_ns() + 2 * MS
    deadlines = Deadlines(500.0, 100.0, start_ns=start)
    wakes = []
    for _ in range(20):
        wakes.append(deadlines.wait())
        assert time.monotonic_ns() >= wakes[-1].t_ns
    assert [w.t_ns for w in wakes] == [start + w.tick * 2 * MS for w in wakes]
    assert all(w.lateness_ns >= 0 for w in wakes)
    assert wakes[-1].tick == len(wakes) - 1 + sum(w.skipped for w in wakes)


class Hands(Clock):
    """A clock that stands still until a call of sleep, which wakes up 30 us late."""

    def __init__(self, t_ns: int) -> None:
        self.t_ns = t_ns
        self.spun_ns: set[int] = set()

    def now(self) -> int:
        return self.t_ns

    def sleep_until(self, t_ns: int, spin_ns: int = 0) -> None:
        self.spun_ns.add(spin_ns)
        if t_ns > self.t_ns:
            self.t_ns = t_ns + 30_000


@pytest.mark.parametrize("start_ns", [0, 5_000_000_000, 10**18])
def test_late_loop_continues_with_the_current_period_and_skips_the_missed_ones(start_ns: int) -> None:
    hands = Hands(start_ns - 700_000)
    deadlines = Deadlines(1000.0, 12.5, start_ns, hands)
    assert deadlines.wait() == Wake(0, start_ns, 30_000, 0)
    for busy_ns, tick, lateness_ns, skipped in [
        (400_000, 1, 30_000, 0),
        (1_200_000, 2, 230_000, 0),
        (3_000_000, 5, 230_000, 2),
        (1_770_000, 7, 0, 1),
        (0, 8, 30_000, 0),
    ]:
        hands.t_ns += busy_ns
        assert deadlines.wait() == Wake(tick, start_ns + tick * MS, lateness_ns, skipped)
    assert hands.spun_ns == {12_500}, "spin_us of the configuration is in microseconds"
    assert Deadlines(1000.0, 0.0, None, hands).start_ns == hands.t_ns + 2 * MS


@pytest.fixture
def thawed() -> Iterator[None]:
    """No object is frozen before the test; all are frozen again after it."""
    gc.unfreeze()
    yield
    gc.freeze()


@pytest.mark.usefixtures("thawed")
@pytest.mark.parametrize("raises", [False, True])
def test_real_time_mode_reports_each_system_privilege_once_and_reverts_all_at_its_end(raises: bool) -> None:
    affinity = os.sched_getaffinity(0)
    with contextlib.suppress(ZeroDivisionError), real_time(1, None) as report:
        assert not gc.isenabled()
        names = sorted(text.split(" ")[0] for text in report.granted + report.missing)
        assert names == ["SCHED_FIFO", "cpu_dma_latency", "locked"]
        assert report.fifo == (policy() == os.SCHED_FIFO)
        if raises:
            raise ZeroDivisionError
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert policy() == os.SCHED_OTHER
    assert os.sched_getaffinity(0) == affinity
    fifo_allowed(1)
    assert policy() == os.SCHED_OTHER


@pytest.mark.usefixtures("thawed")
def test_real_time_mode_collects_garbage_and_freezes_live_objects() -> None:
    class Node:
        """An object that may refer to itself."""

    with clock.collector_paused():
        node: Any = Node()
        node.itself = node
        gone = weakref.ref(node)
        del node
        with real_time(1, None):
            assert gone() is None
            assert gc.get_freeze_count() > 0
    gc.freeze()
    with real_time(1, None):
        pass
    assert gc.get_freeze_count() > 0, "objects frozen before must stay frozen"


class Kernel:
    """The kernel's calls for one process; an ordinary user cannot clear the reset on fork."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, policy: int = 0, priority: int = 0, *, ordinary: bool = False
    ) -> None:
        self.now, self.ordinary = (policy, priority), ordinary
        self.did: list[tuple[object, ...]] = []
        monkeypatch.setattr(os, "sched_getscheduler", lambda pid: self.now[0] if pid == 0 else 99)
        monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(self.now[1] if pid == 0 else 99))
        monkeypatch.setattr(os, "sched_setscheduler", self.set)
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {7 + pid, 8})
        monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cpus: self.did.append(("pin", pid, *cpus)))
        monkeypatch.setattr(clock, "_mlockall", lambda flags: self.did.append(("lock", flags)))

    def set(self, pid: int, policy: int, parameters: os.sched_param) -> None:
        assert pid == 0, "process id 0 means the calling process"
        if self.ordinary and self.now[0] & ~policy & os.SCHED_RESET_ON_FORK:
            raise PermissionError(1, "no right")
        self.now = policy, parameters.sched_priority


POLICIES = [
    (os.SCHED_OTHER, 0),
    (os.SCHED_BATCH, 0),
    (os.SCHED_IDLE, 0),
    (os.SCHED_RR, 7),
    (os.SCHED_FIFO, 42),
]


@pytest.mark.parametrize("reset", [0, os.SCHED_RESET_ON_FORK])
@pytest.mark.parametrize(("policy", "priority"), POLICIES)
@pytest.mark.parametrize("ordinary", [False, True])
def test_a_process_returns_to_its_original_policy_and_priority(
    monkeypatch: pytest.MonkeyPatch, policy: int, priority: int, reset: int, ordinary: bool
) -> None:
    """An ordinary user keeps the reset on fork of SCHED_FIFO, with the original policy."""
    kernel = Kernel(monkeypatch, policy | reset, priority, ordinary=ordinary)
    kept = os.SCHED_RESET_ON_FORK if ordinary else reset
    assert fifo_allowed(80)
    assert kernel.now == (policy | kept, priority)
    kernel.now = policy | reset, priority
    with clock.real_time_rights(80, None) as report:
        assert report.fifo
        assert kernel.now == (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 80)
    assert kernel.now == (policy | kept, priority)


def no(*_: object) -> NoReturn:
    raise PermissionError(errno.EPERM, "no right")


@pytest.mark.parametrize("fifo", [True, False])
@pytest.mark.parametrize("others", [True, False])
def test_granted_system_privileges_are_reported_and_reverted_and_missing_ones_explained(
    monkeypatch: pytest.MonkeyPatch, fifo: bool, others: bool
) -> None:
    """The process is pinned only together with SCHED_FIFO."""
    kernel = Kernel(monkeypatch)
    latency: list[tuple[object, ...]] = []

    def opened(path: str, *flags: int) -> int:
        latency.append((path, *flags))
        return 99 if others else no()

    if not fifo:
        monkeypatch.setattr(os, "sched_setscheduler", no)
    if not others:
        monkeypatch.setattr(clock, "_mlockall", no)
    with monkeypatch.context() as patched:
        patched.setattr(os, "open", opened)
        patched.setattr(os, "write", lambda *given: latency.append(given))
        patched.setattr(os, "close", lambda *given: latency.append(given))
        with clock.real_time_rights(1, 5) as report:
            assert report.fifo is fifo
            granted = ["SCHED_FIFO", "CPU 5"] * fifo + ["locked memory", "cpu_dma_latency 0"] * others
            assert report.granted == granted
            missing = ["SCHED_FIFO"] * (not fifo) + ["locked memory", "cpu_dma_latency"] * (not others)
            assert report.missing == [f"{name} (no right)" for name in missing]
            held = [("pin", 0, 5)] * fifo + [("lock", 7)] * others
            assert kernel.did == held, "MCL_CURRENT, MCL_FUTURE and MCL_ONFAULT of the kernel"
            said = [("/dev/cpu_dma_latency", os.O_WRONLY), *[(99, bytes(4))] * others]
            assert latency == said
    assert kernel.did == [*held, ("pin", 0, *{7, 8}), *[("lock", 0)] * others]
    assert latency == [*said, *[(99,)] * others]
    assert fifo_allowed(1) is fifo


@pytest.fixture
def wakes(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A function that sets lateness and skips of each wake-up, in turn; it returns the periods waited."""

    def give(*found: tuple[int, int]) -> list[int]:
        again, waited = itertools.cycle(found), list[int]()

        def wait(deadlines: Deadlines) -> Wake:
            waited.append(deadlines.period_ns)
            return Wake(0, 0, *next(again))

        monkeypatch.setattr(Deadlines, "wait", wait)
        return waited

    return give


@pytest.mark.parametrize(
    ("found", "worst_s", "rate_Hz"),
    [
        ([(9_000_000, 0)], 0.009, 1000.0),
        ([(500_000, 49)], 0.0495, 1000.0),
        ([(500_000, 50)], 0.0505, 500.0),
        ([(900_000, 0), (500_000, 119), (0, 0)], 0.1195, 250.0),
        ([(0, 0), (120_000_000, 3)], 0.123, 250.0),
    ],
)
def test_selected_loop_rate_tolerates_twice_the_worst_measured_stall(
    wakes: Any, found: list[tuple[int, int]], worst_s: float, rate_Hz: float
) -> None:
    """100 periods last 0.1 s at 1 kHz; skipped periods and lateness count together."""
    waited = wakes(*found)
    found_Hz, found_s = holdable_rate(1000.0, periods=100, seconds=0.01)
    assert waited == [1_000_000] * 10
    assert found_Hz == rate_Hz
    assert found_s == pytest.approx(worst_s)


@pytest.mark.parametrize(
    ("rate_Hz", "periods", "found_Hz"),
    [
        (400.0, 5, 100.0),
        (200.0, 8, 200.0),
        (200.0, 7, 100.0),
        (200.0, 2, 100.0),
        (199.0, 2, 199.0),
        (50.0, 5, 50.0),
    ],
)
def test_selected_loop_rate_tolerates_stalls_of_40_ms_and_is_at_least_100_Hz(
    wakes: Any, rate_Hz: float, periods: int, found_Hz: float
) -> None:
    wakes((0, 0))
    assert holdable_rate(rate_Hz, periods=periods, seconds=0.05) == (found_Hz, 0.0)


def test_a_wake_up_later_than_a_tenth_of_the_period_or_skipping_is_late(wakes: Any) -> None:
    waited = wakes((0, 0), (100_000, 0), (101_000, 0), (0, 1))
    assert late_share(1000.0, 1, seconds=0.4) == 0.5
    assert late_share(500.0, 1, seconds=0.4) == 0.25
    assert waited == [1_000_000] * 400 + [2_000_000] * 200


def test_peak_resident_memory_agrees_with_the_kernels_status() -> None:
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    assert clock.resident_MB() == pytest.approx(int(lines["VmHWM"].split()[0]) / 1024, rel=0.1)
