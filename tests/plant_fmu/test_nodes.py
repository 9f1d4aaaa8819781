"""Six emulated drives in front of six free masses whose motion is known in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, pi
from typing import Any

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.config import DriveSettings, TransmissionSettings
from drivers.errors import PlantError
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame, Received
from drivers.signals import (
    Command,
    DriveFault,
    DriveMode,
    DriveState,
    Reaction,
)
from drivers.tick_columns import Record, new_record
from drivers.transmission import Transmission
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.drive import Drives, at_motor
from plant_fmu.drives.kernels import NEVER_NS, feed
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import (
    BrakeStuckClosed,
    BrakeStuckOpen,
    DriveSign,
    DriveSilence,
    EncoderFreeze,
    EncoderJump,
    EncoderLost,
    FramesCorrupt,
    FramesLoss,
    WrenchStep,
)
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Truth
from tests.drivers.legs_frames import command_frames, decode, opening
from tests.plant_fmu.by_hand import enter, obey

MS = 1_000_000
US = 1_000
MASS = 200.0
REST = np.array([1.5, 1.6, 1.7, 1.8, 1.9, 2.0])


class Masses:
    """m ddq = f + wrench; an engaged brake holds. Exact for constant inputs, whatever the step."""

    internal_step_s = 1e-4

    def __init__(self) -> None:
        self.calls: list[tuple[float, list[float], list[float]]] = []
        self.reset()

    def reset(self) -> tuple[Array, Array]:
        self.q, self.dq = REST.copy(), np.zeros(6)
        return self.q, self.dq

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        self.calls.append((dt_s, force.tolist(), brake.tolist()))
        ddq = (force + wrench) / MASS
        free = brake == 0
        self.q = np.where(free, self.q + self.dq * dt_s + ddq * dt_s**2 / 2, self.q)
        self.dq = np.where(free, self.dq + ddq * dt_s, 0.0)
        return self.q, self.dq

    def truth(self) -> Truth | None:
        return None

    def applied_force(self) -> Array | None:
        return None

    def close(self) -> None:
        """Nothing to free."""


class Rig:
    """Controller's end: sends, collects, decodes."""

    def __init__(
        self,
        layout: str = "fd",
        *,
        faults: Sequence[Fault] = (),
        reaction: Reaction = Reaction.BRAKE,
        emulation: DriveEmulation | None = None,
        t0_ns: int = 0,
    ) -> None:
        self.protocol = LegsProtocol(layout, (1, 2, 3, 4, 5, 6))
        self.plant = Masses()
        exact = DriveEmulation(encoder_resolution_m=0.0)
        self.nodes = Nodes(self.plant, self.protocol, emulation or exact, DriveSettings(), FaultPlan(faults))
        self.nodes.start(t0_ns)
        self.t0 = t0_ns
        self.tick = 0
        self.reaction = reaction
        self.measurement = new_record()

    def at(self, t_ns: int, *frames: Frame) -> list[tuple[int, Frame]]:
        """Live until t0 + t_ns, with frames arriving at that instant."""
        t = self.t0 + t_ns
        return self.nodes.step(t, [Received(t, frame) for frame in frames])

    def sync(self, t_ns: int) -> Record:
        self.tick += 1
        sent = self.at(t_ns, *opening(self.protocol, self.tick))
        received = [Received(t, frame) for t, frame in sent]
        self.measurement = decode(self.protocol, received, self.tick, self.measurement)
        return self.measurement

    def command(
        self, t_ns: int, mode: DriveMode, force: float | Sequence[float] = 0.0
    ) -> list[tuple[int, Frame]]:
        self.tick += 1
        command = Command(mode, np.array(np.broadcast_to(force, 6), float))
        sync = opening(self.protocol, self.tick)
        return self.at(t_ns, *sync, *command_frames(self.protocol, command, self.tick))

    def configure(self, watchdog_s: float = 0.01) -> None:
        self.at(0, *self.protocol.configure(watchdog_s, self.reaction))

    def run(self, force: float | Sequence[float] = 0.0) -> None:
        """From boot to RUN at t = 0."""
        self.configure()
        self.command(0, DriveMode.READY)
        self.command(0, DriveMode.RUN, force)

    @property
    def states(self) -> list[int]:
        return [int(state) for state in self.nodes.snapshot().state]

    @property
    def brakes(self) -> list[float]:
        return [float(brake) for brake in self.nodes.snapshot().brake]


