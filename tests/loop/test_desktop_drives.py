"""The desktop hexapod with each family of drives that can be bought, in lockstep, beside our own protocol."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.signals import DriveState, Mode
from hil.app.configuration.configuration import Configuration
from hil.loop.report import waiting_text
from plant_fmu.faults.kinds import BusOff, EncoderJump, FramesLoss
from tests.broad import broad
from tests.loop.bench import Ran, changed, new_cycle, run
from tools.drive_families import FAMILIES, Changes, merged

OTHERS = sorted((name for name in FAMILIES if not name.startswith("legs")), key=lambda name: name != "moteus")
"""Families that can be bought; the first one runs every day."""
WITHOUT_WATCHDOG = ("mit, cubemars AK80-9", "mit, mini_cheetah", "mit, robstride rs-02")


def desktop(family: str = "mit, damiao DM4310", **sections: Changes) -> Configuration:
    return changed("desktop", **merged(FAMILIES[family], sections))


@cache
def ran(family: str) -> Ran:
    return run(desktop(family), stop_s=4.0)


@pytest.mark.parametrize("family", broad(OTHERS, quick=1))
def test_a_family_errs_as_our_own_protocol_does_because_friction_decides(family):
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
    ("mit, damiao DM4310", {"reactions": {"silence": "damp"}}, "reactions.silence: not what these drives do"),
    # 12.5 rad x 5 mm = 62.5 mm on each side of 325 mm
    ("mit, damiao DM4310", {"drives": {"transmission": {"pulley_radius_m": 0.005}}}, "0.2625 and 0.3875 m"),
]


@pytest.mark.parametrize(("family", "sections", "said"), REFUSED)
def test_what_the_drives_or_their_bus_cannot_do_is_refused(family, sections, said):
    with pytest.raises(ConfigurationError) as caught:
        desktop(family, **sections)
    assert said in str(caught.value)


def test_a_fault_code_is_told_with_its_leg_and_what_the_maker_means_by_it():
    cycle = new_cycle(desktop())
    cycle.tick["drive_state"], cycle.tick["age"] = DriveState.OFF, 0
    cycle.tick["drive_state"][4], cycle.tick["drive_fault"][4] = DriveState.FAULT, 0x100 + 8
    assert "drive 4 stays in FAULT (264: over voltage)" in waiting_text(cycle)


@pytest.mark.parametrize("family", broad((*WITHOUT_WATCHDOG, "mit, damiao DM4310"), quick=1))
def test_drives_without_a_watchdog_are_not_said_to_have_stopped_on_a_dead_bus(family):
    """The plant decides: a leg whose brake has closed stands, one that has kept its torque does not."""
    found = run(desktop(family), BusOff(mode="TRACKING", at_s=0.6), stop_s=5.0)
    assert found.ending.mode is Mode.FAULT
    stopped = np.abs(found.true[-1] - found.true[-5]).max() < 1e-9
    promised = "the watchdog of each acts" in found.ending.trouble
    assert (stopped, promised) == ((family not in WITHOUT_WATCHDOG),) * 2
    assert ("cut their power now" in found.ending.trouble) is not promised


@pytest.mark.long
def test_a_jump_is_found_beside_a_drive_that_is_heard_four_times_in_five():
    """0.2 mm in motion, 0.09 mm are allowed; a way of one period, 0.3 mm, is allowed to the lossy leg alone."""
    lossy = FramesLoss(identifier=22, probability=0.2, at_s=3.5)
    found = run(desktop(), lossy, EncoderJump(leg=0, at_s=4.13, by_m=2e-4), stop_s=4.2)
    assert "the length of leg 0 changed by" in found.ending.trouble
