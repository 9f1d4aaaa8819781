"""When a recorder that runs does what: shows the newest row, writes a chunk, puts the log onto the disk."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.record import recorder as module
from hil.record.recorder import Recorder

LASTS_S = 20.0


@pytest.fixture
def synced(monkeypatch):
    """A function that lets a recorder run for a while on a clock of its own; it returns when it synced."""

    def ran(*, lockstep):
        found: list[float] = []
        clock: Any = SimpleNamespace(now=100.0, monotonic=lambda: clock.now)
        recorder: Any = Recorder.__new__(Recorder)
        recorder._publisher = recorder._live = None
        recorder._lockstep, recorder.batch = lockstep, 16
        recorder._ring = SimpleNamespace(ready=lambda limit: False, capacity=256)
        recorder._drain = lambda limit: False
        recorder.file = SimpleNamespace(sync=lambda: found.append(clock.now), position=0)

        def ended(timeout_s: float) -> bool:
            clock.now += max(timeout_s, 0.02)
            return bool(clock.now > 100.0 + LASTS_S)

        monkeypatch.setattr(module, "time", clock)
        recorder.run(SimpleNamespace(ended=ended))
        return found

    return ran


def test_a_log_in_real_time_is_put_onto_the_disk_once_a_second(synced):
    times = synced(lockstep=False)
    apart = np.diff([100.0, *times, 100.0 + LASTS_S])
    assert apart.max() < 1.3
    assert np.median(apart) > 0.9, "and no more often: the disk has other work"


def test_a_simulation_waits_for_no_disk(synced):
    assert synced(lockstep=True) == []


class Day:
    """A recorder on a clock of its own, on which nothing takes time but waiting and what is said to.

    `did` has what it did and when, in s from the start; `ready` says whether there is a batch.
    """

    def __init__(
        self, monkeypatch, *, lockstep=False, ready=lambda limit, now: False, takes_s=lambda now: 0.0
    ):
        self.did: dict[str, list[float]] = {"show": [], "drain": [], "wait": []}
        self.limits: set[int] = set()
        self.clock: Any = SimpleNamespace(now=100.0, monotonic=lambda: self.clock.now)
        monkeypatch.setattr(module, "time", self.clock)
        recorder: Any = Recorder.__new__(Recorder)
        recorder._live = None
        recorder._publisher = SimpleNamespace(publish=self.show, close=lambda: None)
        recorder._lockstep, recorder.batch, recorder._drain = lockstep, 16, self.drain
        recorder._ring = SimpleNamespace(ready=lambda limit: ready(limit, self.now), capacity=256)
        recorder.file = SimpleNamespace(sync=lambda: None, position=0)
        self.recorder, self.takes_s = recorder, takes_s

    @property
    def now(self):
        return float(self.clock.now) - 100.0

    def show(self, position):
        self.did["show"].append(self.now)
        self.clock.now += self.takes_s(self.now)

    def drain(self, limit):
        self.did["drain"].append(self.now)
        self.limits.add(limit)
        return False

    def run(self, lasts_s):
        def ended(timeout_s: float) -> bool:
            self.did["wait"].append(timeout_s)
            self.clock.now += max(timeout_s, 1e-6)  # what it looks for is there at once, or never
            return bool(self.now > lasts_s)

        self.recorder.run(SimpleNamespace(ended=ended))
        return {name: np.array(times) for name, times in self.did.items()}


@pytest.mark.parametrize("takes_s", [0.0, 0.005, 0.019])
def test_the_newest_row_is_shown_fifty_times_a_second_whatever_that_takes(monkeypatch, takes_s):
    did = Day(monkeypatch, takes_s=lambda now: takes_s).run(2.0)
    np.testing.assert_allclose(np.diff(did["show"]), 0.02, atol=1e-5)
    assert len(did["show"]) in (100, 101)


def test_after_a_look_that_took_a_second_none_is_made_up_for(monkeypatch):
    day = Day(monkeypatch, takes_s=lambda now: 1.0 if 0.49 < now < 0.51 else 0.001)
    shown = day.run(3.0)["show"]
    assert np.diff(shown).max() == pytest.approx(1.0, abs=0.01)
    behind = shown[shown > 1.0]
    assert np.count_nonzero(behind < behind[0] + 0.019) <= 2
    np.testing.assert_allclose(np.diff(behind)[2:], 0.02, atol=1e-5)


def test_in_real_time_there_is_a_chunk_every_tenth_of_a_second(monkeypatch):
    """A look that comes a little early counts: the next one would come too late."""
    day = Day(monkeypatch)
    drained = day.run(2.0)["drain"]
    assert day.limits == {2048}, "ticks in one go at most"
    np.testing.assert_allclose(np.diff(drained)[:-1], 0.1, atol=1e-3)
    assert len(drained) >= 20


def test_a_look_counts_that_comes_half_the_time_between_two_looks_too_early_and_none_before(monkeypatch):
    day = Day(monkeypatch)
    day.clock.now = 0.0
    early = 0.1 - 0.02 / 2
    looks = iter([0.05, early - 0.0005, early, 0.1, 2 * early - 0.0005, 2 * early + 0.0005, 0.2])

    def ended(timeout_s: float) -> bool:
        day.clock.now = next(looks, 0.21)
        return bool(day.clock.now == 0.21)

    day.recorder.run(SimpleNamespace(ended=ended))
    np.testing.assert_allclose(np.array(day.did["drain"]) + 100.0, [early, 2 * early + 0.0005, 0.21])


def test_the_log_is_put_onto_the_disk_at_the_first_look_that_comes_a_second_after_the_last_time(monkeypatch):
    day = Day(monkeypatch)
    day.clock.now = 0.0
    synced: list[float] = []
    day.recorder.file.sync = lambda: synced.append(day.clock.now)
    looks = iter([0.5, 0.9, 1.0, 1.5, 1.9, 2.25, 3.125, 3.25])

    def ended(timeout_s: float) -> bool:
        day.clock.now = next(looks, 9.0)
        return bool(day.clock.now == 9.0)

    day.recorder.run(SimpleNamespace(ended=ended))
    assert synced == [1.0, 2.25, 3.25]


def test_in_real_time_there_is_a_chunk_at_once_when_a_quarter_of_the_ring_is_full(monkeypatch):
    day = Day(monkeypatch, ready=lambda limit, now: limit == 64 and 0.13 < now < 0.15)
    drained = day.run(0.5)["drain"]
    np.testing.assert_allclose(drained[:4], [0.1, 0.14, 0.24, 0.34], atol=1e-3)


def test_a_simulation_looks_every_4_ms_and_writes_whole_batches_until_there_is_none(monkeypatch):
    left = [3]

    def ready(limit, now):
        left[0] -= 1
        return limit == 16 and left[0] >= 0

    day = Day(monkeypatch, lockstep=True, ready=ready)
    did = day.run(0.1)
    assert set(did["wait"]) == {0.004}
    np.testing.assert_allclose(did["drain"], [0.004] * 3 + [0.102], atol=3e-3, err_msg="the rest at the end")
    assert day.limits == {16}


@pytest.mark.parametrize("lockstep", [True, False])
@pytest.mark.parametrize("batches", [0, 1, 5])
def test_a_producer_that_has_ended_finds_its_ring_drained_batch_after_batch_to_the_last(
    monkeypatch, lockstep, batches
):
    day = Day(monkeypatch, lockstep=lockstep)
    left = [True] * batches + [False]
    day.recorder._drain = lambda limit: left.pop(0)
    day.recorder.run(SimpleNamespace(ended=lambda timeout_s: True))
    assert left == []
