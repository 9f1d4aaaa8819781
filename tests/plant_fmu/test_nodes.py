"""Six emulated drives in front of six free masses whose motion is known in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, pi

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.config import DriveSettings
from drivers.errors import PlantError
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame, Received
from drivers.signals import (
    Command,
    DriveFault,
    DriveMode,
    DriveState,
    Measurement,
    Reaction,
    no_measurement,
)
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.faults import (
    EncoderFreeze,
    EncoderLost,
    EncoderOffset,
    Fault,
    FaultPlan,
    FrameCorruption,
    FrameLoss,
    LegGain,
    Silence,
    StuckBrake,
    WrenchStep,
)
from plant_fmu.drives.nodes import Nodes
from plant_fmu.plant import Truth

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


class Bench:
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
        self.measurement = no_measurement()

    def at(self, t_ns: int, *frames: Frame) -> list[tuple[int, Frame]]:
        """Live until t0 + t_ns, with frames arriving at that instant."""
        t = self.t0 + t_ns
        return self.nodes.step(t, [Received(t, frame) for frame in frames])

    def sync(self, t_ns: int) -> Measurement:
        self.tick += 1
        sent = self.at(t_ns, *self.protocol.sync(self.tick))
        received = [Received(t, frame) for t, frame in sent]
        self.measurement = self.protocol.decode(received, self.tick, self.measurement)
        return self.measurement

    def command(
        self, t_ns: int, mode: DriveMode, force: float | Sequence[float] = 0.0
    ) -> list[tuple[int, Frame]]:
        self.tick += 1
        command = Command(mode, np.array(np.broadcast_to(force, 6), float))
        return self.at(t_ns, *self.protocol.command(command, self.tick))

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


def push(newton: float, **when: float) -> WrenchStep:
    """Push every mass, as gravity does."""
    return WrenchStep(wrench=(newton,) * 6, **when)


# states and brakes


def test_brakes_hold_the_load_from_power_up_to_run():
    bench = Bench(faults=[push(-2000.0)])
    assert bench.states == [DriveState.BOOT] * 6
    bench.at(50 * MS)
    bench.at(51 * MS, *bench.protocol.configure(0.01, Reaction.BRAKE))
    assert bench.states == [DriveState.OFF] * 6
    bench.command(52 * MS, DriveMode.READY, 2000.0)
    bench.at(60 * MS)
    assert bench.states == [DriveState.READY] * 6
    snapshot = bench.nodes.snapshot()
    np.testing.assert_array_equal(snapshot.length, REST)
    assert snapshot.brake.tolist() == [1.0] * 6
    assert snapshot.force.tolist() == [2000.0] * 6


def test_commands_do_nothing_before_configuration():
    bench = Bench()
    for t in range(1, 6):
        bench.command(t * MS, DriveMode.READY if t < 3 else DriveMode.RUN, 100.0)
    bench.command(7 * MS, DriveMode.RESET)
    assert bench.states == [DriveState.BOOT] * 6
    assert bench.brakes == [1.0] * 6


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
    bench = Bench()
    bench.configure()
    for t, mode in enumerate(path):
        bench.command((t + 1) * MS, mode, 10.0)
    assert bench.states == [state] * 6
    assert bench.brakes == [brake] * 6


def test_configuration_is_refused_while_the_force_stage_is_on():
    bench = Bench()
    bench.run()
    bench.at(1 * MS, *bench.protocol.configure(1.0, Reaction.ZERO))
    assert bench.nodes.snapshot().rejected == 6
    bench.at(11 * MS)
    assert bench.states == [DriveState.FAULT] * 6
    assert bench.brakes == [1.0] * 6


# motion and time


def test_a_constant_force_moves_the_legs_as_in_closed_form():
    bench = Bench()
    force = [200.0, -100.0, 50.0, 0.0, 400.0, -300.0]
    bench.run(force)
    for k in range(1, 51):
        bench.command(k * MS, DriveMode.RUN, force)
    a = np.array([1.0, -0.5, 0.25, 0.0, 2.0, -1.5])  # force / 200 kg
    snapshot = bench.nodes.snapshot()
    assert snapshot.t_ns == 50 * MS
    np.testing.assert_allclose(snapshot.length, REST + a * 0.05**2 / 2, rtol=0, atol=1e-13)
    np.testing.assert_allclose(snapshot.rate, a * 0.05, rtol=0, atol=1e-13)


def test_two_plant_steps_per_tick():
    bench = Bench()
    bench.run(100.0)
    bench.plant.calls.clear()
    for k in range(1, 11):
        bench.sync(k * MS + 50 * US)
        bench.command(k * MS + 600 * US, DriveMode.RUN, 100.0)
    assert len(bench.plant.calls) == 20
    assert sum(call[0] for call in bench.plant.calls) == pytest.approx(10.6e-3)


def test_ideal_layout_latches_and_acts_exactly_at_the_tick():
    bench = Bench("ideal", t0_ns=123_456_789_012_345)
    bench.run()
    q, dq = REST.copy(), np.zeros(6)
    for k in range(1, 8):
        force = 100.0 * k
        measurement = bench.sync(k * MS)
        np.testing.assert_allclose(measurement.length, q, rtol=0, atol=1e-15)
        np.testing.assert_allclose(measurement.rate, dq, rtol=0, atol=1e-15)
        bench.command(k * MS, DriveMode.RUN, force)
        q = q + dq * 1e-3 + force / MASS * 1e-6 / 2
        dq = dq + force / MASS * 1e-3


@pytest.mark.parametrize("offset_us", [0, 13, 49, 50, 51, 99])
def test_latch_between_grid_points_errs_by_at_most_an_eighth_a_h_squared(offset_us):
    bench = Bench("ideal")
    a = 10.0
    bench.run(a * MASS)
    t = 5e-3 + offset_us * 1e-6
    measurement = bench.sync(5 * MS + offset_us * US)
    h = bench.plant.internal_step_s
    assert np.abs(measurement.length - REST - a * t**2 / 2).max() <= a * h**2 / 8 + 1e-15
    assert np.abs(measurement.rate - a * t).max() <= a * h / 2 + 1e-15


@pytest.mark.parametrize(("arrival_us", "acts_us"), [(1049, 1000), (1051, 1100), (1000, 1000)])
def test_a_command_acts_at_the_nearest_grid_point(arrival_us, acts_us):
    bench = Bench()
    bench.run()
    bench.command(arrival_us * US, DriveMode.RUN, 200.0)
    bench.at(9 * MS)
    assert bench.nodes.snapshot().rate[0] == pytest.approx(9e-3 - acts_us * 1e-6, abs=1e-12)


def test_the_same_frames_in_one_call_or_many_give_the_same_motion():
    one, many = Bench(), Bench()
    for bench in (one, many):
        bench.run(100.0)
    frames = []
    for k in range(1, 6):
        frames.append(Received(k * MS, one.protocol.sync(k)[0]))
        command = Command(DriveMode.RUN, np.full(6, 50.0 * k))
        frames.append(Received(k * MS + 400 * US, one.protocol.command(command, k + 5)[0]))
    together = one.nodes.step(6 * MS, frames[::-1])
    apart = [sent for frame in frames for sent in many.nodes.step(frame.t_ns, [frame])]
    apart += many.nodes.step(6 * MS, [])
    assert together == apart
    np.testing.assert_allclose(one.nodes.snapshot().length, many.nodes.snapshot().length, rtol=0, atol=1e-15)


def test_start_restores_everything():
    bench = Bench(faults=[FrameLoss(probability=0.5)])

    def live() -> list[tuple[int, Frame]]:
        bench.nodes.start(0)
        bench.tick = 0
        bench.run(100.0)
        return [sent for k in range(1, 30) for sent in bench.at(k * MS, *bench.protocol.sync(k))]

    first = live()
    assert first
    assert first == live()


def test_time_does_not_run_backwards():
    bench = Bench()
    bench.at(5 * MS)
    with pytest.raises(PlantError, match="backwards"):
        bench.at(4 * MS)


# what drives send


def test_feedback_is_queued_at_the_arrival_of_its_sync_with_its_counter():
    bench = Bench()
    bench.tick = 0x1A7
    sent = bench.at(3 * MS + 77 * US, *bench.protocol.sync(bench.tick))
    feedback = [(t, frame) for t, frame in sent if frame.id in bench.protocol.feedback_ids]
    assert [t for t, _ in feedback] == [3 * MS + 77 * US] * 6
    assert [frame.id for _, frame in feedback] == [0x281, 0x282, 0x283, 0x284, 0x285, 0x286]
    measurement = bench.protocol.decode([Received(0, f) for _, f in feedback], 0x1A7, no_measurement())
    assert measurement.age.tolist() == [0] * 6


def test_encoder_reads_whole_quanta():
    bench = Bench("ideal", emulation=DriveEmulation(encoder_resolution_m=1e-3))
    bench.run(1000.0)
    measurement = bench.sync(5 * MS)  # 5 m/s^2 for 5 ms: 0.0625 mm, less than half a quantum
    np.testing.assert_allclose(measurement.length, REST, rtol=0, atol=1e-12)
    for k in range(6, 17):
        bench.command(k * MS, DriveMode.RUN, 1000.0)
    measurement = bench.sync(16 * MS)  # 0.64 mm: more than half
    np.testing.assert_allclose(measurement.length, REST + 1e-3, rtol=0, atol=1e-12)


def test_heartbeats_are_staggered_and_keep_their_period():
    bench = Bench()
    sent = bench.at(350 * MS)
    for node in range(1, 7):
        times = [t for t, frame in sent if frame.id == 0x700 + node]
        first = round((node - 1) * 100 * MS / 6)
        assert times[0] == first
        assert np.abs(np.diff(times) - 100 * MS).max() <= 1
    assert [t for t, _ in sent] == sorted(t for t, _ in sent)


def test_a_change_of_state_is_told_at_once():
    bench = Bench()
    bench.at(5 * MS)
    sent = bench.at(6 * MS, *bench.protocol.configure(0.01, Reaction.BRAKE))
    assert [(t, frame.id, frame.data) for t, frame in sent] == [
        (6 * MS, 0x701 + i, b"\1\0") for i in range(6)
    ]


def test_drives_clip_at_their_limit():
    bench = Bench()
    bench.run(70_000.0)
    snapshot = bench.nodes.snapshot()
    assert snapshot.force.tolist() == [60_000.0] * 6
    assert snapshot.command.tolist() == [70_000.0] * 6
    bench.command(1 * MS, DriveMode.RUN, -70_000.0)
    assert bench.nodes.snapshot().force.tolist() == [-60_000.0] * 6


# watchdog and reactions


@pytest.mark.parametrize("last_us", [0, 3000, 4049, 7777])
def test_watchdog_reacts_within_its_time_and_one_grid_step(last_us):
    bench = Bench()
    bench.run(100.0)
    if last_us:
        bench.command(last_us * US, DriveMode.RUN, 100.0)
    bench.plant.calls.clear()
    started = round(last_us / 100) * 100  # us, the grid point at which the plant stands
    sent = bench.at(30 * MS)
    free = sum(dt for dt, _, brake in bench.plant.calls if brake[0] == 0.0)
    stopped_us = started + free * 1e6
    assert last_us + 10_000 - 50 <= stopped_us <= last_us + 10_000 + 100
    told = [(t, frame.data) for t, frame in sent if frame.id == 0x701 and frame.data[0] == DriveState.FAULT]
    assert told[0] == (last_us * US + 10 * MS, bytes([DriveState.FAULT, DriveFault.WATCHDOG]))


def test_a_command_at_the_last_instant_is_in_time():
    bench = Bench()
    bench.run()
    bench.command(10 * MS, DriveMode.RUN)
    assert bench.states == [DriveState.RUN] * 6
    bench.at(20 * MS + 1)
    assert bench.states == [DriveState.FAULT] * 6


def test_watchdog_runs_in_ready_and_not_in_off():
    bench = Bench()
    bench.configure()
    bench.at(100 * MS)
    assert bench.states == [DriveState.OFF] * 6
    bench.command(100 * MS, DriveMode.READY)
    bench.at(111 * MS)
    assert bench.states == [DriveState.FAULT] * 6


def test_a_repeated_counter_does_not_feed_the_watchdog():
    bench = Bench()
    bench.run()
    frame = bench.protocol.command(Command(DriveMode.RUN, np.full(6, 5.0)), bench.tick)
    for k in range(1, 15):
        bench.at(k * MS, *frame)
    assert bench.states == [DriveState.FAULT] * 6
    snapshot = bench.nodes.snapshot()
    assert (snapshot.repeated, snapshot.commands) == (14, 2)


def test_damaged_commands_do_not_feed_the_watchdog():
    bench = Bench(faults=[FrameCorruption(identifier=0x110, start_s=0.5e-3)])
    bench.run()
    for k in range(1, 15):
        bench.command(k * MS, DriveMode.RUN)
    assert bench.states == [DriveState.FAULT] * 6
    assert bench.nodes.snapshot().rejected == 14


def test_one_lost_command_frame_of_the_classic_layout_stops_its_three_legs():
    bench = Bench("classic", faults=[FrameLoss(identifier=0x101, start_s=0.5e-3)])
    bench.run()
    for k in range(1, 15):
        bench.command(k * MS, DriveMode.RUN)
    assert bench.states == [DriveState.RUN] * 3 + [DriveState.FAULT] * 3


def starve(reaction: Reaction, *, seconds: float, load: float = 0.0) -> tuple[Bench, float]:
    """Accelerate for 10 ms at 10 m/s^2, then silence: 0.1 m/s at the fault."""
    bench = Bench(reaction=reaction, faults=[push(load, start_s=0.01)] if load else [])
    bench.run(10.0 * MASS)
    bench.at(10 * MS + 1)
    assert bench.states == [DriveState.FAULT] * 6
    bench.at(10 * MS + round(seconds * 1e9))
    return bench, 0.5 * 10.0 * 0.01**2


def test_brake_reaction_stops_and_holds_without_force():
    bench, travelled = starve(Reaction.BRAKE, seconds=0.1, load=-2000.0)
    snapshot = bench.nodes.snapshot()
    np.testing.assert_allclose(snapshot.length, REST + travelled, rtol=0, atol=1e-12)
    assert (snapshot.force.tolist(), snapshot.brake.tolist()) == ([0.0] * 6, [1.0] * 6)


def test_zero_reaction_coasts():
    bench, travelled = starve(Reaction.ZERO, seconds=0.1)
    snapshot = bench.nodes.snapshot()
    np.testing.assert_allclose(snapshot.length, REST + travelled + 0.1 * 0.1, rtol=0, atol=1e-12)
    assert (snapshot.force.tolist(), snapshot.brake.tolist()) == ([0.0] * 6, [0.0] * 6)


def test_damp_reaction_brakes_exponentially():
    bench, travelled = starve(Reaction.DAMP, seconds=0.02)
    snapshot = bench.nodes.snapshot()
    # m dv = -c v with c = 20000 N s/m: v = 0.1 exp(-t c/m); the drive samples every 100 us: 1 % of the 10 ms constant
    expected = 0.1 * exp(-0.02 * 20_000 / MASS)
    np.testing.assert_allclose(snapshot.rate, expected, rtol=0.02)
    # (1 - c h / m)^n is what a drive that samples at h gives exactly
    np.testing.assert_allclose(snapshot.rate, 0.1 * (1 - 20_000 * 1e-4 / MASS) ** 200, rtol=1e-9)
    travel = 0.1 * MASS / 20_000 * (1 - exp(-0.02 * 20_000 / MASS))
    np.testing.assert_allclose(snapshot.length, REST + travelled + travel, rtol=0, atol=0.02 * travel)
    assert snapshot.brake.tolist() == [0.0] * 6


def test_hold_reaction_comes_back_to_the_length_of_the_fault_less_the_sag():
    bench, travelled = starve(Reaction.HOLD, seconds=1.0, load=-2000.0)
    snapshot = bench.nodes.snapshot()
    sag = 2000.0 / 2e6
    np.testing.assert_allclose(snapshot.length, REST + travelled - sag, rtol=0, atol=1e-7)
    np.testing.assert_allclose(snapshot.rate, 0.0, atol=1e-6)
    assert snapshot.brake.tolist() == [0.0] * 6


@pytest.mark.parametrize("reaction", list(Reaction))
def test_no_fault_opens_a_closed_brake(reaction):
    for path in ([], [DriveMode.READY]):
        bench = Bench(reaction=reaction, faults=[push(-2000.0)])
        bench.configure()
        for mode in path:
            bench.command(0, mode)
        bench.at(1 * MS, *bench.protocol.emergency_stop())
        bench.at(50 * MS)
        assert bench.states == [DriveState.FAULT] * 6
        np.testing.assert_array_equal(bench.nodes.snapshot().length, REST)


def test_emergency_stop_faults_all_drives_and_latches_until_reset():
    bench = Bench()
    bench.run()
    bench.at(1 * MS, *bench.protocol.emergency_stop())
    assert bench.nodes.snapshot().fault.tolist() == [DriveFault.ESTOP] * 6
    for k, mode in enumerate((DriveMode.OFF, DriveMode.READY, DriveMode.RUN)):
        bench.command((2 + k) * MS, mode)
        assert bench.states == [DriveState.FAULT] * 6
    bench.command(6 * MS, DriveMode.RESET)
    assert bench.states == [DriveState.OFF] * 6
    assert bench.nodes.snapshot().fault.tolist() == [DriveFault.NONE] * 6


@pytest.mark.parametrize("reaction", list(Reaction))
def test_emergency_stop_in_motion_brakes_whatever_the_reaction(reaction):
    bench = Bench(reaction=reaction, faults=[push(-2000.0)])
    bench.run()
    bench.at(1 * MS, *bench.protocol.emergency_stop())
    snapshot = bench.nodes.snapshot()
    assert snapshot.brake.tolist() == [1.0] * 6
    assert not snapshot.force.any()


@pytest.mark.parametrize("reaction", [Reaction.ZERO, Reaction.DAMP, Reaction.HOLD])
def test_emergency_stop_and_off_brake_a_drive_that_reacts_already(reaction):
    for stop in ("estop", "off"):
        bench, _ = starve(reaction, seconds=0.01)
        assert bench.nodes.snapshot().brake.tolist() == [0.0] * 6
        if stop == "estop":
            bench.at(20 * MS, *bench.protocol.emergency_stop())
        else:
            bench.command(20 * MS, DriveMode.OFF)
        snapshot = bench.nodes.snapshot()
        assert snapshot.fault.tolist() == [DriveFault.WATCHDOG] * 6, "the first fault stays latched"
        assert snapshot.brake.tolist() == [1.0] * 6
        assert not snapshot.force.any()


def test_reset_of_a_drive_that_was_never_configured_leads_back_to_boot():
    bench = Bench()
    bench.at(1 * MS, *bench.protocol.emergency_stop())
    assert bench.states == [DriveState.FAULT] * 6
    bench.command(2 * MS, DriveMode.RESET)
    assert bench.states == [DriveState.BOOT] * 6


# force lag


def test_emulated_force_lag_is_of_first_order():
    bandwidth = 50.0
    bench = Bench(emulation=DriveEmulation(encoder_resolution_m=0, force_bandwidth_Hz=bandwidth))
    bench.run(200.0)
    bench.at(9 * MS)
    w, t = 2 * pi * bandwidth, 9e-3
    # 1 m/s^2 behind a lag 1/w: v = t - (1 - exp(-w t)) / w; its mean over each grid step is exact
    np.testing.assert_allclose(bench.nodes.snapshot().rate, t - (1 - exp(-w * t)) / w, rtol=1e-9)


# faults of drives and plant


def test_encoder_slip_shows_in_feedback_and_not_in_the_plant():
    bench = Bench("ideal", faults=[EncoderOffset(leg=2, offset_m=5e-3, start_s=2e-3, stop_s=4e-3)])
    bench.configure()
    seen = [bench.sync(k * MS).length[2] - REST[2] for k in range(1, 6)]
    assert seen == pytest.approx([0, 5e-3, 5e-3, 0, 0], abs=1e-12)
    np.testing.assert_array_equal(bench.nodes.snapshot().length, REST)


def test_frozen_encoder_keeps_its_length_at_rate_zero():
    bench = Bench("ideal", faults=[EncoderFreeze(leg=1, start_s=3e-3)])
    bench.run(10 * MASS)
    measurement = bench.sync(8 * MS)
    assert measurement.length[1] - REST[1] == pytest.approx(0.5 * 10 * 3e-3**2, abs=1e-12)
    assert measurement.rate[1] == 0.0
    assert measurement.length[0] - REST[0] == pytest.approx(0.5 * 10 * 8e-3**2, abs=1e-12)


def test_a_drive_that_lost_its_encoder_says_so_and_still_obeys():
    bench = Bench("ideal", faults=[EncoderLost(leg=1, start_s=3e-3)])
    bench.run(10 * MASS)
    measurement = bench.sync(8 * MS)
    assert measurement.blind.tolist() == [False, True, False, False, False, False]
    assert (measurement.age[1], measurement.state[1], measurement.force[1]) == (1_000_000, 3, 10 * MASS)
    assert bench.nodes.snapshot().length[1] - REST[1] == pytest.approx(0.5 * 10 * 8e-3**2, abs=1e-12)


@pytest.mark.parametrize("reaction", [Reaction.HOLD, Reaction.DAMP])
def test_a_drive_without_its_encoder_brakes_where_its_reaction_needs_one(reaction):
    bench = Bench("ideal", faults=[EncoderLost(leg=1, start_s=3e-3)], reaction=reaction)
    bench.run(10 * MASS)
    bench.at(50 * MS)
    assert bench.nodes.snapshot().fault.tolist() == [DriveFault.WATCHDOG] * 6
    assert bench.nodes.snapshot().brake.tolist() == [0, 1, 0, 0, 0, 0]


def test_swapped_wires_push_the_other_way():
    bench = Bench(faults=[LegGain(leg=4, start_s=0.0)])
    bench.run(200.0)
    bench.at(5 * MS)
    assert bench.nodes.snapshot().rate.tolist() == pytest.approx([5e-3] * 4 + [-5e-3] + [5e-3])


def test_a_silent_drive_is_missed_and_still_obeys():
    bench = Bench(faults=[Silence(leg=3)])
    bench.run(200.0)
    sent = bench.at(5 * MS, *bench.protocol.sync(0))
    assert not {frame.id for _, frame in sent} & {0x284, 0x704}
    assert bench.sync(5 * MS).age.tolist() == [0, 0, 0, 1_000_000, 0, 0]
    assert bench.nodes.snapshot().rate[3] == pytest.approx(5e-3)


def test_stuck_brakes_ignore_the_drive():
    bench = Bench(faults=[StuckBrake(leg=0), StuckBrake(leg=1, engaged=False), push(-200.0)])
    bench.at(1 * MS)
    assert bench.nodes.snapshot().rate.tolist() == pytest.approx([0, -1e-3, 0, 0, 0, 0])
    bench.at(1 * MS, *bench.protocol.configure(0.01, Reaction.BRAKE))
    bench.command(1 * MS, DriveMode.READY)
    bench.command(1 * MS, DriveMode.RUN)
    bench.at(2 * MS)
    assert bench.nodes.snapshot().rate.tolist() == pytest.approx([0, -2e-3, -1e-3, -1e-3, -1e-3, -1e-3])


def test_wrench_acts_from_and_to_its_instants():
    bench = Bench(faults=[push(200.0, start_s=2e-3, stop_s=5e-3)])
    bench.run()
    bench.at(9 * MS)
    assert bench.nodes.snapshot().rate.tolist() == pytest.approx([3e-3] * 6)


def test_lost_feedback_is_lost_at_its_rate():
    bench = Bench(faults=[FrameLoss(identifier=0x283, probability=0.25)])
    bench.configure()
    ages = []
    for k in range(1, 2001):
        bench.tick = k
        ages.append(bench.sync(k * MS).age.tolist())
    lost = np.count_nonzero(ages, axis=0)
    assert lost[[0, 1, 3, 4, 5]].tolist() == [0] * 5
    assert abs(lost[2] - 500) < 5 * (2000 * 0.25 * 0.75) ** 0.5  # five standard deviations


def test_damaged_feedback_is_refused_by_the_controller():
    bench = Bench(faults=[FrameCorruption(identifier=0x286)])
    measurement = bench.sync(1 * MS)
    assert measurement.rejected == 1
    assert measurement.age.tolist() == [0] * 5 + [1_000_000]