def push(newton: float, **when: Any) -> WrenchStep:
    """Push every mass, as gravity does."""
    return WrenchStep(force_N=(newton,) * 3, moment_N_m=(newton,) * 3, **when)


# states and brakes


def test_brakes_hold_the_load_from_power_up_to_run():
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


def test_commands_do_nothing_before_configuration():
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
def test_modes_lead_through_the_states(path, state, brake):
    rig = Rig()
    rig.configure()
    for t, mode in enumerate(path):
        rig.command((t + 1) * MS, mode, 10.0)
    assert rig.states == [state] * 6
    assert rig.brakes == [brake] * 6


@pytest.mark.parametrize("mode", [DriveMode.READY, DriveMode.RUN])
def test_configuration_is_refused_while_the_force_stage_is_on(mode):
    rig = Rig()
    rig.configure()
    for each in dict.fromkeys((DriveMode.READY, mode)):
        rig.command(0, each)
    rig.at(1 * MS, *rig.protocol.configure(1.0, Reaction.ZERO))
    assert rig.nodes.snapshot().rejected == 6
    rig.at(11 * MS)
    assert rig.states == [DriveState.FAULT] * 6
    assert rig.brakes == [1.0] * 6


def test_a_configuration_clears_no_fault():
    rig = Rig()
    rig.at(1 * MS, *rig.protocol.traits.emergency_stop)
    rig.at(2 * MS, *rig.protocol.configure(0.01, Reaction.BRAKE))
    assert rig.states == [DriveState.FAULT] * 6
    assert rig.nodes.snapshot().fault.tolist() == [DriveFault.ESTOP] * 6
    rig.command(3 * MS, DriveMode.RESET)
    assert rig.states == [DriveState.OFF] * 6, "it counts all the same"


# motion and time


def test_a_constant_force_moves_the_legs_as_in_closed_form():
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


def test_two_plant_steps_per_tick():
    rig = Rig()
    rig.run(100.0)
    rig.plant.calls.clear()
    for k in range(1, 11):
        rig.sync(k * MS + 50 * US)
        rig.command(k * MS + 600 * US, DriveMode.RUN, 100.0)
    assert len(rig.plant.calls) == 20
    assert sum(call[0] for call in rig.plant.calls) == pytest.approx(10.6e-3)


def test_ideal_layout_latches_and_acts_exactly_at_the_tick():
    rig = Rig("ideal", t0_ns=123_456_789_012_345)
    rig.run()
    q, dq = REST.copy(), np.zeros(6)
    for k in range(1, 8):
        force = 100.0 * k
        measurement = rig.sync(k * MS)
        np.testing.assert_allclose(measurement["length"], q, rtol=0, atol=1e-15)
        np.testing.assert_allclose(measurement["rate"], dq, rtol=0, atol=1e-15)
        rig.command(k * MS, DriveMode.RUN, force)
        q = q + dq * 1e-3 + force / MASS * 1e-6 / 2
        dq = dq + force / MASS * 1e-3


@pytest.mark.parametrize("offset_us", [0, 13, 49, 50, 51, 99])
def test_latch_between_grid_points_errs_by_at_most_an_eighth_a_h_squared(offset_us):
    rig = Rig("ideal")
    a = 10.0
    rig.run(a * MASS)
    t = 5e-3 + offset_us * 1e-6
    measurement = rig.sync(5 * MS + offset_us * US)
    h = rig.plant.internal_step_s
    assert np.abs(measurement["length"] - REST - a * t**2 / 2).max() <= a * h**2 / 8 + 1e-15
    assert np.abs(measurement["rate"] - a * t).max() <= a * h / 2 + 1e-15


