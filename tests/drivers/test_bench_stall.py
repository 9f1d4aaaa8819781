"""Standstill of bench time for a late participant: when the others continue without it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.can.localcan import bench_clock
from drivers.can.localcan.bench_clock import BenchClock
from drivers.can.localcan.layout import SLOT, SLOT_SERIAL, SLOTS, SLOTS_AT

MS = 1_000_000
OWN, OTHER = SLOTS + 3, SLOTS + 7
"""Serial numbers of the participant that reads the clock, and of the late one."""


@pytest.fixture
def looks(monkeypatch):
    """Function that reads the halted clock; it gives the number of the reading that dismissed, 0: none."""
    words = np.zeros(SLOTS_AT + SLOTS * SLOT, np.int64)
    words[SLOTS_AT + OTHER % SLOTS * SLOT + SLOT_SERIAL] = OTHER
    wire: Any = SimpleNamespace(words=words, ring=lambda serial: serial == OTHER)
    clock, real_ns, dismissed = BenchClock(wire, OWN), [0], list[int]()

    def now() -> int:
        clock._state[bench_clock._FREE], clock._state[bench_clock._BEHIND] = real_ns[0], 1
        clock._state[bench_clock._OVERDUE] = OTHER % SLOTS
        return 70 * MS

    def look(times: int, every_ns: int) -> int:
        for k in range(times):
            real_ns[0] += every_ns
            assert clock.stands()
            if dismissed:
                return k + 1
        return 0

    monkeypatch.setattr(clock, "now", now)
    monkeypatch.setattr(bench_clock, "dismiss", lambda *_: dismissed.append(1))
    return look


@pytest.mark.parametrize("stall_ms", [3, 250, 251, 10_000])
def test_simulated_time_still_waits_for_a_late_participant_after_the_whole_machine_stalled(looks, stall_ms):
    assert looks(1, MS) == 0
    assert looks(100, stall_ms * MS) == 0


def test_simulated_time_stops_waiting_for_a_participant_250_ms_late_while_others_run(looks):
    assert looks(101, MS) == 0
    assert looks(1, 10_000 * MS) == 0, "a stall counts as one reading"
    assert looks(300, MS) == 149, "100 ms, 2 ms and 149 ms"
