"""When the faults that wait for a mode, or for the platform to rest, are told that it is there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.sim.lockstep import Lockstep

RATE_HZ = 50.0
REST = 5
"""Ticks of a tenth of a second."""


def told(steps: list[tuple[Mode, float]]) -> list[tuple[int, str]]:
    """Return in which tick what is reached, of a mode and the rate of leg 4's reference in each tick."""
    lockstep = object.__new__(Lockstep)
    lockstep._mode, lockstep._rests = Mode.WAITING, 0
    found: list[tuple[int, str]] = []
    for tick, (mode, rate) in enumerate(steps):
        dq_d = np.zeros(6)
        dq_d[4] = rate
        cycle: Any = SimpleNamespace(mode=mode, tick={"dq_d": dq_d}, parts=SimpleNamespace(rate_Hz=RATE_HZ))
        nodes: Any = SimpleNamespace(reached=lambda name, tick=tick: found.append((tick, name)))
        lockstep.cycle, lockstep.nodes = cycle, nodes
        lockstep._report_mode()
    return found


def test_a_mode_is_reached_in_its_first_tick_and_again_when_it_comes_back() -> None:
    modes = [Mode.WAITING, Mode.IDLE, Mode.IDLE, Mode.FAULT, Mode.IDLE]
    assert told([(mode, 0.0) for mode in modes]) == [(1, "IDLE"), (3, "FAULT"), (4, "IDLE")]


@pytest.mark.parametrize("moves", range(REST + 1))
def test_a_reference_rests_when_it_has_stood_still_for_a_tenth_of_a_second_without_a_break(
    moves: int,
) -> None:
    steps = [(Mode.TRACKING, -1e-9 if tick == moves else 0.0) for tick in range(2 * REST)]
    still = moves + REST if moves < REST else REST - 1
    assert told(steps) == [(0, "TRACKING"), (still, "HOLD")]


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.STOPPING, Mode.PARKING, Mode.HELD])
def test_legs_that_stand_still_in_another_mode_are_at_no_rest_of_the_reference(mode: Mode) -> None:
    assert told([(mode, 0.0)] * 3 * REST) == [(0, mode.name)]
    steps = [(Mode.TRACKING, 0.0)] * (REST - 1) + [(mode, 0.0)] + [(Mode.TRACKING, 0.0)] * (REST - 1)
    assert "HOLD" not in [name for _, name in told(steps)]


def test_a_rest_is_told_once_and_again_after_the_reference_has_moved() -> None:
    steps = [(Mode.TRACKING, 0.0)] * 3 * REST + [(Mode.TRACKING, 0.1)] + [(Mode.TRACKING, 0.0)] * REST
    assert told(steps) == [(0, "TRACKING"), (REST - 1, "HOLD"), (4 * REST, "HOLD")]