@pytest.mark.parametrize(("arrival_us", "acts_us"), [(1049, 1000), (1051, 1100), (1000, 1000)])
def test_a_command_acts_at_the_nearest_grid_point(arrival_us, acts_us):
    rig = Rig()
    rig.run()
    rig.command(arrival_us * US, DriveMode.RUN, 200.0)
    rig.at(9 * MS)
    assert rig.nodes.snapshot().rate[0] == pytest.approx(9e-3 - acts_us * 1e-6, abs=1e-12)


def test_the_same_frames_in_one_call_or_many_give_the_same_motion():
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


def test_start_restores_everything():
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


def test_time_does_not_run_backwards():
    rig = Rig()
    rig.at(5 * MS)
    with pytest.raises(PlantError, match="backwards"):
        rig.at(4 * MS)


# what drives send


def test_feedback_is_queued_at_the_arrival_of_its_sync_with_its_counter():
    rig = Rig()
    rig.tick = 0x1A7
    sent = rig.at(3 * MS + 77 * US, *opening(rig.protocol, rig.tick))
    feedback = [(t, frame) for t, frame in sent if frame.id in rig.protocol.traits.feedback_ids]
    assert [t for t, _ in feedback] == [3 * MS + 77 * US] * 6
    assert [frame.id for _, frame in feedback] == [0x281, 0x282, 0x283, 0x284, 0x285, 0x286]
    measurement = decode(rig.protocol, [Received(0, f) for _, f in feedback], 0x1A7)
    assert measurement["age"].tolist() == [0] * 6


def test_encoder_reads_whole_quanta():
    rig = Rig("ideal", emulation=DriveEmulation(encoder_resolution_m=1e-3))
    rig.run(1000.0)
    measurement = rig.sync(5 * MS)  # 5 m/s^2 for 5 ms: 0.0625 mm, less than half a quantum
    np.testing.assert_allclose(measurement["length"], REST, rtol=0, atol=1e-12)
    for k in range(6, 17):
        rig.command(k * MS, DriveMode.RUN, 1000.0)
    measurement = rig.sync(16 * MS)  # 0.64 mm: more than half
    np.testing.assert_allclose(measurement["length"], REST + 1e-3, rtol=0, atol=1e-12)


def test_heartbeats_are_staggered_and_keep_their_period():
    rig = Rig()
    sent = rig.at(350 * MS)
    for node in range(1, 7):
        times = [t for t, frame in sent if frame.id == 0x700 + node]
        first = round((node - 1) * 100 * MS / 6)
        assert times[0] == first
        assert np.abs(np.diff(times) - 100 * MS).max() <= 1
    assert [t for t, _ in sent] == sorted(t for t, _ in sent)


def test_a_change_of_state_is_told_at_once():
    rig = Rig()
    rig.at(5 * MS)
    sent = rig.at(6 * MS, *rig.protocol.configure(0.01, Reaction.BRAKE))
    assert [(t, frame.id, frame.data[:2]) for t, frame in sent] == [
        (6 * MS, 0x701 + i, b"\1\0") for i in range(6)
    ]


def test_drives_clip_at_their_limit():
    rig = Rig()
    rig.run(70_000.0)
    snapshot = rig.nodes.snapshot()
    assert snapshot.force.tolist() == [60_000.0] * 6
    assert snapshot.command.tolist() == [70_000.0] * 6
    rig.command(1 * MS, DriveMode.RUN, -70_000.0)
    assert rig.nodes.snapshot().force.tolist() == [-60_000.0] * 6


def test_drives_clip_where_the_leg_that_loses_most_still_gets_the_rated_force():
    gear = TransmissionSettings(lead_m=0.01, efficiency=[0.9, 0.8, 0.5, 0.9, 0.7, 0.6])
    assert at_motor(DriveSettings(force_limit_N=100.0), Transmission(gear)).force_limit_N == 200.0


