"""The pure step: its commands in each mode, its use of feedback, and its purity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.frame_array import sent_frames
from drivers.protocol import Received
from drivers.signals import DriveMode, DriveState, Fault, Mode, Stop, Warn
from hil.contracts.messages import EmergencyStop
from hil.loop.cycle import Cycle
from hil.signals import Operator
from tests.drivers.legs_frames import parse
from tests.hil.cycle_bench import HOLDING_N, Bench, a_bench, fault_text, held_to


@pytest.fixture
def bench():
    return Bench()


# -- before the platform is armed


def test_each_booting_drive_is_set_up_once_one_drive_per_tick(bench):
    sizes = [len(bench.step().frames) for _ in range(100)]
    assert sizes == [2] * 6 + [1] * 94
    assert [c.leg for c in bench.drives.configured] == [*range(6)]
    assert {c.watchdog_s for c in bench.drives.configured} == {0.01}
    assert bench.cycle.mode is Mode.IDLE
    assert {c.mode for c in bench.drives.commands} == {DriveMode.OFF}
    assert all(not any(c.force) for c in bench.drives.commands)


def test_drives_are_set_up_again_at_start_and_after_a_reset(bench):
    bench.drives.state = [DriveState.OFF] * 6
    bench.until(Mode.IDLE)
    assert sorted(c.leg for c in bench.drives.configured) == [*range(6)]
    bench.step((Operator.ESTOP,))
    bench.step((Operator.RESET,))
    bench.until(Mode.IDLE)
    assert {c.leg for c in bench.drives.configured[6:]} == {*range(6)}


def test_latched_drive_faults_are_cleared_only_on_request_for_a_few_ticks(bench):
    for tick in range(300):
        bench.drives.state = [DriveState.OFF] * 5 + [DriveState.FAULT]
        bench.step((Operator.RESET,) if tick == 100 else (Operator.ENGAGE,))
    modes = [c.mode for c in bench.drives.commands]
    assert set(modes[:100]) == {DriveMode.OFF}
    assert modes.count(DriveMode.RESET) == 5
    assert modes[-1] == DriveMode.OFF
    assert bench.cycle.mode is Mode.WAITING


# -- the step


def test_force_ramps_up_to_the_holding_force_against_closed_brakes(bench):
    bench.until(Mode.RELEASING)
    ready = [c for c in bench.drives.commands if c.mode == DriveMode.READY]
    assert np.abs(np.diff([c.force for c in ready], axis=0)).max() < 30.0
    np.testing.assert_allclose(bench.force, HOLDING_N, atol=0.05)


def test_controller_step_gives_equal_frames_and_rows_for_equal_inputs(bench):
    other = Bench()
    for _ in range(1500):
        operator = (Operator.ENGAGE,) if bench.cycle.mode is Mode.IDLE else ()
        a, b = bench.step(operator), other.step(operator)
        assert a.frames.tobytes() == b.frames.tobytes()
        assert a.row.tobytes() == b.row.tobytes()
    assert bench.cycle.mode is not Mode.IDLE


def test_a_reset_of_the_cycle_restores_its_initial_state(bench):
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


def test_feedback_with_a_flipped_bit_is_rejected_and_its_leg_is_stale(bench):
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


def test_a_frame_from_before_the_wake_up_does_not_answer_its_sync(bench):
    bench.until(Mode.IDLE)
    for lateness_ns, age, rejected in ((199_999, 0, 0), (200_001, 1, 6)):
        row = bench.step(lateness_ns=lateness_ns).row
        assert (row["age"].tolist(), row["rejected"]) == ([age] * 6, rejected)


# -- faults


def test_a_silent_leg_is_extrapolated_at_its_last_rate_then_faults(bench):
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
    assert warned == [True, True, True, True, True]
    assert (bench.cycle.faults, bench.cycle.mode) == (Fault.STALE, Mode.HELD)
    assert bench.drives.commands[-1].mode == DriveMode.READY, "the brakes shut, and the force stays on"
    assert "leg 2" in fault_text(bench.cycle)


@pytest.mark.parametrize(("silent", "mode"), [(range(5), Mode.HELD), (range(6), Mode.FAULT)], ids=str)
def test_force_stays_on_until_all_drives_are_silent_for_a_second(silent, mode):
    bench = a_bench()
    bench.until(Mode.APPROACH)
    bench.drives.silent = set(silent)
    modes = []
    for _ in range(1200):
        bench.step()
        modes.append(bench.cycle.mode)
    assert set(modes[5:950]) == {Mode.HELD}
    assert set(modes[1005:]) == {mode}
    sent = DriveMode.READY if mode is Mode.HELD else DriveMode.OFF
    assert bench.drives.commands[-1].mode == sent
    assert (bench.force.min() > 3000.0) == (mode is Mode.HELD)


def test_a_fault_stays_latched_through_engage_and_is_cleared_by_reset(bench):
    bench.until(Mode.APPROACH)
    assert bench.force.min() > 3000.0
    row = bench.step(bus_off=True).row
    assert (Mode(int(row["mode"])), Fault(int(row["faults"]))) == (Mode.FAULT, Fault.BUS)
    assert not bench.force.any(), "the force must be zero in the tick of the fault"
    assert not row["tau"].any()
    for _ in range(50):
        bench.step((Operator.ENGAGE,))
    assert (bench.cycle.mode, bench.cycle.faults) == (Mode.FAULT, Fault.BUS)
    assert {c.mode for c in bench.drives.commands[-51:]} == {DriveMode.OFF}
    bench.step((Operator.RESET,))
    assert bench.cycle.faults == Fault.NONE
    bench.until(Mode.APPROACH)


def test_an_emergency_stop_is_the_first_frame_sent(bench):
    bench.until(Mode.APPROACH)
    out = bench.step((Operator.ESTOP,))
    assert isinstance(parse(bench.cycle.parts.protocol, sent_frames(out.frames)[0]), EmergencyStop)
    assert bench.cycle.faults & Fault.ESTOP
    assert bench.drives.commands[-1].mode == DriveMode.OFF


@pytest.mark.parametrize(
    ("rivals", "latches", "sent"),
    [(False, False, [1, 0, 0, 0]), (False, True, [1, 1, 1, 1]), (True, False, [1, 1, 1, 1])],
)
def test_estop_repeats_if_drives_latch_it_or_obey_a_second_controller(monkeypatch, rivals, latches, sent):
    """Otherwise drives stay in RUN whatever is sent, and OFF is the stop."""
    bench = a_bench()
    protocol = bench.cycle.parts.protocol
    monkeypatch.setattr(protocol, "traits", replace(protocol.traits, stop_latches=latches))
    bench.until(Mode.APPROACH)
    found: list[int] = []
    for _ in range(4):
        if rivals:
            bench.cycle.faults |= Fault.SECOND_CONTROLLER
        before = bench.drives.estops
        bench.step((Operator.ESTOP,) * (not found))
        found.append(bench.drives.estops - before)
        bench.drives.state = [DriveState.RUN] * 6
    assert found == sent
    assert bench.drives.commands[-1].mode == DriveMode.OFF


@pytest.mark.parametrize(
    ("mode", "stuck", "leads"),
    [(Mode.LOADING, DriveState.OFF, Mode.FAULT), (Mode.RELEASING, DriveState.READY, Mode.PARKING)],
)
def test_a_drive_that_does_not_change_state_is_a_fault_after_a_second(bench, mode, stuck, leads):
    bench.until(mode)
    entered = bench.tick
    while bench.cycle.mode is mode:
        bench.drives.state[1] = stuck
        bench.step()
        assert bench.tick < 5000
    assert bench.cycle.mode is leads
    assert bench.cycle.faults & Fault.DRIVE
    assert 1000 < bench.tick - entered < 1700


def test_force_stays_on_if_a_brake_does_not_engage_which_is_a_fault(bench):
    bench.until(Mode.APPROACH)
    stuck = bench.drives.state
    bench.step((Operator.STOP,))
    while bench.cycle.mode is not Mode.HELD:
        if bench.cycle.mode is Mode.PARKING:
            bench.drives.state = [*stuck[:5], DriveState.RUN]
        bench.step()
        assert bench.force.min() > 3000.0
        assert bench.tick < 5000
    assert bench.cycle.faults == Fault.DRIVE
    for _ in range(100):
        bench.step()
        assert bench.force.min() > 3000.0
        assert bench.drives.commands[-1].mode == DriveMode.READY


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.STOPPING])
def test_legs_that_never_come_to_rest_are_a_fault_after_a_second(bench, mode):
    bench.until(Mode.APPROACH)
    bench.step((Operator.STOP,) * (mode is Mode.STOPPING))
    begun, duration_s = bench.tick, bench.cycle.motion.trajectory.duration_s
    while bench.cycle.mode is mode:
        bench.drives.rate = 0.021 if bench.tick % 2 else -0.021
        bench.step()
        assert bench.tick < 5000
    assert (bench.cycle.mode, bench.cycle.faults) == (Mode.PARKING, Fault.FOLLOWING)
    assert duration_s is not None
    assert (bench.tick - begun) * 1e-3 == pytest.approx(duration_s + 1.0, abs=0.1)


def test_a_fault_while_parking_keeps_the_holding_force(bench):
    bench.stopped(Mode.PARKING)
    assert not bench.cycle.faults
    with held_to(bench, following_error_m=-1.0):
        bench.step()
    bench.drives.length = bench.drives.length + 5e-6  # a law would push back
    for _ in range(5):
        bench.step()
        assert bench.cycle.mode is Mode.PARKING
        np.testing.assert_allclose(bench.cycle.tick["tau_asked"], HOLDING_N, atol=0.05)


class Failing:
    """A law that raises an error from tick 100 on."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def reset(self) -> None:
        """Nothing to reset."""

    def effort(self, tick) -> None:
        if tick["tick"] >= 100:
            raise self.error
        tick["tau_law"] = 0.0


