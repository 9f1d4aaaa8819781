"""How much of a running log a power failure may cost: it goes onto the disk once a second."""

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
