"""Decisions of a tick: effects of RESET, transitions, reactions to faults, commands to drives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.frame_array import sent_array, sent_frames
from drivers.protocol import Frame
from drivers.signals import DriveMode, DriveState, Fault, Mode, Stop, Warn
from hil.app.compose import build_cycle
from hil.loop import cycle as cycle_module
from hil.loop.cycle import Cycle
from hil.loop.modes import CONTROLLED
from hil.safety.guard import Verdict
from hil.signals import Operator
from tests.hil.cycle_bench import LAST, VIRTUAL, Bench, measured, said
from tests.hil.test_modes import FOLLOW, UNSEEN

MOVING = {Mode.APPROACH, Mode.TRACKING, Mode.STOPPING}


@pytest.fixture(scope="module")
def made() -> Cycle:
    return build_cycle(VIRTUAL, 1000.0, 0.01)


@pytest.fixture(scope="module")
def staying() -> Cycle:
    stays = VIRTUAL.operator.model_copy(update={"stays": True})
    return build_cycle(VIRTUAL.model_copy(update={"operator": stays}), 1000.0, 0.01)


@pytest.fixture
def cycle(made: Cycle) -> Cycle:
    made.reset()
    return made


# -- RESET


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("stays", [False, True])
def test_a_reset_clears_latched_state_only_in_fault_waiting_or_parked(
    made, staying, monkeypatch, mode, stays
):
    cycle, forgot = staying if stays else made, list[str]()
    cycle.reset()
    parts = cycle.parts
    for name, owner in (("forget", cycle.sight), ("reset", cycle.obedience), ("forget", parts.wrench)):
        monkeypatch.setattr(owner, name, lambda owner=owner: forgot.append(type(owner).__name__))
    parts.safety.memory["stretched_ns"] = parts.safety.memory["refused"] = 9
    monkeypatch.setattr(cycle_module, "next_mode", lambda mode, *_: mode)
    cycle.mode, cycle.mode_tick, cycle.estop, cycle.stop_requested = mode, 50, True, Stop.MISSED
    cycle.faults, fresh = Fault.DRIVE, cycle.end.remembered()
    cycle.end.remember(parts.protocol.controller_end(parts.setup._replace(watchdog_s=0.5)).remembered())
    cycle._change_mode(said(Operator.RELEASE), measured(cycle))
    assert not forgot
    cycle._change_mode(said(Operator.STOP, Operator.RESET), measured(cycle))
    clears = mode in {Mode.FAULT, Mode.WAITING} or (stays and mode is Mode.PARKED)
    assert len(forgot) == 3 * clears
    assert [int(parts.safety.memory[name]) for name in ("stretched_ns", "refused")] == [9 * (not clears)] * 2
    latched = (Fault.NONE, False, Stop.NONE) if clears else (Fault.DRIVE, True, Stop.MISSED)
    assert (cycle.faults, cycle.estop, cycle.stop_requested) == latched
    assert cycle.reset_tick == (50 if clears else None)
    assert (cycle.end.remembered() == fresh) == clears


# -- what a transition needs


def facts_of(cycle: Cycle, monkeypatch: pytest.MonkeyPatch, tick: Any) -> Any:
    """Facts from which the transition table chooses the mode."""
    found: list[Any] = []
    monkeypatch.setattr(cycle_module, "next_mode", lambda mode, facts, _: found.append(facts) or mode)  # type: ignore[func-returns-value]
    cycle._change_mode(said(), tick)
    (facts,) = found
    return facts


@pytest.mark.parametrize("lacks", ["", "turns", "set-up", "pose"])
@pytest.mark.parametrize("mode", [Mode.WAITING, Mode.IDLE, Mode.PARKED])
def test_arming_needs_known_motor_turns_configured_drives_and_a_known_pose(cycle, monkeypatch, mode, lacks):
    cycle.mode = mode
    cycle.sight.located = lacks != "pose"
    monkeypatch.setattr(type(cycle.homing), "known", lacks != "turns")
    monkeypatch.setattr(cycle.end, "legs_set_up", lambda: [lacks != "set-up"] * 6)
    needed = {Mode.WAITING: {"turns", "set-up", "pose"}, Mode.IDLE: {"turns", "set-up"}}
    ready = facts_of(cycle, monkeypatch, measured(cycle)).ready
    assert ready == (mode in needed and lacks not in needed[mode])


@pytest.mark.parametrize("mode", [Mode.HELD, Mode.TRACKING])
@pytest.mark.parametrize("lacks", ["", "rest", "ramp"])
def test_brakes_can_be_tested_after_a_fault_only_with_the_platform_at_rest(cycle, monkeypatch, mode, lacks):
    cycle.mode, cycle.faults = mode, Fault.DRIVE
    if lacks == "ramp":
        monkeypatch.setattr(cycle, "durations", cycle.durations._replace(load=0.0))
    tick = measured(cycle, rate=0.0 if lacks != "rest" else 1.0)
    assert facts_of(cycle, monkeypatch, tick).provable == (mode is Mode.HELD and not lacks)


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault], ids=lambda fault: fault.name)
def test_brakes_cannot_be_tested_after_a_fault_of_a_brake_or_a_measurement(cycle, monkeypatch, fault):
    """Except STALE: missing feedback alone does not prevent the proof."""
    cycle.mode = Mode.HELD
    believed = fault is Fault.STALE or fault not in {Fault.BRAKE, *UNSEEN}
    for faults in (fault, fault | Fault.DRIVE | Fault.STALE):
        cycle.faults = faults
        assert facts_of(cycle, monkeypatch, measured(cycle)).provable == believed


@pytest.mark.parametrize("under_control", [Fault.NONE, Fault.FOLLOWING])
def test_legs_that_are_not_at_rest_after_a_stop_are_braked_with_a_fault(cycle, monkeypatch, under_control):
    monkeypatch.setattr(cycle, "_under_control", under_control)
    monkeypatch.setattr(cycle.motion, "overdue", lambda *_: True)
    cycle.mode = Mode.STOPPING
    cycle._change_mode(said(), measured(cycle, dq=1.0))
    assert (cycle.mode, cycle.faults, cycle.mode_tick) == (Mode.PARKING, Fault.FOLLOWING, 50)


@pytest.mark.parametrize(
    ("mode", "word", "leads"),
    [(Mode.LOADING, Operator.RESET, Mode.FAULT), (Mode.PARKING, Operator.RELEASE, Mode.HELD)],
)
def test_operator_command_in_the_tick_of_a_drive_fault_does_not_act_on_the_fault(cycle, mode, word, leads):
    """A RELEASE given before the platform was held must not release it."""
    cycle.mode, late = mode, round(1000.0 * (cycle.durations.least(mode) + 1.0)) + 2
    cycle.faults = Fault.SET_UP
    cycle._change_mode(said(word, tick=late), measured(cycle, tick=late))
    assert (cycle.mode, cycle.mode_tick) == (leads, late)
    assert cycle.faults & Fault.DRIVE


# -- where faults lead


@pytest.mark.parametrize(
    ("ages", "blind", "mode"),
    [
        ([1000, 1000, 999, 1000, 1000, 1000], 0, Mode.PARKING),
        ([1000] * 6, 0, Mode.FAULT),
        ([5000] * 6, [0, 0, 0, 0, 0, 1], Mode.PARKING),
    ],
    ids=str,
)
def test_drives_all_silent_for_a_second_cannot_hold_the_platform(cycle, ages, blind, mode):
    cycle.mode, cycle.tick = Mode.PARKING, measured(cycle, age=ages, blind=blind)
    cycle._react(said(), Fault.DRIVE)
    assert cycle.mode is mode


@pytest.mark.parametrize(
    ("mode", "state", "fault", "latched", "stops"),
    [
        (Mode.IDLE, DriveState.OFF, Fault.SECOND_CONTROLLER, Fault.NONE, False),
        (Mode.IDLE, DriveState.RUN, Fault.SECOND_CONTROLLER, Fault.NONE, True),
        (Mode.TRACKING, DriveState.OFF, Fault.SECOND_CONTROLLER, Fault.NONE, True),
        (Mode.FAULT, DriveState.RUN, Fault.NONE, Fault.SECOND_CONTROLLER, True),
        (Mode.FAULT, DriveState.OFF, Fault.NONE, Fault.SECOND_CONTROLLER, False),
        (Mode.TRACKING, DriveState.RUN, Fault.DRIVE, Fault.NONE, False),
        (Mode.TRACKING, DriveState.RUN, Fault.ESTOP, Fault.NONE, True),
        (Mode.FAULT, DriveState.RUN, Fault.NONE, Fault.ESTOP, False),
        (Mode.IDLE, DriveState.OFF, Fault.ESTOP, Fault.NONE, True),
    ],
)
def test_estop_follows_its_fault_or_a_second_controller_of_powered_drives(
    cycle, mode, state, fault, latched, stops
):
    cycle.mode, cycle.faults = mode, latched
    cycle.tick = measured(cycle, drive_state=int(state))
    cycle._latch(said(), Verdict(Warn.NONE, fault, Stop.NONE))
    assert cycle.estop is stops
    assert cycle.faults == fault | latched
    cycle._latch(said(Operator.ESTOP), Verdict(Warn.NONE, Fault.NONE, Stop.NONE))
    assert (cycle.mode, cycle.estop) == (Mode.FAULT, True)
    assert cycle.faults == fault | latched | Fault.ESTOP, "ESTOP of the operator is a separate fault"


@pytest.mark.parametrize(
    ("mode", "latched", "fault", "holds"),
    [
        (Mode.HELD, Fault.DRIVE, Fault.STALE, True),
        (Mode.HELD, Fault.DRIVE, Fault.BRAKE, False),
        (Mode.HELD, Fault.STALE, Fault.STALE, False),
        (Mode.UNLOADING, Fault.DRIVE, Fault.DRIVE, False),
    ],
)
def test_a_held_platform_that_loses_feedback_keeps_the_force_of_that_tick(cycle, mode, latched, fault, holds):
    cycle.mode, cycle.faults, cycle.tick = mode, latched, measured(cycle)
    cycle.effort.last_tau, cycle.effort.holding = LAST, 2.0 * LAST
    cycle._react(said(), fault)
    np.testing.assert_array_equal(cycle.effort.holding, LAST if holds else 2.0 * LAST)
    assert cycle.mode is mode


@pytest.mark.parametrize("fault", [*FOLLOW, Fault.DRIVE, Fault.SET_UP])
@pytest.mark.parametrize("before", [Fault.DRIVE, Fault.BRAKE, Fault.STALE, Fault.ENCODER | Fault.BRAKE])
def test_pose_faults_are_ignored_after_a_lost_leg_measurement(cycle, fault, before):
    cycle.mode, cycle.faults, cycle.tick = Mode.HELD, before, measured(cycle)
    cycle._react(said(), fault)
    news = not before & (Fault.STALE | Fault.ENCODER) or fault not in FOLLOW
    assert cycle.faults == (before | fault if news else before)
    assert cycle.mode is Mode.HELD


@pytest.mark.parametrize("fault", [*FOLLOW, Fault.DRIVE])
def test_a_lost_measurement_ends_a_second_brake_test(cycle, fault):
    cycle.mode, cycle.faults, cycle.tick = Mode.UNLOADING, Fault.STALE, measured(cycle)
    cycle._react(said(), fault)
    assert cycle.faults == Fault.STALE | fault
    believed = Fault.STROKE | Fault.SPEED | Fault.FOLLOWING | Fault.DRIVE
    assert cycle.mode is (Mode.UNLOADING if fault & believed else Mode.HELD)


# -- what the law is asked for, and what the drives are sent


class Law:
    """A law with a constant force. State: number of calls."""

    asked = 0

    def reset(self) -> None:
        """Nothing to reset."""

    def effort(self, tick: Any) -> None:
        self.asked += 1
        tick["tau_law"] = LAST


@pytest.fixture
def bench() -> Bench:
    """Six drives and a cycle that stays in its mode, with a law of constant force."""
    parts = build_cycle(VIRTUAL, 1000.0, 0.01).parts
    bench = Bench(cycle=Cycle(replace(parts, law=Law())))
    for _ in range(50):
        bench.step()
    bench.cycle._change_mode = lambda *_: None  # type: ignore[method-assign]
    return bench


def stepped(bench: Bench, mode: Mode, faults: Fault = Fault.NONE) -> Any:
    """Record of the next tick, in a given mode."""
    cycle = bench.cycle
    cycle.mode, cycle.faults = mode, faults
    cycle.control.settle()
    bench.step()
    return cycle.tick


@pytest.mark.parametrize(
    ("mode", "faults", "yields", "fixed", "watched"),
    [
        (Mode.HELD, Fault.STALE, False, True, True),
        (Mode.HELD, Fault.ENCODER, False, True, False),
        (Mode.HELD, Fault.DRIVE, False, False, True),
        (Mode.HELD, Fault.BRAKE, True, False, False),
        (Mode.PARKING, Fault.DRIVE, True, True, True),
        (Mode.PARKING, Fault.STALE, False, False, False),
        (Mode.TRACKING, Fault.NONE, True, False, False),
    ],
)
def test_fixed_forces_bypass_the_law_and_drive_response_is_checked_by_mode(
    bench, monkeypatch, mode, faults, yields, fixed, watched
):
    cycle, seen, resumed = bench.cycle, list[Any](), list[Any]()
    monkeypatch.setattr(cycle.parts.safety, "resume", resumed.append)

    def watch(tick: Any, tau: Any) -> bool:
        np.testing.assert_array_equal(tau, cycle.last["tau"])
        seen.append(tick["tau_asked"].copy())
        cycle.obedience.refused = 4
        return True

    monkeypatch.setattr(cycle.obedience, "watch", watch)
    cycle._yields = yields
    cycle.effort.holding = 1.5 * LAST
    cycle.last["tau"] = cycle.tick["tau"] = 2.0 * LAST
    before = cycle.parts.law.asked
    tick = stepped(bench, mode, faults)
    whole = 1.5 * LAST if fixed else LAST
    assert cycle.parts.law.asked == before + (not fixed)
    np.testing.assert_array_equal(seen, [whole] * watched)
    np.testing.assert_array_equal(tick["tau_asked"], np.where(watched & (np.arange(6) == 4), 0.0, whole))
    assert tick["legs_refused"] == (16 if watched else 0)
    assert cycle.faults == faults | (Fault.DRIVE if watched else Fault.NONE)
    np.testing.assert_array_equal(resumed, [np.where(np.arange(6) == 4, 0.0, 2.0 * LAST)] * watched)


@pytest.mark.parametrize("mode", list(Mode))
def test_the_mode_determines_power_force_and_set_up_of_the_drives(bench, monkeypatch, mode):
    frame = Frame(0x7A5, b"\1")
    monkeypatch.setattr(bench.cycle.end, "set_up", lambda tick: sent_array([frame]))
    bench.cycle.effort.reach_N = 1e9
    tick = stepped(bench, mode)
    command = bench.drives.commands[-1]
    sent = DriveMode(command.mode)
    powered = mode not in {Mode.WAITING, Mode.IDLE, Mode.PARKED, Mode.FAULT}
    assert (sent in {DriveMode.READY, DriveMode.RUN}) == powered
    np.testing.assert_allclose(command.force, LAST * (mode in CONTROLLED), atol=0.5)
    np.testing.assert_array_equal(tick["tau"], LAST * (mode in CONTROLLED))
    assert tick["command_mode"] == sent
    assert bench.drives.estops == 0
    bench.cycle.control.settle()
    frames = sent_frames(bench.step().frames)
    assert (frames[-1] == frame) == (mode in {Mode.WAITING, Mode.FAULT})
