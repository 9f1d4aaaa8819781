"""A start with ODrives, whose heartbeats tell late that they are enabled: no leg is without force on an open brake."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.frame_array import received_frames
from drivers.signals import DriveState, Mode
from hil.app.sim.lockstep import Lockstep
from hil.signals import TickInput
from plant_fmu.drives.drive import Snapshot
from tests.loop.bench import run
from tests.loop.test_desktop_drives import desktop

ESTIMATES = 0x09
RELEASED_TICKS = 40
"""From the release of the brakes on: more than a heartbeat of 0.1 s at 312.5 Hz."""


class Started(NamedTuple):
    rows: Any
    axes: list[Snapshot]
    """The drives and the plant at the end of each tick."""
    released: int
    """Row in which the brakes are told to open."""
    estimates: Any
    """How many each tick has heard, and how many of them since it began."""


@pytest.fixture(scope="module")
def started() -> Started:
    axes: list[Snapshot] = []
    estimates: list[tuple[int, int]] = []

    def watch(lockstep: Lockstep, given: TickInput, _row: Any) -> None:
        own = [t_ns for t_ns, frame in received_frames(given.frames) if frame.id & 0x1F == ESTIMATES]
        estimates.append((len(own), sum(t_ns >= given.t_ns for t_ns in own)))
        axes.append(lockstep.nodes.snapshot())

    ran = run(desktop("odrive"), stop_s=1.0, watch=watch)
    return Started(ran.rows, axes, ran.first(Mode.RELEASING), np.array(estimates))


def test_the_drives_hear_each_command_once(started):
    heard = np.diff([each.commands for each in started.axes])
    assert set(heard[started.rows["mode"][1:] == Mode.APPROACH].tolist()) == {6}


def test_the_brakes_open_with_the_holding_force_on_and_no_leg_sinks(started):
    k = started.released
    opening = started.axes[k + 1 : k + RELEASED_TICKS]
    enabled = [np.array(each.state) == DriveState.RUN for each in opening]
    assert all(each.all() for each in enabled)
    held = started.rows["tau"][k : k + RELEASED_TICKS - 1]
    assert np.abs(held).min() > 1.0, "each leg carries its share of the platform"
    for each, tau in zip(opening, held, strict=True):
        np.testing.assert_allclose(each.command, tau, rtol=0.1, atol=1.0)
    lengths = np.array([each.length for each in started.axes[k:]])
    released = lengths[:RELEASED_TICKS]
    assert np.abs(released - released[0]).max() < 1e-5


def test_the_start_goes_on_once_the_last_heartbeat_has_told_and_the_run_meets_no_limit(started):
    rows, k = started.rows, started.released
    approach = int(np.argmax(rows["mode"] == Mode.APPROACH))
    told = rows["drive_state"][k:approach] == DriveState.RUN
    assert not told[1].any(), "a heartbeat has been as quick as a change"
    assert 0 < told[len(told) // 2].sum() < 6
    moving = np.isin(rows["mode"], [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING])
    assert (rows["drive_state"][moving] == DriveState.RUN).all()
    assert not rows["faults"].any()
    assert rows["rejected"].max() == 0
    assert rows["age"][k:].max() <= 1
    error = np.abs(rows["q"][k:] - rows["q_d"][k:]).max()
    assert error < 0.5 * desktop("odrive").limits.following_error_m


def test_the_brakes_are_not_believed_shut_before_each_axis_has_told_it(started):
    rows = started.rows
    parking, unloading = (int(np.argmax(rows["mode"] == mode)) for mode in (Mode.PARKING, Mode.UNLOADING))
    assert (rows["drive_state"][parking + 1] == DriveState.RUN).any(), "a heartbeat as quick as a change"
    assert (rows["drive_state"][unloading] == DriveState.READY).all()
    assert started.axes[unloading].brake.all()
    assert rows["mode"][-1] == Mode.PARKED
