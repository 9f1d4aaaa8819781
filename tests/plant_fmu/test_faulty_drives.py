"""What drives with faults do by themselves and answer: they hold what they read, and hear each frame once."""

from __future__ import annotations

from math import exp, pi
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.config import DriveSettings
from drivers.errors import PlantError
from drivers.protocol import Received
from drivers.signals import DriveFault, DriveMode, DriveState, Reaction
from drivers.tick_columns import new_record
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.drive import Drives, Reading
from plant_fmu.drives.legs import LegsDrives
from plant_fmu.faults.fault import Present
from plant_fmu.faults.kinds import DriveReset, EncoderJump, FramesForgedFeedback, PlantCrash, PlantHang
from tests.drivers.legs_frames import decode, opening
from tests.plant_fmu.test_fault_kinds import accelerating
from tests.plant_fmu.test_nodes import MS, REST, Rig, starve


def test_a_drive_holds_where_it_stands_whatever_its_encoder_has_slipped_by():
    slips = [1e-3, -2e-3, 3e-3, -4e-3, 5e-3, -6e-3]
    rig = Rig(reaction=Reaction.HOLD, faults=[EncoderJump(leg=leg, by_m=by) for leg, by in enumerate(slips)])
    rig.run()
    rig.at(50 * MS)
    snapshot = rig.nodes.snapshot()
    assert snapshot.fault.tolist() == [DriveFault.WATCHDOG] * 6
    assert snapshot.brake.tolist() == [0.0] * 6
    np.testing.assert_allclose(snapshot.length, REST, rtol=0, atol=1e-9)


