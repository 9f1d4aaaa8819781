"""What each kind of fault does at the plant's end: six free masses whose motion is known in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.config import DriveSettings
from drivers.errors import PlantError
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame, Received
from drivers.signals import Command, DriveMode, DriveState
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import (
    BrakeSlipping,
    BrakeSlow,
    BrakeStuckClosed,
    BusFlood,
    BusOff,
    BusSecondController,
    DriveGain,
    DriveReset,
    DriveSaturation,
    DriveSign,
    EncoderDrift,
    EncoderFreeze,
    EncoderLate,
    EncoderLost,
    EncoderNoise,
    EncoderScale,
    EncoderSign,
    FramesDelay,
    FramesDuplicate,
    FramesForgedCommand,
    FramesForgedFeedback,
    FramesOld,
    PayloadStep,
    PlantCrash,
    PlantHang,
    PlantNaN,
)
from plant_fmu.faults.plan import FaultPlan
from tests.drivers.legs_frames import command_frames, opening
from tests.plant_fmu.test_nodes import MASS, MS, REST, Masses, Rig, push
from tests.plant_fmu.test_sensor_nodes import Mover, rotation

FEEDBACK_3 = 0x283
"""The fd feedback of leg 2."""


def accelerating(*faults: Fault, layout: str = "ideal") -> Rig:
    """Six drives in RUN, each mass accelerating by 10 m/s^2 from 0 s on."""
    rig = Rig(layout, faults=faults)
    rig.run(10 * MASS)
    return rig


def motion(t_ms: float) -> tuple[float, float]:
    t = 1e-3 * t_ms
    return 0.5 * 10 * t * t, 10 * t


def read(rig: Rig, t_ms: int, leg: int = 2) -> tuple[float, float]:
    found = rig.sync(t_ms * MS)
    return float(found["length"][leg] - REST[leg]), float(found["rate"][leg])


# encoders


def test_a_drifting_encoder_creeps_away_at_its_rate_and_is_right_again_afterwards():
    rig = accelerating(EncoderDrift(leg=2, by_m_s=0.5, at_s=2e-3, for_s=4e-3))
    for t_ms, drifted, rate in ((1, 0, 0), (2, 0, 0.5), (4, 1e-3, 0.5), (5, 1.5e-3, 0.5), (7, 0, 0)):
        l, dl = motion(t_ms)
        assert read(rig, t_ms) == pytest.approx((l + drifted, dl + rate), abs=1e-9)
    assert rig.nodes.snapshot().length[2] - REST[2] == pytest.approx(motion(7)[0])


def test_a_scaled_encoder_counts_the_motion_since_its_fault_began():
    rig = accelerating(EncoderScale(leg=2, factor=1.5, at_s=2e-3))
    since, _ = motion(2)
    l, dl = motion(6)
    assert read(rig, 6) == pytest.approx((since + 1.5 * (l - since), 1.5 * dl), abs=1e-9)
    assert read(rig, 6, leg=3) == pytest.approx((l, dl), abs=1e-9)


def test_a_scaled_or_frozen_encoder_goes_on_as_it_began_whatever_else_begins():
    rig = accelerating(
        EncoderScale(leg=2, factor=1.5, at_s=2e-3),
        EncoderFreeze(leg=3, at_s=2e-3),
        EncoderLost(leg=3, at_s=3e-3, for_s=1e-3),
        DriveGain(leg=5, factor=0.5, at_s=4e-3),
    )
    since, _ = motion(2)
    l, dl = motion(6)
    assert read(rig, 6) == pytest.approx((since + 1.5 * (l - since), 1.5 * dl), abs=1e-9)
    assert read(rig, 6, leg=3) == pytest.approx((since, 0.0), abs=1e-9)


@pytest.mark.parametrize("lost_s", [2e-3, 3e-3])
def test_an_encoder_that_freezes_while_it_is_lost_reads_the_length_of_that_moment_afterwards(lost_s):
    frozen, lost = EncoderFreeze(leg=3, at_s=3e-3), EncoderLost(leg=3, at_s=lost_s, for_s=5e-3 - lost_s)
    rig = accelerating(frozen, lost)
    assert read(rig, 6, leg=3) == pytest.approx((motion(3)[0], 0.0), abs=1e-9)


def test_an_encoder_that_counts_backwards_starts_where_it_is():
    rig = accelerating(EncoderSign(leg=2, at_s=2e-3))
    since, rate = motion(2)
    assert read(rig, 2) == pytest.approx((since, -rate), abs=1e-9)
    l, dl = motion(6)
    assert read(rig, 6) == pytest.approx((2 * since - l, -dl), abs=1e-9)


def test_a_late_encoder_stands_still_and_then_is_late_by_so_much():
    rig = accelerating(EncoderLate(leg=2, by_ms=3.0, at_s=2e-3))
    seen = [read(rig, t_ms) for t_ms in range(1, 9)]
    assert seen[0] == pytest.approx(motion(1))
    for early in seen[1:4]:
        assert early == pytest.approx(motion(2))
    for t_ms in range(5, 9):
        assert seen[t_ms - 1] == pytest.approx(motion(t_ms - 3))


def test_a_reading_between_two_is_carried_on_by_its_rate():
    rig = accelerating(EncoderLate(leg=2, by_ms=1.5, at_s=2e-3))
    seen = [read(rig, t_ms) for t_ms in range(2, 6)]
    l, dl = motion(3)
    assert seen[-1] == pytest.approx((l + dl * 0.5e-3, dl))


def test_encoders_are_late_each_by_its_own_time():
    rig = accelerating(EncoderLate(leg=2, by_ms=3.0), EncoderLate(leg=4, by_ms=1.0))
    for t_ms in range(7):
        found = rig.sync(t_ms * MS)
    for leg, late_ms in ((2, 3), (4, 1), (3, 0)):
        l, dl = motion(6 - late_ms)
        assert found["length"][leg] - REST[leg] == pytest.approx(l)
        assert found["rate"][leg] == pytest.approx(dl)


def test_an_encoder_that_is_late_again_stands_still_again_first():
    rig = accelerating(*[EncoderLate(leg=2, by_ms=3.0, at_s=at_s, for_s=2e-3) for at_s in (2e-3, 6e-3)])
    seen = [read(rig, t_ms) for t_ms in range(1, 8)]
    assert seen[4] == pytest.approx(motion(5)), "it works meanwhile"
    assert seen[5] == seen[6] == pytest.approx(motion(6))


def test_noise_is_white_of_its_size_on_the_length_alone_and_repeats_with_its_seed():
    def lengths(seed: int) -> Any:
        rig = Rig("ideal", faults=[EncoderNoise(leg=2, sigma_m=1e-3, seed=seed)])
        rig.configure()
        measured = [rig.sync(t * MS) for t in range(1, 1001)]
        assert all(m["rate"][2] == 0 and m["length"][3] == REST[3] for m in measured)
        return np.array([m["length"][2] for m in measured]) - REST[2]

    noise = lengths(1)
    assert abs(noise.mean()) < 5 * 1e-3 / 1000**0.5
    assert noise.std() == pytest.approx(1e-3, rel=5 / 2000**0.5)
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 5 / 1000**0.5
    np.testing.assert_array_equal(noise, lengths(1))
    assert (noise != lengths(2)).all()


def test_a_frozen_encoder_works_again_after_its_time():
    rig = accelerating(EncoderFreeze(leg=2, at_s=2e-3, for_s=3e-3))
    assert read(rig, 4) == pytest.approx((motion(2)[0], 0.0))
    assert read(rig, 6) == pytest.approx(motion(6))


# drives


@pytest.mark.parametrize(
    ("fault", "share"),
    [
        (DriveGain(leg=4, factor=0.5), 0.5),
        (DriveSign(leg=4), -1.0),
        (DriveSaturation(leg=4, limit_N=0.25 * 10 * MASS), 0.25),
        (DriveSaturation(leg=4, limit_N=11 * MASS), 1.0),
    ],
)
def test_the_force_of_a_faulty_drive_shows_in_the_motion(fault, share):
    rig = accelerating(fault)
    rig.at(5 * MS)
    rates = rig.nodes.snapshot().rate
    assert rates[4] == pytest.approx(share * 10 * 5e-3)
    assert rates[3] == pytest.approx(10 * 5e-3)


def test_a_saturated_drive_is_limited_in_both_directions():
    rig = Rig("ideal", faults=[DriveSaturation(leg=4, limit_N=200.0)])
    rig.run(-1000.0)
    rig.at(5 * MS)
    assert rig.nodes.snapshot().rate[4] == pytest.approx(-5e-3)


def test_a_drive_that_starts_anew_brakes_and_has_to_be_set_up_again():
    rig = accelerating(DriveReset(leg=4, at_s=3e-3))
    rig.at(3 * MS)
    assert rig.states == [DriveState.RUN] * 4 + [DriveState.BOOT, DriveState.RUN]
    assert rig.brakes == [0, 0, 0, 0, 1, 0]
    rig.command(4 * MS, DriveMode.READY)
    assert rig.states[4] == DriveState.BOOT, "it does not obey"
    rig.at(5 * MS, *rig.protocol.configure(0.01, rig.reaction))
    assert rig.states[4] == DriveState.OFF
    rig.command(6 * MS, DriveMode.READY)
    assert rig.states[4] == DriveState.READY


def test_a_drive_that_starts_anew_has_forgotten_which_command_it_heard_last():
    rig = Rig("fd", faults=[DriveReset(leg=4, at_s=3e-3)])
    rig.configure()
    rig.command(1 * MS, DriveMode.READY)
    last = command_frames(rig.protocol, Command(DriveMode.READY, np.zeros(6)), rig.tick)
    rig.at(4 * MS, *rig.protocol.configure(0.01, rig.reaction), *last)
    assert rig.states == [DriveState.READY] * 6, "to leg 4 it is none that is repeated"


# brakes

BRAKES = DriveEmulation(encoder_resolution_m=0.0, brake_open_ms=4.0, brake_close_ms=2.0)


def test_a_slow_brake_opens_and_closes_later_than_its_drive_counts():
    rig = Rig(emulation=BRAKES, faults=[BrakeSlow(leg=1, by_ms=3.0)])
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


def test_a_slow_brake_is_late_too_where_its_drive_counts_no_time():
    rig = Rig(faults=[BrakeSlow(leg=1, by_ms=3.0)])
    rig.run()
    seen = [rig.brakes[1] for t_us in (2_900, 3_000) if rig.at(t_us * 1000) is not None]
    rig.command(5 * MS, DriveMode.OFF)
    seen += [rig.brakes[1] for t_us in (7_900, 8_000) if rig.at(t_us * 1000) is not None]
    assert seen == [1.0, 0.0, 0.0, 1.0]


def test_a_slow_brake_that_is_called_back_has_not_moved():
    rig = Rig(emulation=BRAKES, faults=[BrakeSlow(leg=1, by_ms=20.0)])
    rig.run()
    rig.command(5 * MS, DriveMode.READY)
    rig.at(9 * MS)
    for t_ms in range(10, 40, 5):
        rig.command(t_ms * MS, DriveMode.READY)
        assert rig.brakes[1] == 1.0


@pytest.mark.parametrize(("share", "engaged"), [(0.3, 0.3), (0.0, 0.0)])
def test_a_slipping_brake_has_its_share_of_force(share, engaged):
    rig = Rig(faults=[BrakeSlipping(leg=1, share=share), BrakeStuckClosed(leg=2)])
    rig.at(0)
    assert rig.brakes == [1, engaged, 1, 1, 1, 1]
    rig.run()
    assert rig.brakes == [0, 0, 1, 0, 0, 0]


# frames


def ids(frames: list[tuple[int, Frame]]) -> list[int]:
    return [frame.id for _, frame in frames]


def test_a_delayed_command_is_obeyed_later():
    rig = Rig("fd", faults=[FramesDelay(by_ms=2.0, identifier=0x110, at_s=0.5e-3)])
    rig.configure()
    rig.command(0, DriveMode.READY)
    rig.command(1 * MS, DriveMode.RUN)
    assert set(rig.states) == {DriveState.READY}
    rig.at(2_900_000)
    assert set(rig.states) == {DriveState.READY}
    rig.at(3 * MS)
    assert set(rig.states) == {DriveState.RUN}


def test_delayed_feedback_is_for_an_instant_to_come():
    rig = Rig("fd", faults=[FramesDelay(by_ms=2.0, identifier=FEEDBACK_3)])
    rig.configure()
    sent = rig.at(1 * MS, *opening(rig.protocol, 0))
    late = [t for t, frame in sent if frame.id == FEEDBACK_3]
    assert late == [3 * MS]
    assert [t for t, _ in sent] == sorted(t for t, _ in sent)


def test_doubled_feedback_is_on_the_bus_twice():
    rig = Rig("fd", faults=[FramesDuplicate(identifier=FEEDBACK_3)])
    rig.configure()
    sent = ids(rig.at(1 * MS, *opening(rig.protocol, 0)))
    assert sent.count(FEEDBACK_3) == 2
    assert sent.count(FEEDBACK_3 - 1) == 1


def test_a_forger_is_obeyed_before_the_controller_and_both_ends_hear_him():
    rig = Rig("fd", faults=[FramesForgedCommand(force_N=300.0, at_s=2e-3)])
    rig.run(0.0)
    rig.tick += 1
    sync = opening(rig.protocol, rig.tick)
    sent = rig.at(3 * MS, *sync)
    assert ids(sent).count(0x110) == 1
    assert rig.nodes.snapshot().command.tolist() == pytest.approx([300.0] * 6, abs=2.0)
    ours = command_frames(rig.protocol, Command(DriveMode.RUN, np.zeros(6)), rig.tick)
    rig.at(3_300_000, *ours)
    assert rig.nodes.snapshot().command.tolist() == pytest.approx([300.0] * 6, abs=2.0)
    assert rig.nodes.snapshot().repeated > 0


@pytest.mark.parametrize("bus", [0, 1])
def test_a_forger_on_several_buses_answers_each_sync_on_its_own_bus(bus):
    protocol = LegsProtocol("fd", (1, 2, 3, 4, 5, 6), 60_000.0, ((0, 1, 2), (3, 4, 5)))
    nodes = Nodes(
        Masses(), protocol, DriveEmulation(), DriveSettings(), FaultPlan([FramesForgedCommand(force_N=300.0)])
    )
    nodes.start(0)
    own = command_frames(protocol, Command(DriveMode.RUN, np.full(6, 300.0)), 0)[bus]
    sent = nodes.step(1 * MS, [Received(1 * MS, opening(protocol, 0)[bus])])
    assert [frame.bus for _, frame in sent if frame.id == own.id] == [bus]


def test_a_second_node_of_a_number_answers_with_another_length():
    rig = Rig("fd", faults=[FramesForgedFeedback(leg=2, by_m=5e-3)])
    rig.configure()
    found = rig.sync(1 * MS)
    assert found["doubled"] == 1 << 2
    assert found["rejected"] == 0, "its checks are right"


def test_old_commands_are_heard_by_both_ends_and_count_for_nothing():
    rig = Rig("fd", faults=[FramesOld(back=1, identifier=0x110)])
    rig.run(100.0)
    rejected = rig.nodes.snapshot().rejected
    sent = rig.command(1 * MS, DriveMode.RUN, 500.0)
    assert ids(sent).count(0x110) == 1
    assert rig.nodes.snapshot().command.tolist() == pytest.approx([500.0] * 6, abs=2.0)
    assert rig.nodes.snapshot().rejected == rejected + 1


# bus


def test_bus_off_cuts_both_directions_and_is_reported():
    rig = accelerating(BusOff(at_s=2e-3, for_s=5e-3), layout="fd")
    assert not rig.nodes.bus_off
    rig.at(2 * MS)
    assert rig.nodes.bus_off
    assert rig.at(3 * MS, *opening(rig.protocol, 200)) == []
    rig.at(7 * MS)
    assert not rig.nodes.bus_off
    assert len(rig.at(8 * MS, *opening(rig.protocol, 201))) >= 6


def test_a_flood_has_its_rate_and_is_put_on_the_bus_ahead():
    rig = Rig("fd", faults=[BusFlood(rate_Hz=4000.0, at_s=10e-3, for_s=10e-3)])
    flood = []
    for t_ms in range(1, 40):
        flood += [t for t, frame in rig.at(t_ms * MS) if frame.id == 0]
    assert flood == [10 * MS + k * MS // 4 for k in range(40)]


def test_a_second_controller_sends_sync_and_command_of_its_own():
    rig = Rig("fd", faults=[BusSecondController(rate_Hz=500.0, force_N=300.0, at_s=5e-3)])
    rig.run(0.0)
    sent = rig.at(5 * MS)
    assert ids(sent)[:2] == [0x80, 0x110] or {0x80, 0x110} <= set(ids(sent))
    assert rig.nodes.snapshot().command.tolist() == pytest.approx([300.0] * 6, abs=2.0)
    assert sum(frame.id in range(0x281, 0x287) for _, frame in sent) == 6, "its SYNC is answered"


# plant


def test_lengths_that_are_no_numbers_never_reach_the_bus():
    rig = accelerating(PlantNaN(at_s=2e-3), layout="fd")
    with pytest.raises(PlantError, match="no measurement"):
        rig.sync(4 * MS)


def test_a_crash_comes_at_its_instant():
    rig = accelerating(PlantCrash(at_s=2e-3))
    rig.at(1_900_000)
    with pytest.raises(PlantError, match="plant_crash"):
        rig.at(2 * MS)


def test_a_plant_that_hangs_answers_nothing_and_then_catches_up():
    rig = accelerating(PlantHang(at_s=2e-3, for_s=3e-3))
    rig.at(2 * MS)
    assert rig.at(4 * MS, *opening(rig.protocol, 200)) == []
    stood = rig.nodes.snapshot().length.copy()
    rig.at(4_900_000)
    np.testing.assert_array_equal(rig.nodes.snapshot().length, stood)
    late = rig.at(6 * MS)
    assert len(late) >= 6, "the SYNC that it has missed"
    assert rig.nodes.snapshot().length[0] - REST[0] == pytest.approx(motion(6)[0])


def test_a_payload_needs_a_plant_that_knows_where_it_is():
    """Free masses carry no platform: nothing happens to them."""
    rig = Rig(faults=[PayloadStep(mass_kg=100.0), push(-200.0)])
    rig.run()
    rig.at(5 * MS)
    assert rig.nodes.snapshot().rate.tolist() == pytest.approx([-5e-3] * 6)


class Pushed(Mover):
    """A platform that says which forces its legs have."""

    def truth(self):
        return super().truth()._replace(applied_force=np.full(6, 7.0))


def test_a_payload_weighs_where_its_moving_platform_is_by_now():
    """100 kg, 0.5 m along the x axis of a platform that turns."""
    protocol = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))
    faults = FaultPlan([PayloadStep(mass_kg=100.0, position_m=(0.5, 0.0, 0.0))], gravity=(0.0, 0.0, -10.0))
    nodes = Nodes(Pushed(), protocol, DriveEmulation(), DriveSettings(), faults)
    nodes.start(0)
    assert nodes.snapshot().applied.tolist() == [7.0] * 6, "the plant's own word"
    for t_ms in (1, 200, 900):
        nodes.step(t_ms * MS, [Received(t_ms * MS, opening(protocol, t_ms)[0])])
        x, y, _ = 0.5 * rotation(1e-3 * t_ms)[:, 0]
        expected = [0.0, 0.0, -1000.0, -1000.0 * y, 1000.0 * x, 0.0]
        np.testing.assert_allclose(nodes.snapshot().wrench, expected, rtol=0, atol=1e-9)


# modes


def test_a_fault_of_a_mode_begins_when_the_nodes_are_told_so():
    fault = EncoderFreeze(leg=2, mode="TRACKING", at_s=2e-3)
    rig = accelerating(fault)
    assert read(rig, 3) == pytest.approx(motion(3))
    rig.nodes.reached("APPROACH")
    rig.nodes.reached("TRACKING")
    assert rig.nodes.schedule.starts_ns(fault) == 5 * MS
    assert not rig.nodes.waiting
    assert read(rig, 4) == pytest.approx(motion(4))
    assert read(rig, 6) == pytest.approx((motion(5)[0], 0.0))


def test_a_fault_of_a_mode_can_begin_at_once():
    rig = accelerating(EncoderFreeze(leg=2, mode="TRACKING"))
    rig.at(3 * MS)
    rig.nodes.reached("TRACKING")
    assert read(rig, 4) == pytest.approx((motion(3)[0], 0.0))


def test_a_new_start_forgets_that_a_mode_was_reached():
    rig = accelerating(EncoderFreeze(leg=2, mode="TRACKING"))
    rig.nodes.reached("TRACKING")
    rig.nodes.start(0)
    assert len(rig.nodes.waiting) == 1
