"""Six emulated drives in front of six free masses: states, motion and frames."""

from __future__ import annotations

from math import exp, pi

import numpy as np
import pytest

from drivers.config import DriveSettings, TransmissionSettings
from drivers.errors import PlantError
from drivers.protocol import Frame, Received
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from drivers.transmission import Transmission
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.drive import at_motor
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.kinds import FramesLoss
from tests.drivers.legs_frames import command_frames, opening
from tests.plant_fmu.rig import MASS, MS, REST, US, Rig, push


def test_drive_brakes_hold_the_load_from_power_up_until_run():
    rig = Rig(faults=[push(-2000.0)])
    assert rig.states == [DriveState.BOOT] * 6
    rig.at(50 * MS)
    rig.at(51 * MS, *rig.protocol.configure(0.01, Reaction.BRAKE))
    assert rig.states == [DriveState.OFF] * 6
    rig.command(52 * MS, DriveMode.READY, 2000.0)
    rig.at(60 * MS)
    assert rig.states == [DriveState.READY] * 6
    snapshot = rig.nodes.snapshot()
    np.testing.assert_array_equal(snapshot.length, REST)
    assert snapshot.brake.tolist() == [1.0] * 6
    assert snapshot.force.tolist() == [2000.0] * 6


def test_drive_commands_have_no_effect_before_the_set_up():
    rig = Rig()
    for t in range(1, 6):
        rig.command(t * MS, DriveMode.READY if t < 3 else DriveMode.RUN, 100.0)
    rig.command(7 * MS, DriveMode.RESET)
    assert rig.states == [DriveState.BOOT] * 6
    assert rig.brakes == [1.0] * 6


@pytest.mark.parametrize(
    ("path", "state", "brake"),
    [
        ([DriveMode.RUN, DriveMode.RUN], DriveState.OFF, 1.0),
        ([DriveMode.READY], DriveState.READY, 1.0),
        ([DriveMode.READY, DriveMode.RUN], DriveState.RUN, 0.0),
        ([DriveMode.READY, DriveMode.RUN, DriveMode.READY], DriveState.READY, 1.0),
        ([DriveMode.READY, DriveMode.RUN, DriveMode.OFF], DriveState.OFF, 1.0),
        ([DriveMode.READY, DriveMode.RUN, DriveMode.RESET], DriveState.OFF, 1.0),
        ([DriveMode.READY, DriveMode.OFF], DriveState.OFF, 1.0),
    ],
)
def test_commanded_modes_lead_a_drive_through_the_expected_states(path, state, brake):
    rig = Rig()
    rig.configure()
    for t, mode in enumerate(path):
        rig.command((t + 1) * MS, mode, 10.0)
    assert rig.states == [state] * 6
    assert rig.brakes == [brake] * 6


@pytest.mark.parametrize("mode", [DriveMode.READY, DriveMode.RUN])
def test_drive_rejects_a_set_up_while_its_power_stage_is_on(mode):
    rig = Rig()
    rig.configure()
    for each in dict.fromkeys((DriveMode.READY, mode)):
        rig.command(0, each)
    rig.at(1 * MS, *rig.protocol.configure(1.0, Reaction.ZERO))
    assert rig.nodes.snapshot().rejected == 6
    rig.at(11 * MS)
    assert rig.states == [DriveState.FAULT] * 6
    assert rig.brakes == [1.0] * 6


def test_set_up_does_not_clear_the_fault_of_a_drive():
    rig = Rig()
    rig.at(1 * MS, *rig.protocol.traits.emergency_stop)
    rig.at(2 * MS, *rig.protocol.configure(0.01, Reaction.BRAKE))
    assert rig.states == [DriveState.FAULT] * 6
    assert rig.nodes.snapshot().fault.tolist() == [DriveFault.ESTOP] * 6
    rig.command(3 * MS, DriveMode.RESET)
    assert rig.states == [DriveState.OFF] * 6, "it counts all the same"