def test_after_a_second_hang_the_frames_of_the_first_are_not_heard_once_more():
    rig = accelerating(*[PlantHang(at_s=at_s, for_s=1e-3) for at_s in (2e-3, 5e-3)])
    before, heard = rig.nodes.snapshot(), []
    for hang_ms, ticks in ((2, (200, 201)), (5, (202, 203))):
        rig.at(hang_ms * MS)
        for k, tick in enumerate(ticks, 1):
            assert rig.at(hang_ms * MS + k * MS // 4, *opening(rig.protocol, tick)) == []
        rig.at((hang_ms + 2) * MS)
        heard.append(rig.nodes.snapshot().syncs - before.syncs)
    assert heard == [2, 4]
    assert rig.nodes.snapshot().rejected == before.rejected


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("by_m", [5e-3, -5e-3])
def test_the_forged_answer_says_that_the_leg_is_longer_by_so_much(leg, by_m):
    rig = Rig("fd", faults=[FramesForgedFeedback(leg=leg, by_m=by_m)])
    rig.configure()
    rig.tick = 1
    sent = rig.at(1 * MS, *opening(rig.protocol, rig.tick))
    answers = [Received(t, frame) for t, frame in sent if frame.id == 0x281 + leg]
    said = [decode(rig.protocol, [each], rig.tick, new_record())["length"][leg] for each in answers]
    assert said == pytest.approx([REST[leg], REST[leg] + by_m], abs=1e-6)


@pytest.mark.parametrize("force_N", [200.0, -200.0])
def test_a_force_that_lags_does_not_leap_when_the_command_does(force_N):
    w = 2 * pi * 50.0
    rig = Rig(emulation=DriveEmulation(encoder_resolution_m=0, force_bandwidth_Hz=50.0))
    rig.run(force_N)
    assert rig.nodes.snapshot().force.tolist() == [0.0] * 6
    rig.at(5 * MS)
    rig.command(5 * MS, DriveMode.RUN, -force_N)
    reached = force_N * (1.0 - exp(-w * 5e-3))
    np.testing.assert_allclose(rig.nodes.snapshot().force, reached, rtol=1e-9)


def test_a_fault_has_begun_where_the_plant_fails_with_it_and_not_where_it_failed_on_the_way_there(
    monkeypatch,
):
    crash = PlantCrash(at_s=2e-3)
    rig = accelerating(crash)
    with pytest.raises(PlantError, match="plant_crash"):
        rig.at(3 * MS)
    assert (rig.nodes.schedule.begun(rig.nodes.now_ns), rig.nodes.now_ns) == ((crash,), 2 * MS)

    def refuse(*_given: object) -> None:
        raise PlantError("refused")

    rig = accelerating(crash)
    monkeypatch.setattr(rig.plant, "step", refuse)
    with pytest.raises(PlantError, match="refused"):
        rig.at(3 * MS)
    assert rig.nodes.schedule.begun(rig.nodes.now_ns) == ()


@pytest.mark.parametrize("mode", [DriveMode.READY, DriveMode.RUN])
@pytest.mark.parametrize("reaction", [Reaction.ZERO, Reaction.DAMP, Reaction.HOLD])
def test_a_drive_that_reacts_goes_on_whatever_it_is_told_but_off_or_reset(reaction, mode):
    rig, _ = starve(reaction, seconds=0.005)
    other, _ = starve(reaction, seconds=0.005)
    for t_ms in (16, 17, 18):
        rig.command(t_ms * MS, mode, 500.0)
    rig.at(20 * MS)
    other.at(20 * MS)
    told, left = rig.nodes.snapshot(), other.nodes.snapshot()
    assert told.state.tolist() == [DriveState.FAULT] * 6
    assert told.brake.tolist() == [0.0] * 6
    assert not told.command.any()
    np.testing.assert_allclose(told.rate, left.rate, rtol=0, atol=1e-12)


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_that_starts_anew_is_not_set_up_and_its_fault_leads_back_to_boot(leg):
    rig = Rig(faults=[DriveReset(leg=leg, at_s=3e-3)])
    rig.configure()
    rig.at(4 * MS, *rig.protocol.traits.emergency_stop)
    assert rig.states == [DriveState.FAULT] * 6
    rig.command(5 * MS, DriveMode.RESET)
    assert rig.states == [DriveState.BOOT if k == leg else DriveState.OFF for k in range(6)]


def test_a_protocol_is_told_which_drives_start_anew_at_their_instant(monkeypatch):
    told: list[list[int]] = []

    monkeypatch.setattr(LegsDrives, "restart", lambda _, legs: told.append(list(legs)))
    times = {1: 3e-3, 4: 3e-3, 0: 5e-3}
    rig = Rig(faults=[DriveReset(leg=leg, at_s=at_s) for leg, at_s in times.items()])
    rig.at(2 * MS)
    assert [legs for legs in told if legs] == []
    rig.at(3 * MS)
    assert [legs for legs in told if legs] == [[1, 4]]
    rig.at(9 * MS)
    assert [legs for legs in told if legs] == [[1, 4], [0]]


def test_of_late_readings_no_more_are_kept_than_the_longest_delay_needs():
    reading, present = Reading(), Present()
    present.late_ns = [0, 2 * MS, 0, 5 * MS, 0, 0]
    for t_ms in range(100):
        length, rate = np.full(6, 1.0 * t_ms), np.full(6, 1e3)
        reading.spoil(present, t_ms * MS, length, rate)
        assert len(reading._read) == min(t_ms + 1, 6)
        expected = [t_ms - late for late in (0, 2, 0, 5, 0, 0)]
        np.testing.assert_allclose(length, np.maximum(expected, 0.0), rtol=0, atol=1e-9)


def test_late_legs_that_move_unlike_have_each_its_own_reading_carried_on_by_its_own_rate():
    reading, present = Reading(), Present()
    late_ms = [0.5, 1.5, 2.5, 0.0, 3.5, 4.5]
    present.late_ns = [round(late * MS) for late in late_ms]
    speeds = np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0])
    for t_ms in range(20):
        length, rate = speeds * t_ms, speeds * 1e3
        reading.spoil(present, t_ms * MS, length, rate)
    np.testing.assert_allclose(length, speeds * (19.0 - np.array(late_ms)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(rate, speeds * 1e3, rtol=0, atol=1e-9)


def test_a_drive_that_was_just_powered_up_has_the_configured_watchdog():
    drives = Drives(DriveSettings(watchdog_ms=7.0), DriveEmulation(), 1e-4)
    assert drives.seen.watchdog_ns.tolist() == [7 * MS] * 6


def test_a_plant_that_fails_as_a_watchdog_ends_has_come_to_that_instant(monkeypatch):
    rig = Rig()
    rig.run()

    def refuse(*_given: object) -> None:
        raise PlantError("refused")

    monkeypatch.setattr(rig.plant, "step", refuse)
    with pytest.raises(PlantError, match="refused"):
        rig.at(30 * MS)
    assert rig.nodes.now_ns == 10 * MS


def test_readings_are_kept_while_any_one_encoder_is_late_and_forgotten_when_none_is():
    reading, present, works = Reading(), Present(), Present()
    present.late_ns[4] = 3 * MS
    for t_ms in range(3):
        reading.spoil(present, t_ms * MS, np.ones(6), np.zeros(6))
        reading.begin(present)
        assert len(reading._read) == t_ms + 1
    reading.begin(works)
    assert len(reading._read) == 0


def test_noise_is_added_to_the_lengths_of_its_legs_as_it_is_drawn():
    present = Present()
    drawn: Any = SimpleNamespace(standard_normal=lambda: 2.0)
    present.noise = [(1, 1e-3, drawn), (4, 3e-3, drawn), (1, 1e-2, drawn)]
    length, rate = np.ones(6), np.zeros(6)
    Reading().spoil(present, 0, length, rate)
    np.testing.assert_allclose(length, [1.0, 1.022, 1.0, 1.0, 1.006, 1.0], rtol=1e-15)
    assert not rate.any()


def test_a_watchdog_that_ends_with_a_step_strikes_in_the_next_however_short_that_is():
    rig = Rig()
    rig.run()
    rig.at(10 * MS)
    assert rig.states == [DriveState.RUN] * 6
    sent = rig.at(10 * MS + 1)
    assert rig.states == [DriveState.FAULT] * 6
    assert [(t, frame.data[0]) for t, frame in sent] == [(10 * MS, DriveState.FAULT)] * 6