def test_what_the_gears_lose_reaches_neither_the_legs_nor_the_feedback():
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


# watchdog and reactions


@pytest.mark.parametrize("last_us", [0, 3000, 4049, 7777])
def test_watchdog_reacts_within_its_time_and_one_grid_step(last_us):
    rig = Rig()
    rig.run(100.0)
    if last_us:
        rig.command(last_us * US, DriveMode.RUN, 100.0)
    rig.plant.calls.clear()
    started = round(last_us / 100) * 100  # us, the grid point at which the plant stands
    sent = rig.at(30 * MS)
    free = sum(dt for dt, _, brake in rig.plant.calls if brake[0] == 0.0)
    stopped_us = started + free * 1e6
    assert last_us + 10_000 - 50 <= stopped_us <= last_us + 10_000 + 100
    told = [
        (t, frame.data[:2]) for t, frame in sent if frame.id == 0x701 and frame.data[0] == DriveState.FAULT
    ]
    assert told[0] == (last_us * US + 10 * MS, bytes([DriveState.FAULT, DriveFault.WATCHDOG]))


def test_each_drive_has_its_own_watchdog_and_reaction():
    rig = Rig()
    watchdog_ms = [30, 5, 10, 25, 15, 20]
    reactions = [Reaction(leg % 4) for leg in range(6)]
    sets = [
        rig.protocol.configure(1e-3 * ms, each)[leg]
        for leg, (ms, each) in enumerate(zip(watchdog_ms, reactions, strict=True))
    ]
    rig.at(0, *sets)
    rig.command(0, DriveMode.READY)
    rig.command(0, DriveMode.RUN)
    for t_ms in range(2, 35, 5):
        told = {frame.id: frame.data[:2] for _, frame in rig.at(t_ms * MS) if frame.id > 0x700}
        over = [ms < t_ms for ms in watchdog_ms]
        assert rig.states == [DriveState.FAULT if each else DriveState.RUN for each in over]
        braked = [each and kind is Reaction.BRAKE for each, kind in zip(over, reactions, strict=True)]
        assert rig.brakes == braked
        for leg, ms in enumerate(watchdog_ms):
            if t_ms - 5 <= ms < t_ms:
                assert told[0x701 + leg] == bytes([DriveState.FAULT, DriveFault.WATCHDOG])


def test_a_heartbeat_at_the_instant_at_which_a_watchdog_ends_reports_the_fault():
    rig = Rig()
    rig.run()
    for t_ms in range(5, 91, 5):
        rig.command(t_ms * MS, DriveMode.RUN)
    told = [frame.data[0] for t, frame in rig.at(101 * MS) if frame.id == 0x701 and t == 100 * MS]
    assert told == [DriveState.FAULT] * 2, "the change, and the seventh beat of six drives in 100 ms"


def test_a_heartbeat_feeds_the_watchdog_of_each_powered_drive_for_its_own_time():
    drives = Drives(DriveSettings(), DriveEmulation(), 1e-4)
    states = (
        DriveState.OFF,
        DriveState.READY,
        DriveState.RUN,
        DriveState.FAULT,
        DriveState.BOOT,
        DriveState.READY,
    )
    for leg, state in enumerate(states):
        enter(drives, leg, int(state), int(DriveFault.NONE))
    drives.seen.watchdog_ns[:] = np.arange(1, 7) * MS
    for leg in range(1, 6):
        feed(drives.seen, leg, 100)
    assert drives.seen.deadline_ns.tolist() == [
        NEVER_NS,
        100 + 2 * MS,
        100 + 3 * MS,
        NEVER_NS,
        NEVER_NS,
        100 + 6 * MS,
    ]


