"""Deadlines keep phase and never catch up; rights that are missing are named, and nothing outlives the block."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import gc
import itertools
import os
import time
import weakref
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import Clock
from hil.loop import clock
from hil.loop.clock import (
    STALL_S,
    Deadlines,
    SLOWEST_Hz,
    Wake,
    fifo_allowed,
    holdable_rate,
    late_share,
    real_time,
    resident_MB,
)


def test_deadlines_are_absolute_and_keep_phase() -> None:
    start = time.monotonic_ns() + 2_000_000
    deadlines = Deadlines(500.0, 0.0, start_ns=start)
    wakes = [deadlines.wait() for _ in range(20)]
    assert [w.t_ns for w in wakes] == [start + w.tick * 2_000_000 for w in wakes]
    assert all(w.lateness_ns >= 0 for w in wakes)
    assert wakes[-1].tick == len(wakes) - 1 + sum(w.skipped for w in wakes)


def test_periods_that_are_over_are_skipped_and_counted_not_caught_up() -> None:
    deadlines = Deadlines(100.0, 0.0)
    first = deadlines.wait()
    time.sleep(0.035)
    late = deadlines.wait()
    after = deadlines.wait()
    assert late.skipped >= 2, "three periods later: two are lost whole, the next one is under way"
    assert late.tick == first.tick + 1 + late.skipped
    assert (late.t_ns - first.t_ns) % 10_000_000 == 0
    assert after.t_ns - late.t_ns >= 10_000_000, "no burst"


def test_a_loop_that_comes_back_within_its_period_skips_nothing() -> None:
    start = time.monotonic_ns() + 1_000_000
    deadlines = Deadlines(2.0, 0.0, start_ns=start)
    deadlines.wait()
    time.sleep(0.1)
    wake = deadlines.wait()
    assert (wake.tick, wake.skipped, wake.t_ns) == (1, 0, start + 500_000_000)


def test_a_wake_up_is_never_early() -> None:
    deadlines = Deadlines(1000.0, 200.0)
    for _ in range(50):
        wake = deadlines.wait()
        assert time.monotonic_ns() >= wake.t_ns


class Hands(Clock):
    """A clock that stands until somebody sleeps, and then wakes up 30 us late."""

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
def test_a_loop_goes_on_with_the_period_under_way_whenever_its_clock_began(start_ns: int) -> None:
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
        due_ns = start_ns + tick * 1_000_000
        assert deadlines.wait() == Wake(tick, due_ns, lateness_ns, skipped)
    assert hands.spun_ns == {12_500}, "us in a configuration"
    assert Deadlines(1000.0, 0.0, None, hands).start_ns == hands.t_ns + 2_000_000


@pytest.fixture
def thawed() -> Iterator[None]:
    """Nothing is frozen but what the test freezes; the suite's own is frozen again afterwards."""
    gc.unfreeze()
    yield
    gc.freeze()


@pytest.mark.usefixtures("thawed")
def test_real_time_names_each_part_once_and_undoes_all() -> None:
    affinity = os.sched_getaffinity(0)
    with real_time(1, None) as report:
        assert not gc.isenabled()
        names = sorted(text.split(" ")[0] for text in report.granted + report.missing)
        assert names == ["SCHED_FIFO", "cpu_dma_latency", "locked"]
        assert report.fifo == (os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO)
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
    assert os.sched_getaffinity(0) == affinity


@pytest.mark.usefixtures("thawed")
def test_real_time_leaves_no_garbage_behind_and_freezes_what_lives() -> None:
    class Node:
        """May be part of a cycle."""

    with clock.collector_paused():
        node: Any = Node()
        node.itself = node
        gone = weakref.ref(node)
        del node
        with real_time(1, None):
            assert gone() is None
            assert gc.get_freeze_count() > 0


@pytest.mark.usefixtures("thawed")
def test_what_others_had_frozen_stays_so() -> None:
    gc.freeze()
    with real_time(1, None):
        pass
    assert gc.get_freeze_count() > 0


def test_real_time_is_undone_after_an_exception() -> None:
    with pytest.raises(ZeroDivisionError), real_time(1, None):
        raise ZeroDivisionError
    assert gc.isenabled()
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


