"""How a virtual bench whose time may stand still shares the feedback window, and what is said of its stretches."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.app.run.stretching import begin, stood_still_line, stretches

MS = 1_000_000


@pytest.fixture(scope="module")
def ends() -> Any:
    """Return a configuration, its protocol, and the frames that start a tick."""
    c = load("virtual")
    cycle = build_cycle(c, 1000.0, 0.01)
    return c, cycle.parts.protocol, cycle.begin(0)


def shares(ends: Any, window_ns: int) -> tuple[int, int]:
    """Return for how long each may wake up and work, of such a window."""
    told: list[tuple[int, int]] = []
    clock: Any = SimpleNamespace(begin=lambda wake_ns, work_ns: told.append((wake_ns, work_ns)), holds=False)
    c, protocol, opening = ends
    begin(clock, c, protocol, opening, window_ns)
    assert clock.holds
    (found,) = told
    return found


@pytest.mark.parametrize(
    ("stood_ns", "times", "longest_ms", "harmful"),
    [
        ([0, 999_999, 0], 0, 1.0, 0),
        ([MS, 0, 3_999_999], 2, 4.0, 0),
        ([0, 4 * MS, 2 * MS], 2, 4.0, 1),
        ([5 * MS, 4 * MS, 3 * MS, 2500 * MS], 4, 2500.0, 3),
        ([], 0, 0.0, 0),
    ],
)
def test_stretches_from_a_millisecond_on_are_counted_and_from_four_on_a_real_drive_had_ended_the_run(
    stood_ns: list[int], times: int, longest_ms: float, harmful: int
) -> None:
    found = stretches(np.array(stood_ns, np.int64))
    assert (found["stretches"], found["longest_ms"]) == (times, longest_ms)
    assert found["stood_still_ms"] == pytest.approx(sum(stood_ns) / MS, abs=0.05)
    note = f"with real drives this machine would have ended the run: {harmful} of them are 4 ms or more"
    assert found["note"] == (note if harmful else None)
    line = stood_still_line(found)
    assert line.startswith(f"bench time stood still {times} times, {longest_ms:g} ms at most") == bool(times)