def test_constant_force_accelerates_free_legs_uniformly():
    rig = Rig()
    force = [200.0, -100.0, 50.0, 0.0, 400.0, -300.0]
    rig.run(force)
    for k in range(1, 51):
        rig.command(k * MS, DriveMode.RUN, force)
    a = np.array([1.0, -0.5, 0.25, 0.0, 2.0, -1.5])  # force / 200 kg
    snapshot = rig.nodes.snapshot()
    assert snapshot.t_ns == 50 * MS
    np.testing.assert_allclose(snapshot.length, REST + a * 0.05**2 / 2, rtol=0, atol=1e-13)
    np.testing.assert_allclose(snapshot.rate, a * 0.05, rtol=0, atol=1e-13)


@pytest.mark.parametrize("offset_us", [0, 13, 49, 50, 51, 99])
def test_length_sampled_between_plant_steps_has_an_error_of_at_most_a_h_squared_over_8(offset_us):
    rig = Rig("ideal")
    a = 10.0
    rig.run(a * MASS)
    t = 5e-3 + offset_us * 1e-6
    measurement = rig.sync(5 * MS + offset_us * US)
    h = rig.plant.internal_step_s
    assert np.abs(measurement["length"] - REST - a * t**2 / 2).max() <= a * h**2 / 8 + 1e-15
    assert np.abs(measurement["rate"] - a * t).max() <= a * h / 2 + 1e-15


@pytest.mark.parametrize(("arrival_us", "acts_us"), [(1049, 1000), (1051, 1100), (1000, 1000)])
def test_drive_command_acts_at_the_nearest_plant_step(arrival_us, acts_us):
    rig = Rig()
    rig.run()
    rig.command(arrival_us * US, DriveMode.RUN, 200.0)
    rig.at(9 * MS)
    assert rig.nodes.snapshot().rate[0] == pytest.approx(9e-3 - acts_us * 1e-6, abs=1e-12)


def test_frames_given_to_the_drives_in_one_call_or_in_many_give_the_same_motion():
    one, many = Rig(), Rig()
    for rig in (one, many):
        rig.run(100.0)
    frames = []
    for k in range(1, 6):
        frames.append(Received(k * MS, opening(one.protocol, k)[0]))
        command = Command(DriveMode.RUN, np.full(6, 50.0 * k))
        frames.append(Received(k * MS + 400 * US, command_frames(one.protocol, command, k)[0]))
    together = one.nodes.step(6 * MS, frames[::-1])
    apart = [sent for frame in frames for sent in many.nodes.step(frame.t_ns, [frame])]
    apart += many.nodes.step(6 * MS, [])
    assert together == apart
    np.testing.assert_allclose(one.nodes.snapshot().length, many.nodes.snapshot().length, rtol=0, atol=1e-15)


def test_start_of_the_emulated_drives_restores_their_whole_initial_state():
    rig = Rig(faults=[FramesLoss(probability=0.5, identifier=0x283)])

    def live() -> list[tuple[int, Frame]]:
        rig.nodes.start(0)
        rig.tick = 0
        rig.run(100.0)
        sent = [each for k in range(1, 30) for each in rig.at(k * MS, *opening(rig.protocol, k))]
        damaged = command_frames(rig.protocol, Command(DriveMode.RUN, np.zeros(6)), 0)[0]
        rig.at(30 * MS, damaged._replace(data=damaged.data[::-1]))
        return sent

    first, then = live(), rig.nodes.snapshot()
    assert first
    assert then.rejected > 0
    assert then.commands > 0
    assert first == live()
    assert str(then) == str(rig.nodes.snapshot())


def test_emulated_drives_refuse_an_instant_before_the_present():
    rig = Rig()
    rig.at(5 * MS)
    with pytest.raises(PlantError, match="before that of the last call"):
        rig.at(4 * MS)