def test_a_command_that_feeds_no_watchdog_starts_that_of_a_drive_which_it_powers():
    drives = Drives(DriveSettings(), DriveEmulation(), 1e-4)
    for leg in range(6):
        enter(drives, leg, int(DriveState.READY if leg % 2 else DriveState.OFF), int(DriveFault.NONE))
    drives.seen.watchdog_ns[:], drives.seen.configured[:] = 5 * MS, True
    drives.seen.deadline_ns[1::2] = 3 * MS
    zero = np.zeros(6)
    obey(drives, zero, zero, np.arange(6), zero, int(DriveMode.READY), 0, MS, feeds=False)
    assert (drives.seen.state == DriveState.READY).all()
    assert drives.seen.deadline_ns.tolist() == [6 * MS, 3 * MS] * 3


def test_a_command_at_the_last_instant_is_in_time():
    rig = Rig()
    rig.run()
    rig.command(10 * MS, DriveMode.RUN)
    assert rig.states == [DriveState.RUN] * 6
    rig.at(20 * MS + 1)
    assert rig.states == [DriveState.FAULT] * 6


def test_watchdog_runs_in_ready_and_not_in_off():
    rig = Rig()
    rig.configure()
    rig.at(100 * MS)
    assert rig.states == [DriveState.OFF] * 6
    rig.command(100 * MS, DriveMode.READY)
    rig.at(111 * MS)
    assert rig.states == [DriveState.FAULT] * 6


def test_a_repeated_counter_does_not_feed_the_watchdog():
    rig = Rig()
    rig.run()
    frame = command_frames(rig.protocol, Command(DriveMode.RUN, np.full(6, 5.0)), rig.tick)
    for k in range(1, 15):
        rig.at(k * MS, *frame)
    assert rig.states == [DriveState.FAULT] * 6
    snapshot = rig.nodes.snapshot()
    assert (snapshot.repeated, snapshot.commands) == (14, 2)


def test_damaged_commands_do_not_feed_the_watchdog():
    rig = Rig(faults=[FramesCorrupt(identifier=0x110, at_s=0.5e-3)])
    rig.run()
    for k in range(1, 15):
        rig.command(k * MS, DriveMode.RUN)
    assert rig.states == [DriveState.FAULT] * 6
    assert rig.nodes.snapshot().rejected == 14


def test_one_lost_command_frame_of_the_classic_layout_stops_its_three_legs():
    rig = Rig("classic", faults=[FramesLoss(identifier=0x101, at_s=0.5e-3)])
    rig.run()
    for k in range(1, 15):
        rig.command(k * MS, DriveMode.RUN)
    assert rig.states == [DriveState.RUN] * 3 + [DriveState.FAULT] * 3


def test_each_command_frame_of_the_classic_layout_is_for_its_own_three_legs():
    rig = Rig("classic", reaction=Reaction.DAMP)
    rig.configure()

    def second_alone(t_ms: int, mode: DriveMode) -> list[int]:
        rig.tick += 1
        frames = command_frames(rig.protocol, Command(mode, np.zeros(6)), rig.tick)
        sent = rig.at(t_ms * MS, *opening(rig.protocol, rig.tick), frames[1])
        return [frame.id - 0x701 for _, frame in sent if frame.id > 0x700]

    assert second_alone(1, DriveMode.READY) == [3, 4, 5], "they say so at once"
    assert rig.states == [DriveState.OFF] * 3 + [DriveState.READY] * 3
    rig.command(2 * MS, DriveMode.READY)
    rig.command(3 * MS, DriveMode.RUN)
    rig.at(14 * MS)
    assert rig.states == [DriveState.FAULT] * 6
    second_alone(15, DriveMode.OFF)
    assert rig.brakes == [0.0] * 3 + [1.0] * 3, "an OFF ends damping"


def starve(reaction: Reaction, *, seconds: float, load: float = 0.0) -> tuple[Rig, float]:
    """Accelerate for 10 ms at 10 m/s^2, then silence: 0.1 m/s at the fault."""
    rig = Rig(reaction=reaction, faults=[push(load, at_s=0.01)] if load else [])
    rig.run(10.0 * MASS)
    rig.at(10 * MS + 1)
    assert rig.states == [DriveState.FAULT] * 6
    rig.at(10 * MS + round(seconds * 1e9))
    return rig, 0.5 * 10.0 * 0.01**2


