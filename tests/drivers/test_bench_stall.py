"""Bench time that stands still for one participant: how long the others look on before they go on without it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.can.localcan import bench_clock
from drivers.can.localcan.bench_clock import BenchClock
from drivers.can.localcan.layout import SLOT, SLOT_SERIAL, SLOTS, SLOTS_AT

MS = 1_000_000
OWN, OTHER = SLOTS + 3, SLOTS + 7
"""Serial numbers of who looks on, and of who does not come back."""


class Bell:
    """A wire with doorbells, of which the other one's may have gone with its process."""

    alive = True

    def __init__(self, words: Any) -> None:
        self.words, self.rung = words, list[int]()

    def ring(self, serial: int) -> bool:
        self.rung.append(serial)
        return self.alive


class Watched:
    """A clock whose time stands still for the other one, at real times that are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        words = np.zeros(SLOTS_AT + SLOTS * SLOT, np.int64)
        words[SLOTS_AT + OTHER % SLOTS * SLOT + SLOT_SERIAL] = OTHER
        self.bell = Bell(words)
        made: Any = BenchClock(self.bell, OWN)  # type: ignore[arg-type]
        self.clock, self.real_ns, self.stood_ns, self.dismissed = made, 0, 70 * MS, 0
        made.now = self._now
        monkeypatch.setattr(bench_clock, "dismiss", self._dismiss)

    def _now(self) -> int:
        state = self.clock._state
        state[bench_clock._FREE], state[bench_clock._BEHIND] = self.real_ns, 1
        state[bench_clock._OVERDUE] = OTHER % SLOTS
        return self.stood_ns

    def _dismiss(self, *_arguments: Any) -> None:
        self.dismissed += 1

    def looks(self, times: int, every_ns: int) -> int:
        """Look so many times; return at which of them the other one was dismissed first, 0: at none."""
        self.dismissed = 0
        for k in range(times):
            self.real_ns += every_ns
            assert self.clock.stands()
            if self.dismissed:
                return k + 1
        return 0


@pytest.fixture
def watched(monkeypatch):
    return Watched(monkeypatch)


@pytest.mark.parametrize("stall_ms", [3, 250, 251, 10_000])
def test_while_the_whole_machine_stands_still_nobody_is_late(watched, stall_ms):
    assert watched.looks(1, MS) == 0
    assert watched.looks(100, stall_ms * MS) == 0
    assert set(watched.bell.rung) == {OTHER}


def test_who_does_not_come_back_while_others_run_is_dismissed_after_250_ms(watched):
    assert watched.looks(300, MS) == 252, "the first look begins it"
    assert set(watched.bell.rung) == {OTHER}


def test_a_stall_in_between_counts_as_one_look(watched):
    assert watched.looks(101, MS) == 0
    assert watched.looks(1, 10_000 * MS) == 0
    assert watched.looks(300, MS) == 149, "100 ms, 2 ms and 149 ms"


def test_each_time_that_stands_is_waited_for_anew(watched):
    for _ in range(3):
        assert watched.looks(240, MS) == 0
        watched.stood_ns += MS


def test_one_whose_process_is_gone_is_dismissed_at_the_first_ring(watched):
    watched.bell.alive = False
    assert watched.looks(300, MS) == 1
    assert watched.bell.rung == [OTHER]