@pytest.mark.parametrize("fifo", [True, False])
def test_the_process_is_pinned_only_with_fifo_and_pin_and_memory_lock_are_undone(
    monkeypatch: pytest.MonkeyPatch, fifo: bool
) -> None:
    pinned: list[tuple[int, set[int]]] = []
    locked: list[int] = []

    def refuse(_priority: int) -> None:
        raise PermissionError(1, "no right")

    monkeypatch.setattr(clock, "_fifo", (lambda _: None) if fifo else refuse)
    monkeypatch.setattr(clock, "_mlockall", locked.append)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {7 + pid, 8})
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cpus: pinned.append((pid, set(cpus))))
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: None)
    with clock.real_time_rights(1, 5):
        assert pinned == [(0, {5})] * fifo, "0: this process"
        assert locked == [7], "MCL_CURRENT, MCL_FUTURE and MCL_ONFAULT of the kernel"
    assert pinned == [(0, {5})] * fifo + [(0, {7, 8})]
    assert locked[1:] == [0]


def test_asking_for_fifo_leaves_the_scheduler_as_it_was() -> None:
    fifo_allowed(1)
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


def test_the_rate_held_outlasts_the_longest_stall_expected() -> None:
    rate, worst_s = holdable_rate(1000.0, periods=5, seconds=0.05)
    assert rate == 125.0, "5 / 125 Hz is the stall of 40 ms; the next half is below SLOWEST_Hz"
    assert 5 / rate >= STALL_S
    assert rate >= SLOWEST_Hz
    assert worst_s >= 0.0


@pytest.mark.parametrize(
    ("wakes", "worst_s", "rate_Hz"),
    [
        ([(9_000_000, 0)], 0.009, 1000.0),
        ([(500_000, 49)], 0.0495, 1000.0),
        ([(500_000, 50)], 0.0505, 500.0),
        ([(900_000, 0), (500_000, 119), (0, 0)], 0.1195, 250.0),
        ([(0, 0), (120_000_000, 3)], 0.123, 250.0),
    ],
)
def test_the_rate_held_outlasts_twice_the_worst_stall_whole_periods_and_lateness_together(
    monkeypatch: pytest.MonkeyPatch, wakes: list[tuple[int, int]], worst_s: float, rate_Hz: float
) -> None:
    """100 periods last 0.1 s at 1 kHz."""
    again, waited = itertools.cycle(wakes), list[int]()

    def wait(deadlines: Deadlines) -> Wake:
        waited.append(deadlines.period_ns)
        return Wake(0, 0, *next(again))

    monkeypatch.setattr(Deadlines, "wait", wait)
    found_Hz, found_s = holdable_rate(1000.0, periods=100, seconds=0.01)
    assert waited == [1_000_000] * 10
    assert found_Hz == rate_Hz
    assert found_s == pytest.approx(worst_s)


@pytest.mark.parametrize(
    ("rate_Hz", "periods", "found_Hz"),
    [(400.0, 5, 100.0), (200.0, 8, 200.0), (200.0, 7, 100.0), (200.0, 2, 100.0), (199.0, 2, 199.0)],
)
def test_a_rate_at_the_very_border_is_held(
    monkeypatch: pytest.MonkeyPatch, rate_Hz: float, periods: int, found_Hz: float
) -> None:
    """The slowest loop is of 100 Hz, and a stall of 40 ms is outlasted in 40 ms."""
    monkeypatch.setattr(Deadlines, "wait", lambda _: Wake(0, 0, 0, 0))
    assert holdable_rate(rate_Hz, periods=periods, seconds=0.05) == (found_Hz, 0.0)


def test_how_well_a_rate_is_held_is_measured_for_a_second_and_under_real_time_for_half_of_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    waited: list[str] = []
    kinds = iter(["plain", "real time 33"])
    kind = next(kinds)

    @contextlib.contextmanager
    def real_time(priority: int, cpu: int | None) -> Iterator[None]:
        nonlocal kind
        assert (next(kinds), cpu) == (f"real time {priority}", None)
        kind = "real time"
        yield

    def wait(_: Deadlines) -> Wake:
        waited.append(kind)
        return Wake(0, 0, 0, 0)

    monkeypatch.setattr(clock, "real_time", real_time)
    monkeypatch.setattr(Deadlines, "wait", wait)
    assert holdable_rate(300.0, periods=99) == (300.0, 0.0)
    assert late_share(500.0, 33) == 0.0
    assert waited == ["plain"] * 300 + ["real time"] * 250


def test_a_loop_slow_enough_keeps_its_rate() -> None:
    assert holdable_rate(50.0, periods=5, seconds=0.1)[0] == 50.0


def test_late_wake_ups_are_those_beyond_a_tenth_of_the_period_and_those_that_skip(monkeypatch):
    wakes = itertools.cycle([(0, 0), (100_000, 0), (101_000, 0), (0, 1)])
    monkeypatch.setattr(Deadlines, "wait", lambda _: Wake(0, 0, *next(wakes)))
    assert late_share(1000.0, 1, seconds=0.4) == 0.5
    assert late_share(500.0, 1, seconds=0.4) == 0.25