def test_brake_reaction_stops_and_holds_without_force():
    rig, travelled = starve(Reaction.BRAKE, seconds=0.1, load=-2000.0)
    snapshot = rig.nodes.snapshot()
    np.testing.assert_allclose(snapshot.length, REST + travelled, rtol=0, atol=1e-12)
    assert (snapshot.force.tolist(), snapshot.brake.tolist()) == ([0.0] * 6, [1.0] * 6)


def test_zero_reaction_coasts():
    rig, travelled = starve(Reaction.ZERO, seconds=0.1)
    snapshot = rig.nodes.snapshot()
    np.testing.assert_allclose(snapshot.length, REST + travelled + 0.1 * 0.1, rtol=0, atol=1e-12)
    assert (snapshot.force.tolist(), snapshot.brake.tolist()) == ([0.0] * 6, [0.0] * 6)


def test_zero_reaction_never_ends_in_the_brake():
    """Damping and holding do, after drives.brake_after_ms: 1 s."""
    rig, _ = starve(Reaction.ZERO, seconds=3.0)
    assert rig.brakes == [0.0] * 6


def test_damp_reaction_brakes_exponentially():
    rig, travelled = starve(Reaction.DAMP, seconds=0.02)
    snapshot = rig.nodes.snapshot()
    # m dv = -c v with c = 20000 N s/m: v = 0.1 exp(-t c/m); the drive samples every 100 us: 1 % of the 10 ms constant
    expected = 0.1 * exp(-0.02 * 20_000 / MASS)
    np.testing.assert_allclose(snapshot.rate, expected, rtol=0.02)
    # (1 - c h / m)^n is what a drive that samples at h gives exactly
    np.testing.assert_allclose(snapshot.rate, 0.1 * (1 - 20_000 * 1e-4 / MASS) ** 200, rtol=1e-9)
    travel = 0.1 * MASS / 20_000 * (1 - exp(-0.02 * 20_000 / MASS))
    np.testing.assert_allclose(snapshot.length, REST + travelled + travel, rtol=0, atol=0.02 * travel)
    assert snapshot.brake.tolist() == [0.0] * 6


def test_hold_reaction_comes_back_to_the_length_of_the_fault_less_the_sag():
    rig, travelled = starve(Reaction.HOLD, seconds=1.0, load=-2000.0)
    snapshot = rig.nodes.snapshot()
    sag = 2000.0 / 2e6
    np.testing.assert_allclose(snapshot.length, REST + travelled - sag, rtol=0, atol=1e-7)
    np.testing.assert_allclose(snapshot.rate, 0.0, atol=1e-6)
    assert snapshot.brake.tolist() == [0.0] * 6


@pytest.mark.parametrize("reaction", list(Reaction))
def test_no_fault_opens_a_closed_brake(reaction):
    for path in ([], [DriveMode.READY]):
        rig = Rig(reaction=reaction, faults=[push(-2000.0)])
        rig.configure()
        for mode in path:
            rig.command(0, mode)
        rig.at(1 * MS, *rig.protocol.traits.emergency_stop)
        rig.at(50 * MS)
        assert rig.states == [DriveState.FAULT] * 6
        np.testing.assert_array_equal(rig.nodes.snapshot().length, REST)


def test_emergency_stop_faults_all_drives_and_latches_until_reset():
    rig = Rig()
    rig.run()
    rig.at(1 * MS, *rig.protocol.traits.emergency_stop)
    assert rig.nodes.snapshot().fault.tolist() == [DriveFault.ESTOP] * 6
    for k, mode in enumerate((DriveMode.OFF, DriveMode.READY, DriveMode.RUN)):
        rig.command((2 + k) * MS, mode)
        assert rig.states == [DriveState.FAULT] * 6
    rig.command(6 * MS, DriveMode.RESET)
    assert rig.states == [DriveState.OFF] * 6
    assert rig.nodes.snapshot().fault.tolist() == [DriveFault.NONE] * 6


