"""Legs that rest while a force holds them may move on, and their rest is none after a fault."""

from __future__ import annotations

import pytest

from drivers.signals import Fault, Mode
from tests.hil.test_safety import RATE_HZ, Bench

HELD_BY_FORCE = (
    *(Mode.WAITING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.HELD),
)
SETTLED = round(0.2 * RATE_HZ)
"""Ticks after which legs at rest have to stand still after a fault."""


def rested(mode: Mode) -> Bench:
    """A bench that has rested for long in a mode."""
    bench = Bench()
    for _ in range(3 * SETTLED):
        assert bench.tick(mode).faults == Fault.NONE
    return bench


@pytest.mark.parametrize("mode", HELD_BY_FORCE)
def test_legs_that_rested_for_long_may_move_on_where_no_brake_is_to_hold_them(mode):
    bench = rested(mode)
    assert bench.tick(mode, length=6.0, q=6.0, q_d=6.0).faults == Fault.NONE
    assert not bench.record["legs_moved"]


@pytest.mark.parametrize("mode", HELD_BY_FORCE)
def test_after_a_fault_legs_have_to_rest_anew_before_they_must_stand(mode):
    bench = rested(mode)
    for k in range(SETTLED + 1):
        assert bench.tick(Mode.FAULT, length=5.0 + 0.2 * k).faults == Fault.NONE
    assert bench.tick(Mode.FAULT, length=7.0).faults == Fault.BRAKE