def test_an_exception_of_the_law_is_a_latched_fault():
    error = ZeroDivisionError("a defect")
    bench = Bench(cycle=Cycle(replace(a_bench().cycle.parts, law=Failing(error))))
    bench.until(Mode.IDLE)
    bench.step((Operator.ENGAGE,))
    while not bench.cycle.faults:
        assert bench.tick < 1000
        bench.step()
    assert bench.cycle.faults == Fault.LAW
    assert bench.cycle.effort.law.keeps.raised is error
    assert np.isnan(bench.cycle.tick["tau_law"]).all()


def test_ctrl_c_in_a_law_ends_its_step():
    bench = Bench(cycle=Cycle(replace(a_bench().cycle.parts, law=Failing(KeyboardInterrupt()))))
    with pytest.raises(KeyboardInterrupt):
        bench.until(Mode.TRACKING)
    bench.cycle.reset()
    bench.step()
    assert bench.cycle.mode is Mode.WAITING


def test_the_first_of_several_stops_requested_by_safety_is_kept(bench):
    bench.until(Mode.APPROACH)
    with held_to(bench, stop_on_recorder_loss=1):
        for changes in ({"recorder_alive": False}, {"skipped": 1000}, {}):
            bench.step(**changes)
            assert bench.cycle.stop_requested is Stop.RECORDER
    assert bench.cycle.mode is Mode.STOPPING