def test_an_emergency_stop_that_is_repeated_is_reported_once():
    rig, _ = starve(Reaction.DAMP, seconds=0.01)
    statuses = [
        [frame.id for _, frame in rig.at(t_ms * MS, *rig.protocol.traits.emergency_stop) if frame.id > 0x700]
        for t_ms in (20, 21)
    ]
    assert statuses == [[0x701 + leg for leg in range(6)], []]


@pytest.mark.parametrize("reaction", list(Reaction))
def test_emergency_stop_in_motion_brakes_whatever_the_reaction(reaction):
    rig = Rig(reaction=reaction, faults=[push(-2000.0)])
    rig.run()
    rig.at(1 * MS, *rig.protocol.traits.emergency_stop)
    snapshot = rig.nodes.snapshot()
    assert snapshot.brake.tolist() == [1.0] * 6
    assert not snapshot.force.any()


@pytest.mark.parametrize("reaction", [Reaction.ZERO, Reaction.DAMP, Reaction.HOLD])
def test_emergency_stop_and_off_brake_a_drive_that_reacts_already(reaction):
    for stop in ("estop", "off"):
        rig, _ = starve(reaction, seconds=0.01)
        assert rig.nodes.snapshot().brake.tolist() == [0.0] * 6
        if stop == "estop":
            rig.at(20 * MS, *rig.protocol.traits.emergency_stop)
        else:
            rig.command(20 * MS, DriveMode.OFF)
        snapshot = rig.nodes.snapshot()
        expected = DriveFault.ESTOP if stop == "estop" else DriveFault.WATCHDOG
        assert snapshot.fault.tolist() == [expected] * 6, (
            "an emergency stop is confirmed, else the first stays"
        )
        assert snapshot.brake.tolist() == [1.0] * 6
        assert not snapshot.force.any()


def test_reset_of_a_drive_that_was_never_configured_leads_back_to_boot():
    rig = Rig()
    rig.at(1 * MS, *rig.protocol.traits.emergency_stop)
    assert rig.states == [DriveState.FAULT] * 6
    rig.command(2 * MS, DriveMode.RESET)
    assert rig.states == [DriveState.BOOT] * 6


# force lag


def test_emulated_force_lag_is_of_first_order():
    bandwidth = 50.0
    rig = Rig(emulation=DriveEmulation(encoder_resolution_m=0, force_bandwidth_Hz=bandwidth))
    rig.run(200.0)
    rig.at(9 * MS)
    w, t = 2 * pi * bandwidth, 9e-3
    # 1 m/s^2 behind a lag 1/w: v = t - (1 - exp(-w t)) / w; its mean over each grid step is exact
    np.testing.assert_allclose(rig.nodes.snapshot().rate, t - (1 - exp(-w * t)) / w, rtol=1e-9)


# faults of drives and plant


def test_encoder_slip_shows_in_feedback_and_not_in_the_plant():
    rig = Rig("ideal", faults=[EncoderJump(leg=2, by_m=5e-3, at_s=2e-3, for_s=0.002)])
    rig.configure()
    seen = [rig.sync(k * MS)["length"][2] - REST[2] for k in range(1, 6)]
    assert seen == pytest.approx([0, 5e-3, 5e-3, 0, 0], abs=1e-12)
    np.testing.assert_array_equal(rig.nodes.snapshot().length, REST)


def test_frozen_encoder_keeps_its_length_at_rate_zero():
    rig = Rig("ideal", faults=[EncoderFreeze(leg=1, at_s=3e-3)])
    rig.run(10 * MASS)
    measurement = rig.sync(8 * MS)
    assert measurement["length"][1] - REST[1] == pytest.approx(0.5 * 10 * 3e-3**2, abs=1e-12)
    assert measurement["rate"][1] == 0.0
    assert measurement["length"][0] - REST[0] == pytest.approx(0.5 * 10 * 8e-3**2, abs=1e-12)


