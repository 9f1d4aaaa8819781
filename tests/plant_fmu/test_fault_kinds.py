"""Faults of drives, brakes, frames, buses and plant, with free masses in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.config import DriveSettings
from drivers.errors import PlantError
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Received
from drivers.signals import Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import new_record
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults import kinds
from plant_fmu.faults.plan import FaultPlan
from tests.drivers.legs_frames import command_frames, decode, opening
from tests.plant_fmu.rig import MASS, MS, REST, Rig, accelerating, motion, push
from tests.plant_fmu.test_sensor_nodes import Mover, rotation

# drives and brakes


@pytest.mark.parametrize(
    ("fault", "share"),
    [
        (kinds.DriveGain(leg=4, factor=0.5), 0.5),
        (kinds.DriveSign(leg=4), -1.0),
        (kinds.DriveSaturation(leg=4, limit_N=0.25 * 10 * MASS), 0.25),
        (kinds.DriveSaturation(leg=4, limit_N=11 * MASS), 1.0),
    ],
)
def test_fault_of_the_force_of_a_drive_changes_the_motion_of_its_leg_alone(fault, share):
    rig = accelerating(fault)
    rig.at(5 * MS)
    rates = rig.nodes.snapshot().rate
    assert rates[4] == pytest.approx(share * 10 * 5e-3)
    assert rates[3] == pytest.approx(10 * 5e-3)


def test_drive_restart_fault_closes_the_brake_and_requires_a_new_set_up():
    rig = accelerating(kinds.DriveReset(leg=4, at_s=3e-3))
    rig.at(3 * MS)
    assert rig.states == [DriveState.RUN] * 4 + [DriveState.BOOT, DriveState.RUN]
    assert rig.brakes == [0, 0, 0, 0, 1, 0]
    rig.command(4 * MS, DriveMode.READY)
    assert rig.states[4] == DriveState.BOOT, "the restarted drive does not obey"
    rig.at(5 * MS, *rig.protocol.configure(0.01, rig.reaction))
    assert rig.states[4] == DriveState.OFF
    rig.command(6 * MS, DriveMode.READY)
    assert rig.states[4] == DriveState.READY


BRAKES = DriveEmulation(encoder_resolution_m=0.0, brake_open_ms=4.0, brake_close_ms=2.0)


def test_slow_brake_fault_delays_opening_and_closing_by_the_given_time():
    rig = Rig(emulation=BRAKES, faults=[kinds.BrakeSlow(leg=1, by_ms=3.0)])
    rig.run()
    seen = []
    for t_ms in range(1, 20):
        if t_ms == 10:
            rig.command(10 * MS, DriveMode.OFF)
        else:
            rig.at(t_ms * MS)
        seen.append((t_ms, *rig.brakes[:2]))
    opened = [next(t for t, *brake in seen if brake[leg] == 0.0) for leg in (0, 1)]
    closed = [next(t for t, *brake in seen if t > 10 and brake[leg] == 1.0) for leg in (0, 1)]
    assert opened == [4, 7]
    assert closed == [12, 15]


def test_slipping_brake_fault_leaves_the_given_fraction_of_the_brake_force():
    rig = Rig(faults=[kinds.BrakeSlipping(leg=1, share=0.3), kinds.BrakeStuckClosed(leg=2)])
    rig.at(0)
    assert rig.brakes == [1, 0.3, 1, 1, 1, 1]
    rig.run()
    assert rig.brakes == [0, 0, 1, 0, 0, 0]


def test_brakes_stuck_open_or_closed_ignore_the_drive():
    rig = Rig(faults=[kinds.BrakeStuckClosed(leg=0), kinds.BrakeStuckOpen(leg=1), push(-200.0)])
    rig.at(1 * MS)
    assert rig.nodes.snapshot().rate.tolist() == pytest.approx([0, -1e-3, 0, 0, 0, 0])
    rig.at(1 * MS, *rig.protocol.configure(0.01, Reaction.BRAKE))
    rig.command(1 * MS, DriveMode.READY)
    rig.command(1 * MS, DriveMode.RUN)
    rig.at(2 * MS)
    assert rig.nodes.snapshot().rate.tolist() == pytest.approx([0, -2e-3, -1e-3, -1e-3, -1e-3, -1e-3])


# frames and buses


def test_drive_with_a_silence_fault_still_follows_commands():
    rig = Rig(faults=[kinds.DriveSilence(leg=3)])
    rig.run(200.0)
    sent = rig.at(5 * MS, *opening(rig.protocol, 0))
    assert not {frame.id for _, frame in sent} & {0x284, 0x704}
    assert rig.sync(5 * MS)["age"].tolist() == [0, 0, 0, 1_000_000, 0, 0]
    assert rig.nodes.snapshot().rate[3] == pytest.approx(5e-3)


def test_command_delay_fault_makes_the_command_act_later():
    rig = Rig("fd", faults=[kinds.FramesDelay(by_ms=2.0, identifier=0x110, at_s=0.5e-3)])
    rig.configure()
    rig.command(0, DriveMode.READY)
    rig.command(1 * MS, DriveMode.RUN)
    assert set(rig.states) == {DriveState.READY}
    rig.at(2_900_000)
    assert set(rig.states) == {DriveState.READY}
    rig.at(3 * MS)
    assert set(rig.states) == {DriveState.RUN}


def test_forged_command_acts_and_the_later_command_of_the_controller_is_rejected_as_repetition():
    rig = Rig("fd", faults=[kinds.FramesForgedCommand(force_N=300.0, at_s=2e-3)])
    rig.run(0.0)
    rig.tick += 1
    sync = opening(rig.protocol, rig.tick)
    sent = rig.at(3 * MS, *sync)
    assert [frame.id for _, frame in sent].count(0x110) == 1
    assert rig.nodes.snapshot().command.tolist() == pytest.approx([300.0] * 6, abs=2.0)
    ours = command_frames(rig.protocol, Command(DriveMode.RUN, np.zeros(6)), rig.tick)
    rig.at(3_300_000, *ours)
    assert rig.nodes.snapshot().command.tolist() == pytest.approx([300.0] * 6, abs=2.0)
    assert rig.nodes.snapshot().repeated > 0


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("by_m", [5e-3, -5e-3])
def test_forged_feedback_frame_follows_the_true_one_with_another_length(leg, by_m):
    rig = Rig("fd", faults=[kinds.FramesForgedFeedback(leg=leg, by_m=by_m)])
    rig.configure()
    rig.tick = 1
    sent = rig.at(1 * MS, *opening(rig.protocol, rig.tick))
    answers = [Received(t, frame) for t, frame in sent if frame.id == 0x281 + leg]
    said = [decode(rig.protocol, [each], rig.tick, new_record())["length"][leg] for each in answers]
    assert said == pytest.approx([REST[leg], REST[leg] + by_m], abs=1e-6)


# plant


def test_injected_wrench_acts_on_the_platform_from_its_start_to_its_end():
    rig = Rig(faults=[push(200.0, at_s=2e-3, for_s=0.003)])
    rig.run()
    rig.at(9 * MS)
    assert rig.nodes.snapshot().rate.tolist() == pytest.approx([3e-3] * 6)


def test_nan_lengths_of_the_plant_cause_an_error_and_never_reach_the_bus():
    rig = accelerating(kinds.PlantNaN(at_s=2e-3), layout="fd")
    with pytest.raises(PlantError, match="no valid measurement"):
        rig.sync(4 * MS)


def test_plant_crash_fault_raises_an_error_at_the_given_instant():
    rig = accelerating(kinds.PlantCrash(at_s=2e-3))
    rig.at(1_900_000)
    with pytest.raises(PlantError, match="plant_crash"):
        rig.at(2 * MS)


def test_plant_with_a_hang_fault_sends_no_answer_and_catches_up_afterwards():
    rig = accelerating(kinds.PlantHang(at_s=2e-3, for_s=3e-3))
    rig.at(2 * MS)
    assert rig.at(4 * MS, *opening(rig.protocol, 200)) == []
    stood = rig.nodes.snapshot().length.copy()
    rig.at(4_900_000)
    np.testing.assert_array_equal(rig.nodes.snapshot().length, stood)
    late = rig.at(6 * MS)
    assert len(late) >= 6, "answers to the SYNC that the plant has missed"
    assert rig.nodes.snapshot().length[0] - REST[0] == pytest.approx(motion(6)[0])


def test_weight_of_an_injected_payload_acts_at_its_point_of_the_moving_platform():
    """100 kg, 0.5 m along the x axis of a platform that turns, in a tilted machine: arm x weight."""
    gravity = (1.0, 2.0, -10.0)
    protocol = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))
    faults = FaultPlan([kinds.PayloadStep(mass_kg=100.0, position_m=(0.5, 0.0, 0.0))], gravity=gravity)
    nodes = Nodes(Mover(), protocol, DriveEmulation(), DriveSettings(), faults)
    nodes.start(0)
    for t_ms in (1, 200, 900):
        nodes.step(t_ms * MS, [Received(t_ms * MS, opening(protocol, t_ms)[0])])
        force = 100.0 * np.array(gravity)
        expected = [*force, *np.cross(0.5 * rotation(1e-3 * t_ms)[:, 0], force)]
        np.testing.assert_allclose(nodes.snapshot().wrench, expected, rtol=0, atol=1e-9)