def test_drive_force_follows_its_command_as_a_first_order_lag():
    bandwidth = 50.0
    rig = Rig(emulation=DriveEmulation(encoder_resolution_m=0, force_bandwidth_Hz=bandwidth))
    rig.run(200.0)
    rig.at(9 * MS)
    w, t = 2 * pi * bandwidth, 9e-3
    # 1 m/s^2 after a lag 1/w: v = t - (1 - exp(-w t)) / w; its mean over each grid step is exact
    np.testing.assert_allclose(rig.nodes.snapshot().rate, t - (1 - exp(-w * t)) / w, rtol=1e-9)
    rig.command(9 * MS, DriveMode.RUN, -200.0)
    reached = 200.0 * (1.0 - exp(-w * 9e-3))
    np.testing.assert_allclose(rig.nodes.snapshot().force, reached, rtol=1e-9, err_msg="no leap")


def test_drive_encoders_round_lengths_to_whole_resolution_steps():
    rig = Rig("ideal", emulation=DriveEmulation(encoder_resolution_m=1e-3))
    rig.run(1000.0)
    measurement = rig.sync(5 * MS)  # 5 m/s^2 for 5 ms: 0.0625 mm, less than half a quantum
    np.testing.assert_allclose(measurement["length"], REST, rtol=0, atol=1e-12)
    for k in range(6, 17):
        rig.command(k * MS, DriveMode.RUN, 1000.0)
    measurement = rig.sync(16 * MS)  # 0.64 mm: more than half
    np.testing.assert_allclose(measurement["length"], REST + 1e-3, rtol=0, atol=1e-12)


def test_drive_heartbeats_are_staggered_and_keep_their_period():
    rig = Rig()
    sent = rig.at(350 * MS)
    for node in range(1, 7):
        times = [t for t, frame in sent if frame.id == 0x700 + node]
        first = round((node - 1) * 100 * MS / 6)
        assert times[0] == first
        assert np.abs(np.diff(times) - 100 * MS).max() <= 1
    assert [t for t, _ in sent] == sorted(t for t, _ in sent)


def test_emulated_drives_saturate_their_force_at_the_force_limit():
    rig = Rig()
    rig.run(70_000.0)
    snapshot = rig.nodes.snapshot()
    assert snapshot.force.tolist() == [60_000.0] * 6
    assert snapshot.command.tolist() == [70_000.0] * 6
    rig.command(1 * MS, DriveMode.RUN, -70_000.0)
    assert rig.nodes.snapshot().force.tolist() == [-60_000.0] * 6


def test_motor_force_limit_includes_the_losses_of_the_least_efficient_leg():
    gear = TransmissionSettings(lead_m=0.01, efficiency=[0.9, 0.8, 0.5, 0.9, 0.7, 0.6])
    assert at_motor(DriveSettings(force_limit_N=100.0), Transmission(gear)).force_limit_N == 200.0


def test_leg_force_and_feedback_are_the_motor_force_after_the_losses_of_the_gears():
    rig = Rig("ideal")
    gear = TransmissionSettings(lead_m=0.01, efficiency=[1.0, 0.9, 0.8, 0.7, 0.6, 0.5])
    exact = DriveEmulation(encoder_resolution_m=0.0)
    rig.nodes = Nodes(rig.plant, rig.protocol, exact, DriveSettings(transmission=gear))
    rig.nodes.start(0)
    rig.run(1000.0)
    rig.at(4 * MS)
    rig.command(5 * MS, DriveMode.RUN, 1000.0)
    rig.at(6 * MS)
    left = [1000.0, 900.0, 800.0, 700.0, 600.0, 500.0]
    assert rig.plant.calls[-1][1] == pytest.approx(left), "the legs move: all of the loss"
    assert rig.sync(7 * MS)["drive_force"].tolist() == pytest.approx(left)
    assert rig.nodes.snapshot().force.tolist() == [1000.0] * 6
