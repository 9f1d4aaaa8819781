"""The pure step: what it sends in each mode, how it latches, and that it is pure."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers.config import WrenchSensorSettings
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.sensor_kernels import NEVER
from drivers.signals import DriveMode, DriveState, Fault, Mode, Stop, Warn
from drivers.tick_columns import copy_of
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, DeviceCommand, EmergencyStop, Status
from hil.loop.ramps import tau_at_rest
from hil.loop.sight import Sight
from hil.robot.kinematics import jacobian, leg_lengths
from hil.signals import Operator, TickInput
from hil.trajectory.path import PoseSample
from tests.drivers.legs_frames import one_feedback, parse
from tests.stories import fault_text

PERIOD_NS = 1_000_000


class Drives:
    """Six drives on locked legs: they obey modes and answer SYNC with fixed lengths."""

    def __init__(self, protocol, length):
        self.protocol, self.length = protocol, length
        self.state = [DriveState.BOOT] * 6
        self.commands, self.configured, self.estops = [], [], 0
        self.silent = set()
        self.rate = 0.0
        self.statuses: list[Frame] = []

    def feedback(self, tick):
        t_ns = tick * PERIOD_NS + 200_000
        statuses, self.statuses = self.statuses, []
        return tuple(Received(t_ns, frame) for frame in statuses) + tuple(
            Received(t_ns, one_feedback(self.protocol, i, l, self.rate, 0.0, s, tick & 15))
            for i, (l, s) in enumerate(zip(self.length, self.state, strict=True))
            if i not in self.silent
        )

    def obey(self, sent):
        reached = {
            DriveMode.OFF: DriveState.OFF,
            DriveMode.READY: DriveState.READY,
            DriveMode.RUN: DriveState.RUN,
            DriveMode.RESET: DriveState.OFF,
        }
        for frame in sent_frames(sent):
            match parse(self.protocol, frame):
                case Configure() as c:
                    self.configured.append(c)
                    self.state[c.leg] = DriveState.OFF
                    self.statuses += reports(self.protocol, Status(c.leg, DriveState.OFF, 0, c))
                case DeviceCommand() as c:
                    self.commands.append(c)
                    latched = () if c.mode == DriveMode.RESET else (DriveState.FAULT,)
                    self.state = [
                        s if s in (DriveState.BOOT, *latched) else reached.get(DriveMode(c.mode), s)
                        for s in self.state
                    ]
                case EmergencyStop():
                    self.estops += 1


class Bench:
    def __init__(self, c=None, cycle=None):
        self.cycle = cycle or build_cycle(c or load("virtual"), 1000.0, 0.01)
        parts = self.cycle.parts
        self.drives = Drives(parts.protocol, leg_lengths(parts.platform, parts.home_p, parts.home_R))
        self.tick = -1

    def step(self, operator=(), frames=None, **changes):
        self.tick += 1
        heard = self.drives.feedback(self.tick) if frames is None else frames
        inp = TickInput(
            tick=self.tick, t_ns=self.tick * PERIOD_NS, lateness_ns=0, skipped=0,
            frames=received_array(heard), sends_failed=0, bus_errors=0, bus_off=False, bus_overflow=0,
            recorder_alive=True, recorder_dropped=0, operator=operator, compute_ns=0,
        )._replace(**changes)  # fmt: skip
        out = self.cycle.step(inp)
        self.drives.obey(out.frames)
        return out

    def until(self, mode, limit=2000):
        operator: tuple[Operator, ...] = (Operator.RESET,)
        for _ in range(limit):
            out = self.step(operator)
            operator = (Operator.ENGAGE,) if self.cycle.mode is Mode.IDLE else ()
            if self.cycle.mode is mode:
                return out
        raise AssertionError(f"{mode} not reached, but {self.cycle.mode}")


@contextmanager
def held_to(bench, **limits):
    """Let safety judge by other limits for a while: what they forbid is a fault."""
    own = bench.cycle.parts.safety.limits
    before = {name: own[name].item() for name in limits}
    for name, value in limits.items():
        own[name] = value
    yield
    for name, value in before.items():
        own[name] = value


@pytest.fixture
def bench():
    return Bench()


def test_sets_up_one_booting_drive_a_tick_and_those_that_confirm_it_no_more(bench):
    sizes = [len(bench.step().frames) for _ in range(100)]
    assert sizes == [2] * 6 + [1] * 94
    assert [c.leg for c in bench.drives.configured] == [*range(6)]
    assert {c.watchdog_s for c in bench.drives.configured} == {0.01}
    assert bench.cycle.mode is Mode.IDLE


def test_asks_for_no_force_and_closed_brakes_until_engaged(bench):
    for _ in range(100):
        bench.step()
    assert {c.mode for c in bench.drives.commands} == {DriveMode.OFF}
    assert all(not any(c.force) for c in bench.drives.commands)


def test_force_is_built_up_against_closed_brakes_to_what_holds_the_platform(bench):
    bench.until(Mode.RELEASING)
    ready = [c for c in bench.drives.commands if c.mode == DriveMode.READY]
    assert np.abs(np.diff([c.force for c in ready], axis=0)).max() < 30.0
    # static leg force of the book's platform at home: 3618.625746 N, confirmed by independent engines
    np.testing.assert_allclose(bench.drives.commands[-1].force, 3618.625746, atol=0.05)


def test_the_step_is_pure(bench):
    other = Bench()
    for _ in range(1500):
        operator = (Operator.ENGAGE,) if bench.cycle.mode is Mode.IDLE else ()
        a, b = bench.step(operator), other.step(operator)
        assert a.frames.tobytes() == b.frames.tobytes()
        assert a.row.tobytes() == b.row.tobytes()
    assert bench.cycle.mode is not Mode.IDLE


def test_reset_goes_back_to_the_first_tick(bench):
    fresh, again = Bench(), Bench()
    bench.until(Mode.APPROACH)
    bench.step(bus_off=True)
    operating = bench.cycle.operating
    operating.speed, operating.key_tick = 0.3, bench.tick
    bench.cycle.reset()
    assert (operating.speed, operating.key_tick) == (1.0, None)
    assert bench.cycle.proven
    assert not bench.cycle.faults
    again.cycle = bench.cycle
    for _ in range(30):
        a, b = fresh.step(), again.step()
        assert a.frames.tobytes() == b.frames.tobytes()
        assert a.row.tobytes() == b.row.tobytes()


def test_a_silent_leg_is_carried_on_at_its_last_rate_then_faults(bench):
    bench.until(Mode.APPROACH)
    bench.drives.rate = 0.01
    bench.step()
    length = bench.drives.length[2]
    bench.drives.silent = {2}
    ages, carried, warned = [], [], []
    while bench.cycle.mode is Mode.APPROACH:
        row = bench.step().row
        ages.append(int(row["age"][2]))
        carried.append(float(row["q"][2]) - length)
        warned.append(bool(int(row["warnings"]) & Warn.STALE))
    assert ages == [1, 2, 3, 4, 5]
    np.testing.assert_allclose(carried, 0.01e-3 * np.array(ages), atol=1e-7)
    assert warned == [False, True, True, True, True]
    assert bench.cycle.faults == Fault.STALE
    assert bench.cycle.mode is Mode.HELD
    assert bench.drives.commands[-1].mode == DriveMode.READY, "the brakes shut, and the force stays on"
    assert fault_text(bench.cycle) == (
        "latched fault STALE (leg 2 not heard for 5 ticks, limits.stale_fault_ticks is 5)"
    )


def test_legs_that_are_silent_together_are_called_a_stall_with_what_to_change(bench):
    bench.until(Mode.APPROACH)
    bench.drives.silent = set(range(6))
    while bench.cycle.mode is Mode.APPROACH:
        bench.step()
    text = fault_text(bench.cycle)
    assert "no leg heard for 5 ticks" in text
    assert "stalled for 5 ms by then" in text
    assert "loop.rate_Hz" in text


def test_a_fault_latches_through_engage_and_leaves_by_reset(bench):
    bench.until(Mode.APPROACH)
    bench.step(bus_off=True)
    assert bench.cycle.mode is Mode.FAULT
    for _ in range(50):
        bench.step((Operator.ENGAGE,))
    assert bench.cycle.mode is Mode.FAULT
    assert bench.cycle.faults & Fault.BUS
    assert {c.mode for c in bench.drives.commands[-50:]} == {DriveMode.OFF}
    bench.step((Operator.RESET,))
    assert bench.cycle.faults == Fault.NONE
    bench.until(Mode.APPROACH)


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.LOADING, Mode.TRACKING])
def test_a_reset_does_nothing_where_no_fault_is_latched(mode):
    said, unsaid = Bench(), Bench()
    for bench in (said, unsaid):
        bench.until(mode)
    for _ in range(30):
        a, b = said.step((Operator.RESET,)), unsaid.step()
        assert a.frames.tobytes() == b.frames.tobytes()
        assert a.row.tobytes() == b.row.tobytes()


def test_no_force_is_sent_any_more_in_the_tick_of_a_fault_that_switches_the_drives_off(bench):
    bench.until(Mode.APPROACH)
    assert min(bench.drives.commands[-1].force) > 3000.0
    row = bench.step(bus_off=True).row
    assert bench.drives.commands[-1].mode == DriveMode.OFF
    assert not np.any(bench.drives.commands[-1].force)
    assert not row["tau"].any()


def test_a_reset_forgets_who_was_refused_and_the_stop_that_was_asked_for(bench):
    bench.until(Mode.APPROACH)
    bench.step(bus_off=True)
    bench.cycle.obedience.refused = 2
    bench.cycle.stop_requested = Stop.MISSED
    bench.step((Operator.RESET,))
    assert bench.cycle.obedience.refused is None
    bench.until(Mode.APPROACH)
    assert bench.step().row["legs_refused"] == 0


def test_of_several_stops_that_safety_asks_for_the_first_one_is_kept(bench):
    bench.until(Mode.APPROACH)
    with held_to(bench, stop_on_recorder_loss=1):
        for changes in ({"recorder_alive": False}, {"skipped": 1000}, {}):
            bench.step(**changes)
            assert bench.cycle.stop_requested is Stop.RECORDER
    assert bench.cycle.mode is Mode.STOPPING


def without_brake_test():
    c = load("virtual")
    engage = c.engage.model_copy(update={"force_ramp_s": 0.0})
    return Bench(c.model_copy(update={"engage": engage}))


def test_without_a_ramp_the_law_begins_anew_and_no_brake_counts_as_proven_to_the_end(monkeypatch):
    bench, begun = without_brake_test(), []
    monkeypatch.setattr(bench.cycle.parts.law, "reset", lambda: begun.append(bench.tick))
    bench.cycle.effort.offset = np.full(6, 500.0)
    assert bench.cycle.proven
    bench.until(Mode.TRACKING)
    assert begun[-1] == bench.tick
    assert not bench.cycle.proven
    assert not bench.cycle.effort.offset.any()
    bench.step((Operator.STOP,))
    while bench.cycle.mode is not Mode.PARKED:
        bench.step()
        assert bench.tick < 5000
    assert not bench.cycle.proven


def test_a_fault_that_strikes_while_parking_leaves_what_holds_the_platform_alone(bench):
    bench.until(Mode.APPROACH)
    bench.step((Operator.STOP,))
    while bench.cycle.mode is not Mode.PARKING:
        bench.step()
        assert bench.tick < 5000
    assert not bench.cycle.faults
    assert not bench.cycle._under_control & Fault.FOLLOWING
    with held_to(bench, following_error_m=-1.0):
        bench.step()
    assert bench.cycle.mode is Mode.PARKING
    bench.drives.length = bench.drives.length + 5e-6  # a law would push back
    for _ in range(5):
        bench.step()
        assert bench.cycle.mode is Mode.PARKING
        np.testing.assert_allclose(bench.cycle.tick["tau_asked"], 3618.625746, atol=0.05)


@pytest.mark.parametrize(
    ("fault", "provable"),
    [
        (Fault.DRIVE, True),
        (Fault.STALE, True),  # heard again
        (Fault.BRAKE, False),
        (Fault.ENCODER, False),
        (Fault.KINEMATICS, False),
        (Fault.DUPLICATE_NODE, False),
    ],
)
def test_no_test_of_the_brakes_is_believed_after_a_brake_or_an_encoder_has_failed(bench, fault, provable):
    bench.until(Mode.APPROACH)
    bench.cycle.faults = fault
    assert bench.cycle._provable(bench.cycle.tick) == provable


def test_a_leg_that_is_refused_its_force_gets_none_from_that_tick_on(monkeypatch):
    c = load("virtual")
    gentle = {"force_step_N": 200.0}  # which a force that comes or goes at once is not held to
    bench = Bench(c.model_copy(update={"limits": c.limits.model_copy(update=gentle)}))
    bench.until(Mode.APPROACH)
    with held_to(bench, following_error_m=-1.0):
        bench.step()
    assert bench.cycle.mode is Mode.PARKING
    watch = bench.cycle.obedience

    def refuse(_tick, _tau):
        news, watch.refused = watch.refused is None, 2
        return news

    monkeypatch.setattr(watch, "watch", refuse)
    for _ in range(3):
        row = bench.step().row
        force = bench.drives.commands[-1].force
        assert force[2] == 0.0
        assert min(np.delete(force, 2)) > 3000.0
        assert row["legs_refused"] == 1 << 2
        assert row["faults"] == Fault.DRIVE | Fault.FOLLOWING
    assert bench.cycle.faults & Fault.DRIVE


def test_a_stop_after_a_run_that_yielded_parks_by_its_law_again(bench):
    bench.until(Mode.APPROACH)
    bench.cycle._yields = True
    bench.step((Operator.STOP,))
    while bench.cycle.mode is not Mode.PARKING:
        bench.step()
        assert bench.tick < 5000
    assert not bench.cycle._yields


def test_a_reset_with_a_fused_pose_looks_for_it_where_it_was_and_not_at_home():
    c = load("virtual")
    bench = Bench(c.model_copy(update={"estimation": c.estimation.model_copy(update={"pose": "fused"})}))
    parts = bench.cycle.parts
    for _ in range(100):
        bench.step()
    aside = parts.home_p + np.array([0.05, -0.03, 0.02])
    for share in np.linspace(0.0, 1.0, 500):
        p = parts.home_p + share * (aside - parts.home_p)
        bench.drives.length = leg_lengths(parts.platform, p, parts.home_R)
        bench.step()
    for _ in range(100):
        row = bench.step().row
    np.testing.assert_allclose(row["p"], aside, atol=1e-5)
    bench.step((Operator.ESTOP,))
    while bench.tick % 20 != 3:  # before the tick at which the legs are asked
        row = bench.step((Operator.RESET,)).row
    assert not bench.cycle.sight.fusing
    np.testing.assert_allclose(row["p"], aside, atol=1e-5)
    for _ in range(50):
        row = bench.step().row
    assert bench.cycle.sight.fusing
    np.testing.assert_allclose(row["p"], aside, atol=1e-5)


def test_a_reset_forgets_the_load_of_a_sensor_that_fell_silent():
    c = load("virtual")
    sensors = c.sensors.model_copy(update={"wrench": WrenchSensorSettings(rate_Hz=100.0)})
    source = c.estimation.wrench.model_copy(update={"source": "sensor"})
    estimation = c.estimation.model_copy(update={"wrench": source})
    bench = Bench(c.model_copy(update={"sensors": sensors, "estimation": estimation}))
    protocol = bench.cycle.parts.sensors
    assert protocol is not None
    sample = protocol.encode("wrench", (100.0, 0, -300.0, 0, 20.0, 0), 0, 0.0, 0)
    said = (*bench.drives.feedback(0), Received(300_000, sample))
    row = bench.step(frames=said).row
    np.testing.assert_allclose(row["wrench"], [100.0, 0, -300.0, 0, 20.0, 0])
    for _ in range(100):
        row = bench.step().row
    np.testing.assert_allclose(row["wrench"], [100.0, 0, -300.0, 0, 20.0, 0])
    assert int(row["warnings"]) & Warn.SENSOR
    bench.step((Operator.ESTOP,))
    bench.step((Operator.RESET,))
    row = bench.step().row
    assert not row["wrench"].any()
    assert int(row["warnings"]) & Warn.SENSOR


def test_an_emergency_stop_goes_to_the_wire_first(bench):
    bench.until(Mode.APPROACH)
    out = bench.step((Operator.ESTOP,))
    assert isinstance(parse(bench.cycle.parts.protocol, sent_frames(out.frames)[0]), EmergencyStop)
    assert bench.cycle.faults & Fault.ESTOP
    assert bench.drives.commands[-1].mode == DriveMode.OFF


def test_a_drive_in_fault_faults_the_controller(bench):
    bench.until(Mode.APPROACH)
    bench.drives.state[4] = DriveState.FAULT
    bench.step()
    assert bench.cycle.mode is Mode.PARKING
    assert bench.cycle.faults & Fault.DRIVE


def test_one_changed_bit_of_a_feedback_is_refused_and_the_leg_goes_stale(bench):
    bench.until(Mode.APPROACH)
    frames = list(bench.drives.feedback(bench.tick + 1))
    t_ns, frame = frames[3]
    data = bytearray(frame.data)
    data[1] ^= 4
    frames[3] = Received(t_ns, frame._replace(data=bytes(data)))
    row = bench.step(frames=tuple(frames)).row
    assert row["rejected"] == 1
    assert row["age"].tolist() == [0, 0, 0, 1, 0, 0]
    assert int(row["warnings"]) & Warn.REJECTED


def test_drives_that_stayed_powered_are_set_up_anew(bench):
    bench.drives.state = [DriveState.OFF] * 6
    bench.until(Mode.IDLE)
    assert sorted(c.leg for c in bench.drives.configured) == [*range(6)]


def test_the_operators_reset_sets_up_every_drive_anew(bench):
    bench.until(Mode.IDLE)
    assert len(bench.drives.configured) == 6
    bench.step((Operator.ESTOP,))
    bench.step((Operator.RESET,))
    bench.until(Mode.IDLE)
    assert {c.leg for c in bench.drives.configured[6:]} == {*range(6)}


def test_what_came_before_the_loop_woke_up_is_no_answer_to_its_sync(bench):
    bench.until(Mode.IDLE)
    late = bench.step(lateness_ns=199_999).row
    assert (late["age"].tolist(), late["rejected"]) == ([0] * 6, 0)
    later = bench.step(lateness_ns=200_001).row
    assert (later["age"].tolist(), later["rejected"]) == ([1] * 6, 6)


def test_reset_is_sent_a_few_times_only_so_that_a_standing_fault_stays(bench):
    bench.drives.state = [DriveState.FAULT] * 6
    for tick in range(200):
        bench.step((Operator.RESET,) if tick == 3 else ())
        bench.drives.state = [DriveState.FAULT] * 6
    modes = [c.mode for c in bench.drives.commands]
    assert modes.count(DriveMode.RESET) == 5
    assert modes[-1] == DriveMode.OFF
    assert bench.cycle.mode is Mode.WAITING


def test_the_force_stays_on_while_one_brake_does_not_shut_and_then_it_is_a_fault(bench):
    bench.until(Mode.APPROACH)
    stuck = bench.drives.state
    bench.step((Operator.STOP,))
    while bench.cycle.mode is not Mode.HELD:
        if bench.cycle.mode is Mode.PARKING:
            bench.drives.state = [*stuck[:5], DriveState.RUN]
        bench.step()
        assert min(bench.drives.commands[-1].force) > 3000.0
        assert bench.tick < 5000
    assert bench.cycle.faults == Fault.DRIVE
    for _ in range(100):
        bench.step()
        assert min(bench.drives.commands[-1].force) > 3000.0
        assert bench.drives.commands[-1].mode == DriveMode.READY


@pytest.mark.parametrize(
    ("mode", "stuck", "leads"),
    [(Mode.LOADING, DriveState.OFF, Mode.FAULT), (Mode.RELEASING, DriveState.READY, Mode.PARKING)],
)
def test_a_drive_that_does_not_follow_is_a_fault_after_a_second(bench, mode, stuck, leads):
    bench.until(mode)
    entered = bench.tick
    while bench.cycle.mode is mode:
        bench.drives.state[1] = stuck
        bench.step()
        assert bench.tick < 5000
    assert bench.cycle.mode is leads
    assert bench.cycle.faults & Fault.DRIVE
    assert 1000 < bench.tick - entered < 1700


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.STOPPING])
def test_legs_that_do_not_come_to_rest_are_a_fault_and_not_a_stop_for_ever(bench, mode):
    bench.until(Mode.APPROACH)
    bench.step((Operator.STOP,) * (mode is Mode.STOPPING))
    begun, duration_s = bench.tick, bench.cycle.motion.trajectory.duration_s
    while bench.cycle.mode is mode:
        bench.drives.rate = 0.021 if bench.tick % 2 else -0.021
        bench.step()
        assert bench.tick < 5000
    assert bench.cycle.mode is Mode.PARKING
    assert bench.cycle.faults == Fault.FOLLOWING
    assert duration_s is not None
    assert (bench.tick - begun) * 1e-3 == pytest.approx(duration_s + 1.0, abs=0.1)


def test_faults_that_the_drives_have_latched_are_not_cleared_unasked(bench):
    bench.drives.state = [DriveState.OFF] * 5 + [DriveState.FAULT]
    for _ in range(300):
        bench.step((Operator.ENGAGE,))
        bench.drives.state = [DriveState.OFF] * 5 + [DriveState.FAULT]
    assert bench.cycle.mode is Mode.WAITING
    assert {c.mode for c in bench.drives.commands} == {DriveMode.OFF}


def test_the_sight_of_a_new_controller_has_found_no_pose_heard_no_sensor_and_stands_at_home():
    parts = build_cycle(load("virtual"), 1000.0, 0.01).parts
    sight = Sight(parts)
    assert (sight.located, sight.fusing) == (False, False)
    assert (sight.sensors["counter"] == NEVER).all()
    np.testing.assert_array_equal(sight.estimator.p, parts.home_p)
    np.testing.assert_array_equal(sight.estimator.R, parts.home_R)


def test_the_force_asked_for_where_the_platform_counts_as_on_the_sample_is_what_holds_it_there():
    """The book's static force at home, wherever the platform was measured, and however fast."""
    cycle = build_cycle(load("virtual"), 1000.0, 0.01)
    parts, tick = cycle.parts, copy_of(cycle.tick)
    home = PoseSample(parts.home_p, parts.home_R, np.zeros(6), np.zeros(6))
    tick["J"] = jacobian(parts.platform, parts.home_p, parts.home_R)
    off = parts.home_p + np.array([5e-3, 0.0, -5e-3])
    tick["p"], tick["R"] = off, parts.home_R
    tick["q"] = leg_lengths(parts.platform, off, parts.home_R)
    tick["dq"] = tick["twist"] = np.full(6, 0.1)
    held = json.loads((Path(__file__).parents[1] / "data/book_platform.json").read_text())["home_static"][
        "force"
    ]
    on_it, measured = (
        tau_at_rest(parts.law, parts.platform, tick, home, on_it=on_it) for on_it in (True, False)
    )
    np.testing.assert_allclose(on_it, held, rtol=1e-6)
    assert np.abs(measured - held).max() > 100.0