def test_a_drive_that_lost_its_encoder_says_so_and_still_obeys():
    rig = Rig("ideal", faults=[EncoderLost(leg=1, at_s=3e-3)])
    rig.run(10 * MASS)
    measurement = rig.sync(8 * MS)
    assert measurement["blind"].tolist() == [False, True, False, False, False, False]
    assert (measurement["age"][1], measurement["drive_state"][1], measurement["drive_force"][1]) == (
        1_000_000,
        3,
        10 * MASS,
    )
    assert rig.nodes.snapshot().length[1] - REST[1] == pytest.approx(0.5 * 10 * 8e-3**2, abs=1e-12)


@pytest.mark.parametrize("reaction", [Reaction.HOLD, Reaction.DAMP])
def test_a_drive_without_its_encoder_brakes_where_its_reaction_needs_one(reaction):
    rig = Rig("ideal", faults=[EncoderLost(leg=1, at_s=3e-3)], reaction=reaction)
    rig.run(10 * MASS)
    rig.at(50 * MS)
    assert rig.nodes.snapshot().fault.tolist() == [DriveFault.WATCHDOG] * 6
    assert rig.nodes.snapshot().brake.tolist() == [0, 1, 0, 0, 0, 0]


def test_swapped_wires_push_the_other_way():
    rig = Rig(faults=[DriveSign(leg=4, at_s=0.0)])
    rig.run(200.0)
    rig.at(5 * MS)
    assert rig.nodes.snapshot().rate.tolist() == pytest.approx([5e-3] * 4 + [-5e-3] + [5e-3])


def test_a_silent_drive_is_missed_and_still_obeys():
    rig = Rig(faults=[DriveSilence(leg=3)])
    rig.run(200.0)
    sent = rig.at(5 * MS, *opening(rig.protocol, 0))
    assert not {frame.id for _, frame in sent} & {0x284, 0x704}
    assert rig.sync(5 * MS)["age"].tolist() == [0, 0, 0, 1_000_000, 0, 0]
    assert rig.nodes.snapshot().rate[3] == pytest.approx(5e-3)


def test_stuck_brakes_ignore_the_drive():
    rig = Rig(faults=[BrakeStuckClosed(leg=0), BrakeStuckOpen(leg=1), push(-200.0)])
    rig.at(1 * MS)
    assert rig.nodes.snapshot().rate.tolist() == pytest.approx([0, -1e-3, 0, 0, 0, 0])
    rig.at(1 * MS, *rig.protocol.configure(0.01, Reaction.BRAKE))
    rig.command(1 * MS, DriveMode.READY)
    rig.command(1 * MS, DriveMode.RUN)
    rig.at(2 * MS)
    assert rig.nodes.snapshot().rate.tolist() == pytest.approx([0, -2e-3, -1e-3, -1e-3, -1e-3, -1e-3])


def test_wrench_acts_from_and_to_its_instants():
    rig = Rig(faults=[push(200.0, at_s=2e-3, for_s=0.003)])
    rig.run()
    rig.at(9 * MS)
    assert rig.nodes.snapshot().rate.tolist() == pytest.approx([3e-3] * 6)


def test_lost_feedback_is_lost_at_its_rate():
    rig = Rig(faults=[FramesLoss(identifier=0x283, probability=0.25)])
    rig.configure()
    ages = []
    for k in range(1, 2001):
        rig.tick = k
        ages.append(rig.sync(k * MS)["age"].tolist())
    lost = np.count_nonzero(ages, axis=0)
    assert lost[[0, 1, 3, 4, 5]].tolist() == [0] * 5
    assert abs(lost[2] - 500) < 5 * (2000 * 0.25 * 0.75) ** 0.5  # five standard deviations


def test_damaged_feedback_is_refused_by_the_controller():
    rig = Rig(faults=[FramesCorrupt(identifier=0x286)])
    measurement = rig.sync(1 * MS)
    assert measurement["rejected"] == 1
    assert measurement["age"].tolist() == [0] * 5 + [1_000_000]
