"""A brake has its closing time before the next one may open, and a drive that leaves RUN ends its step."""

from types import SimpleNamespace

import numpy as np
import pytest

from drivers.signals import DriveState
from drivers.tick_columns import new_record
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.lab.bringup.context import Context, StoppedError
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.lab.bringup.kit import Rehearsal

SLOW = {
    "engage": {"brake_release_s": 0.03, "brake_close_s": 0.16},
    "plant": {"drives": {"brake_open_ms": 25, "brake_close_ms": 150}},
}
"""Brakes that close more slowly than they open: longer than a drive needs to be powered."""


@pytest.mark.parametrize("name", ["virtual", "desktop"])
def test_a_slow_brake_is_shut_before_the_next_one_opens(name):
    """One command for all drives, and one for each: every leg, its neighbour, and the first leg again."""
    rehearsal = Rehearsal(loads(with_changes(load(name).text, SLOW), name), Wiring())
    rehearsal.drives.prepare(None)
    for leg in (0, 1, 2, 3, 4, 5, 0):
        with rehearsal.context.opened(leg):
            assert rehearsal.bench.nodes.snapshot().brake[leg] == 0.0
        assert rehearsal.bench.nodes.snapshot().brake.tolist() == [1.0] * 6
    assert rehearsal.watched.most_open == 1


def powered(states):
    """Return what steps share, with drives that report some states whatever they are commanded."""
    record = new_record()
    record["age"], record["drive_state"] = 0, states
    protocol = SimpleNamespace(fault_text=lambda _code: "")
    drives = SimpleNamespace(record=record, protocol=protocol, step=lambda *_: record)
    return Context(None, drives, None)  # type: ignore[arg-type]


@pytest.mark.parametrize("state", [s for s in DriveState if s is not DriveState.RUN])
def test_a_drive_that_has_left_run_by_itself_is_pushed_no_further(state):
    for leg in range(6):
        states = np.full(6, int(DriveState.RUN))
        states[leg] = state
        context = powered(states)
        with pytest.raises(StoppedError, match=f"gone from RUN to {state.name}") as stop:
            context.drive(leg, 10.0)
        assert (stop.value.finding.name, stop.value.finding.legs) == ("lost_power", (leg,))


def test_a_drive_that_runs_goes_on_whatever_the_locked_ones_report():
    for leg in range(6):
        states = np.full(6, int(DriveState.FAULT))
        states[leg] = DriveState.RUN
        powered(states).drive(leg, 10.0)