class Scheduler:
    """The kernel's calls for one process: an ordinary user may not end the reset on fork."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, policy: int, priority: int, *, ordinary: bool
    ) -> None:
        self.now, self.ordinary = (policy, priority), ordinary
        monkeypatch.setattr(os, "sched_getscheduler", lambda pid: self.now[0] if pid == 0 else 99)
        monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(self.now[1] if pid == 0 else 99))
        monkeypatch.setattr(os, "sched_setscheduler", self.set)
        monkeypatch.setattr(clock, "_mlockall", lambda _: None)

    def set(self, pid: int, policy: int, parameters: os.sched_param) -> None:
        assert pid == 0, "this process"
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
def test_a_process_goes_back_to_the_policy_and_priority_that_it_had(
    monkeypatch: pytest.MonkeyPatch, policy: int, priority: int, reset: int, ordinary: bool
) -> None:
    """An ordinary user keeps the reset on fork that came with SCHED_FIFO: the policy itself is as it was."""
    scheduler = Scheduler(monkeypatch, policy | reset, priority, ordinary=ordinary)
    kept = os.SCHED_RESET_ON_FORK if ordinary else reset
    assert fifo_allowed(80)
    assert scheduler.now == (policy | kept, priority)
    scheduler.now = policy | reset, priority
    with clock.real_time_rights(80, None) as report:
        assert report.fifo
        assert scheduler.now == (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 80)
    assert scheduler.now == (policy | kept, priority)


def test_what_is_granted_and_what_is_not_is_named_each_with_its_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no(*_: object) -> None:
        raise PermissionError(errno.EPERM, "no right")

    monkeypatch.setattr(os, "open", no)
    monkeypatch.setattr(os, "sched_setaffinity", lambda *_: None)
    monkeypatch.setattr(clock, "_reschedule", lambda *_: None)
    monkeypatch.setattr(clock, "_mlockall", no)
    monkeypatch.setattr(clock, "_fifo", lambda _: None)
    with clock.real_time_rights(1, 5) as report:
        assert report.granted == ["SCHED_FIFO", "CPU 5"]
        assert report.missing == ["locked memory (no right)", "cpu_dma_latency (no right)"]
        assert report.fifo
    monkeypatch.setattr(clock, "_fifo", no)
    with clock.real_time_rights(1, 5) as report:
        assert report.granted == []
        assert report.missing[0] == "SCHED_FIFO (no right)"
        assert not report.fifo
    assert not fifo_allowed(1)


def test_the_latency_that_is_asked_of_the_kernel_is_none_and_holds_until_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said: list[tuple[object, ...]] = []

    def told(*asked: object) -> int:
        said.append(asked)
        return 99

    kernel = SimpleNamespace(
        O_WRONLY=os.O_WRONLY, open=told, write=told, close=told,
        sched_getaffinity=lambda _: {0}, sched_setaffinity=lambda *_: None,
    )  # fmt: skip
    for name in ("_fifo", "_scheduling", "_reschedule", "_mlockall"):
        monkeypatch.setattr(clock, name, lambda *_: ())
    monkeypatch.setattr(clock, "os", kernel)
    with clock.real_time_rights(1, None) as report:
        assert said == [("/dev/cpu_dma_latency", os.O_WRONLY), (99, bytes(4))]
        assert "cpu_dma_latency 0" in report.granted
    assert said[2:] == [(99,)]


def test_what_the_kernel_refuses_to_lock_is_told_with_its_reason_and_what_it_does_is_not() -> None:
    clock._mlockall(0)
    ctypes.set_errno(0)
    with pytest.raises(OSError, match="Invalid argument") as caught:
        clock._mlockall(1 << 20)
    assert caught.value.errno == errno.EINVAL


@pytest.mark.parametrize("enabled", [False, True])
def test_the_collector_is_afterwards_as_it_was(enabled: bool) -> None:
    was = gc.isenabled()
    try:
        (gc.enable if enabled else gc.disable)()
        for _ in range(2):
            with clock.collector_paused():
                assert not gc.isenabled()
            assert gc.isenabled() == enabled
    finally:
        (gc.enable if was else gc.disable)()


def test_the_peak_resident_memory_is_that_of_the_kernels_status_in_MB() -> None:
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    assert resident_MB() == pytest.approx(int(lines["VmHWM"].split()[0]) / 1024, rel=0.1)
