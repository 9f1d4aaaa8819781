"""The desktop hexapod with each commercial drive family, in lockstep, compared with the project's own
protocol.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.frame_array import received_frames
from drivers.signals import DriveState, Mode
from hil.app.configuration.configuration import Configuration
from hil.app.sim.lockstep import Lockstep
from hil.signals import TickInput
from plant_fmu.drives.drive import Snapshot
from plant_fmu.faults.kinds import BusOff
from tests.broad import broad
from tests.loop.bench import Ran, changed, run
from tools.drive_families import FAMILIES, Changes, merged

OTHERS = sorted(
    (name for name in FAMILIES if not name.startswith(("legs", "cia402"))), key=lambda name: name != "moteus"
)
"""Commercial families; the first one runs every day."""
WITHOUT_WATCHDOG = ("mit, cubemars AK80-9", "mit, mini_cheetah", "mit, robstride rs-02")


def desktop(family: str = "mit, damiao DM4310", **sections: Changes) -> Configuration:
    return changed("desktop", **merged(FAMILIES[family], sections))


@cache
def ran(family: str) -> Ran:
    return run(desktop(family), stop_s=4.0)


@pytest.mark.parametrize("family", broad(OTHERS, quick=1))
def test_each_commercial_drive_family_tracks_as_well_as_the_protocol_legs(family):
    found = ran(family)
    assert found.ending.success, found.ending
    assert found.summary["rejected_frames"] == 0
    assert found.rows["age"][10:].max() <= 1
    assert found.rows["doubled"].max() == found.rows["foreign"].max() == 0
    assert set(found.rows["drive_state"][-1].tolist()) <= {DriveState.OFF, DriveState.READY}
    ours, theirs = (ran(name).summary["tracking"]["rms_leg_error_mm"] for name in ("legs, classic", family))
    assert theirs == pytest.approx(ours, rel=0.1)


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("mit, damiao DM4310", {"loop": {"rate_Hz": 500}}, "12 x classic  8 byte: 135 bit = 135.0 us each"),
    ("moteus", {"loop": {"rate_Hz": 1000}}, "6 x CAN FD  48 byte: 57 bit + 519 fast bit = 160.8 us"),
    (
        "mit, damiao DM4310",
        {"reactions": {"silence": "damp"}},
        "reactions.silence: no reaction of these drives",
    ),
    # 12.5 rad x 5 mm = 62.5 mm on each side of 325 mm
    ("mit, damiao DM4310", {"drives": {"transmission": {"pulley_radius_m": 0.005}}}, "0.2625 and 0.3875 m"),
]


@pytest.mark.parametrize(("family", "sections", "said"), REFUSED)
def test_settings_beyond_the_range_of_the_drives_or_their_bus_are_refused(family, sections, said):
    with pytest.raises(ConfigurationError) as caught:
        desktop(family, **sections)
    assert said in str(caught.value)


@pytest.mark.parametrize("family", broad((*WITHOUT_WATCHDOG, "mit, damiao DM4310"), quick=1))
def test_drives_without_watchdog_are_not_reported_as_stopped_on_a_dead_bus(family):
    """The plant shows it: a leg with a closed brake stands, a leg with its last torque does not."""
    found = run(desktop(family), BusOff(mode="TRACKING", at_s=0.6), stop_s=5.0)
    assert found.ending.mode is Mode.FAULT
    stopped = np.abs(found.true[-1] - found.true[-5]).max() < 1e-9
    promised = "the watchdog of each acts" in found.ending.trouble
    assert (stopped, promised) == ((family not in WITHOUT_WATCHDOG),) * 2
    assert ("cut their power now" in found.ending.trouble) is not promised


# -- ODrives, whose heartbeats report late that they are enabled ---------------------------------------------


ESTIMATES = 0x09
RELEASED_TICKS = 40
"""Duration after the release of the brakes: more than a heartbeat of 0.1 s, at 312.5 Hz."""


class Started(NamedTuple):
    rows: Any
    axes: list[Snapshot]
    """The drives and the plant at the end of each tick."""
    released: int
    """Row in which the brakes are commanded to open."""
    estimates: Any
    """Numbers of estimates received in each tick, and of those among them that came after its start."""


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


def test_odrive_brakes_open_under_the_holding_force_and_no_leg_sinks(started):
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


def test_start_waits_for_the_heartbeat_of_the_last_odrive_axis_and_continues_without_a_fault(started):
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


def test_odrive_brakes_count_as_closed_only_after_each_axis_has_reported_it(started):
    rows = started.rows
    parking, unloading = (int(np.argmax(rows["mode"] == mode)) for mode in (Mode.PARKING, Mode.UNLOADING))
    assert (rows["drive_state"][parking + 1] == DriveState.RUN).any(), "a heartbeat as quick as a change"
    assert (rows["drive_state"][unloading] == DriveState.READY).all()
    assert started.axes[unloading].brake.all()
    assert rows["mode"][-1] == Mode.PARKED
