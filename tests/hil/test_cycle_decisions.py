"""What a tick decides: what a RESET clears, what a transition is told, where faults lead, what drives are told."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
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
from hil.safety.motion import REST_m_s
from hil.signals import Operator
from tests.hil.test_cycle import Bench
from tests.hil.test_cycle_again import VIRTUAL
from tests.hil.test_cycle_held import LAST, aside, measured

OPERATOR_STAYS = VIRTUAL.operator.model_copy(update={"stays": True})


@pytest.fixture(scope="module")
def made() -> Cycle:
    return build_cycle(VIRTUAL, 1000.0, 0.01)


@pytest.fixture(scope="module")
def staying() -> Cycle:
    return build_cycle(VIRTUAL.model_copy(update={"operator": OPERATOR_STAYS}), 1000.0, 0.01)


@pytest.fixture
def cycle(made: Cycle) -> Cycle:
    made.reset()
    return made


def said(*operator: Operator, tick: int = 50) -> Any:
    return SimpleNamespace(tick=tick, operator=operator, setpoints=(), orders=())


# -- RESET


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("stays", [False, True])
def test_a_reset_clears_what_is_latched_where_nothing_is_held_and_nowhere_else(
    made, staying, monkeypatch, mode, stays
):
    cycle, told = staying if stays else made, list[str]()
    cycle.reset()
    for name in ("sight.forget", "obedience.reset", "parts.wrench.forget", "parts.safety.reset"):
        *way, last = name.split(".")
        owner: Any = cycle
        for each in way:
            owner = getattr(owner, each)
        monkeypatch.setattr(owner, last, lambda name=name: told.append(name))
    monkeypatch.setattr(cycle_module, "next_mode", lambda mode, *_: mode)
    cycle.mode, cycle.mode_tick, cycle.estop, cycle.stop_requested = mode, 50, True, Stop.MISSED
    cycle.faults, fresh = Fault.DRIVE, cycle.end.remembered()
    other = cycle.parts.protocol.controller_end(cycle.parts.setup._replace(watchdog_s=0.5))
    cycle.end.remember(other.remembered())
    cycle._change_mode(said(Operator.RELEASE), measured(cycle))
    assert not told
    cycle._change_mode(said(Operator.STOP, Operator.RESET), measured(cycle))
    if mode in {Mode.FAULT, Mode.WAITING} or (stays and mode is Mode.PARKED):
        assert told == ["sight.forget", "obedience.reset", "parts.wrench.forget", "parts.safety.reset"]
        assert (cycle.faults, cycle.estop, cycle.stop_requested) == (Fault.NONE, False, Stop.NONE)
        assert cycle.reset_tick == 50
        assert cycle.end.remembered() == fresh
    else:
        assert not told
        assert (cycle.faults, cycle.estop, cycle.stop_requested) == (Fault.DRIVE, True, Stop.MISSED)
        assert cycle.reset_tick is None
        assert cycle.end.remembered() != fresh


# -- what a transition is told


def facts_of(cycle: Cycle, monkeypatch: pytest.MonkeyPatch, tick: Any, *operator: Operator) -> Any:
    """Return what the table of transitions is told."""
    told: list[Any] = []

    def next_mode(mode: Mode, facts: Any, durations: Any) -> Mode:
        assert durations is cycle.durations
        told.append(facts)
        return mode

    monkeypatch.setattr(cycle_module, "next_mode", next_mode)
    cycle._change_mode(said(*operator), tick)
    assert len(told) == 1
    return told[0]


@pytest.mark.parametrize("lacks", ["", "turns", "set-up", "pose"])
@pytest.mark.parametrize("mode", [Mode.WAITING, Mode.IDLE, Mode.PARKED])
def test_drives_are_ready_with_their_turns_known_and_set_up_and_a_pose_before_the_platform_is_armed(
    cycle, monkeypatch, mode, lacks
):
    cycle.mode = mode
    cycle.sight.located = lacks != "pose"
    monkeypatch.setattr(type(cycle.homing), "known", lacks != "turns")
    legs = [lacks != "set-up"] * 6
    monkeypatch.setattr(cycle.end, "legs_set_up", lambda: legs)
    needed = {Mode.WAITING: {"turns", "set-up", "pose"}, Mode.IDLE: {"turns", "set-up"}}
    ready = facts_of(cycle, monkeypatch, measured(cycle)).ready
    assert ready == (mode in needed and lacks not in needed[mode])


def test_a_transition_is_told_states_words_and_the_time_in_the_mode(cycle, staying, monkeypatch):
    cycle.mode, cycle.mode_tick = Mode.IDLE, 20
    states = [1, 2, 3, 4, 2, 1]
    facts = facts_of(cycle, monkeypatch, measured(cycle, drive_state=states), Operator.ENGAGE)
    assert facts.operator == (Operator.ENGAGE,)
    assert facts.drive_state == states
    assert facts.elapsed == pytest.approx(0.03)
    assert (facts.stop, facts.stays, facts.provable) == (False, False, False)
    cycle.stop_requested = Stop.RECORDER
    assert facts_of(cycle, monkeypatch, measured(cycle)).stop
    staying.reset()
    assert facts_of(staying, monkeypatch, measured(staying)).stays


@pytest.mark.parametrize("mode", [Mode.HELD, Mode.TRACKING])
@pytest.mark.parametrize("lacks", ["", "rest", "no brake", "ramp"])
def test_only_a_held_platform_at_rest_whose_brakes_have_not_failed_can_have_them_proven(
    cycle, monkeypatch, mode, lacks
):
    cycle.mode = mode
    cycle.faults = Fault.BRAKE if lacks == "no brake" else Fault.DRIVE
    if lacks == "ramp":
        monkeypatch.setattr(cycle, "durations", cycle.durations._replace(load=0.0))
    tick = measured(cycle, rate=0.0 if lacks != "rest" else 1.0)
    assert facts_of(cycle, monkeypatch, tick).provable == (mode is Mode.HELD and not lacks)


UNBELIEVED = (
    *(Fault.BRAKE, Fault.ENCODER, Fault.UNCERTAIN, Fault.KINEMATICS, Fault.ASSEMBLY, Fault.CONDITION),
    *(Fault.NOT_FINITE, Fault.LAW, Fault.DUPLICATE_NODE),
)
"""Faults after which a leg that seems to stand proves no brake."""


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault], ids=lambda fault: fault.name)
def test_after_a_fault_of_what_is_measured_no_brake_is_proven_but_where_a_leg_was_only_not_heard(
    cycle, monkeypatch, fault
):
    cycle.mode, believed = Mode.HELD, fault not in UNBELIEVED
    for faults in (fault, fault | Fault.DRIVE | Fault.STALE):
        cycle.faults = faults
        assert facts_of(cycle, monkeypatch, measured(cycle)).provable == believed


@pytest.mark.parametrize("mode", [Mode.TRACKING, Mode.STOPPING])
@pytest.mark.parametrize("lacks", ["", "end", "on hold", "rest", "way back"])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_motion_is_over_at_its_end_with_nothing_to_follow_and_the_legs_at_rest(
    cycle, monkeypatch, mode, lacks, way
):
    cycle.mode = mode
    asked: list[int] = []
    monkeypatch.setattr(cycle.motion, "finished", lambda tick: not asked.append(tick) and lacks != "end")  # type: ignore[func-returns-value]
    cycle.operating.go = lacks != "on hold"
    cycle.operating.parks = lacks == "on hold" and mode is Mode.STOPPING
    if lacks == "way back":
        cycle.motion._left = cycle.parts.trajectory, 0.0
    dq = way * REST_m_s * (0.99 if lacks != "rest" else 1.0) * (np.arange(6) == 3)
    assert cycle._finished(measured(cycle, dq=dq)) == (not lacks)
    assert set(asked) == {50}


# -- waited too long


@pytest.mark.parametrize("mode", [Mode.LOADING, Mode.RELEASING, Mode.PARKING])
def test_a_drive_that_is_waited_for_too_long_is_faulty_and_what_it_may_not_have_braked_is_held(cycle, mode):
    leads = {Mode.LOADING: Mode.FAULT, Mode.RELEASING: Mode.PARKING, Mode.PARKING: Mode.HELD}
    cycle.mode = mode
    patience = round(1000.0 * (cycle.durations.least(mode) + 1.0))
    cycle._change_mode(said(tick=patience), measured(cycle, tick=patience, drive_state=int(DriveState.OFF)))
    assert (cycle.mode, cycle.faults) == (mode, Fault.NONE)
    cycle.faults = Fault.SET_UP
    cycle._change_mode(said(tick=patience + 2), measured(cycle, tick=patience + 2))
    assert cycle.mode is leads[mode]
    assert cycle.faults == Fault.DRIVE | Fault.SET_UP
    assert cycle.mode_tick == patience + 2


@pytest.mark.parametrize(("mode", "word"), [(Mode.LOADING, Operator.RESET), (Mode.PARKING, Operator.RELEASE)])
def test_a_word_that_came_with_the_fault_of_a_drive_that_was_waited_for_is_no_answer_to_it(cycle, mode, word):
    """A RELEASE given before anything was held must not let go of it."""
    cycle.mode, late = mode, round(1000.0 * (cycle.durations.least(mode) + 1.0)) + 2
    cycle._change_mode(said(word, tick=late), measured(cycle, tick=late))
    assert cycle.mode is {Mode.LOADING: Mode.FAULT, Mode.PARKING: Mode.HELD}[mode]
    assert cycle.faults == Fault.DRIVE


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
def test_drives_that_none_of_them_was_heard_of_for_a_second_cannot_hold(cycle, ages, blind, mode):
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
def test_an_emergency_stop_is_asked_for_by_its_fault_or_where_another_controller_has_powered_drives(
    cycle, mode, state, fault, latched, stops
):
    cycle.mode, cycle.faults = mode, latched
    cycle.tick = measured(cycle, drive_state=int(state))
    cycle._latch(said(), Verdict(Warn.NONE, fault, Stop.NONE))
    assert cycle.estop is stops
    assert cycle.faults == fault | latched


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.TRACKING, Mode.FAULT])
def test_the_operators_emergency_stop_is_a_fault_of_its_own_in_every_mode(cycle, mode):
    cycle.mode, cycle.tick = mode, measured(cycle)
    cycle._latch(said(Operator.ESTOP), Verdict(Warn.NONE, Fault.NONE, Stop.NONE))
    assert (cycle.mode, cycle.faults, cycle.estop) == (Mode.FAULT, Fault.ESTOP, True)


@pytest.mark.parametrize(
    ("mode", "latched", "fault", "holds"),
    [
        (Mode.HELD, Fault.DRIVE, Fault.STALE, True),
        (Mode.HELD, Fault.DRIVE, Fault.BRAKE, False),
        (Mode.HELD, Fault.STALE, Fault.STALE, False),
        (Mode.UNLOADING, Fault.DRIVE, Fault.DRIVE, False),
    ],
)
def test_a_held_platform_that_is_measured_no_longer_keeps_the_force_of_that_tick(
    cycle, mode, latched, fault, holds
):
    cycle.mode, cycle.faults, cycle.tick = mode, latched, measured(cycle)
    cycle.effort.last_tau, cycle.effort.holding = LAST, 2.0 * LAST
    cycle._react(said(), fault)
    np.testing.assert_array_equal(cycle.effort.holding, LAST if holds else 2.0 * LAST)
    assert cycle.mode is mode


@pytest.mark.parametrize("first", [Stop.MISSED, Stop.RECORDER])
def test_the_first_stop_that_safety_asks_for_is_kept_whatever_it_asks_for_later(cycle, first):
    cycle.tick, kept = measured(cycle), []
    for stop in (Stop.NONE, first, Stop.NONE, Stop.MISSED, Stop.RECORDER):
        cycle._latch(said(), Verdict(Warn.NONE, Fault.NONE, stop))
        kept.append(cycle.stop_requested)
    assert kept == [Stop.NONE, *[first] * 4]


# -- what the law is asked, and what the drives are told


class Law:
    """Asks for the same always. State: how often."""

    asked = 0

    def reset(self) -> None:
        """Nothing is kept."""

    def effort(self, tick: Any) -> None:
        self.asked += 1
        tick["tau_law"] = LAST


@pytest.fixture
def bench() -> Bench:
    """Six drives and a cycle that stays in its mode, with a law that asks for the same always."""
    parts = build_cycle(VIRTUAL, 1000.0, 0.01).parts
    bench = Bench(cycle=Cycle(replace(parts, law=Law())))
    for _ in range(50):
        bench.step()
    bench.cycle._change_mode = lambda *_: None  # type: ignore[method-assign]
    return bench


def stepped(bench: Bench, mode: Mode, *operator: Operator, faults: Fault = Fault.NONE) -> Any:
    """Return the record of the next tick, which is in a mode."""
    cycle = bench.cycle
    cycle.mode, cycle.faults = mode, faults
    cycle.control.settle()
    bench.step(operator)
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
def test_the_law_is_left_out_and_the_drives_are_watched_where_they_are_to_be(
    bench, monkeypatch, mode, faults, yields, fixed, watched
):
    cycle, seen, told = bench.cycle, list[Any](), list[Any]()
    monkeypatch.setattr(cycle.parts.safety, "resume", told.append)

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
    tick = stepped(bench, mode, faults=faults)
    whole = 1.5 * LAST if fixed else LAST
    assert cycle.parts.law.asked == before + (not fixed)
    np.testing.assert_array_equal(seen, [whole] * watched)
    np.testing.assert_array_equal(tick["tau_asked"], np.where(watched & (np.arange(6) == 4), 0.0, whole))
    assert tick["legs_refused"] == (16 if watched else 0)
    assert cycle.faults == faults | (Fault.DRIVE if watched else Fault.NONE)
    np.testing.assert_array_equal(told, [np.where(np.arange(6) == 4, 0.0, 2.0 * LAST)] * watched)


@pytest.mark.parametrize("mode", list(Mode))
def test_drives_that_are_not_to_be_powered_are_told_no_force(bench, mode):
    powered = mode not in {Mode.WAITING, Mode.IDLE, Mode.PARKED, Mode.FAULT}
    asked = mode in CONTROLLED
    bench.cycle.effort.reach_N = 1e9
    tick = stepped(bench, mode)
    command = bench.drives.commands[-1]
    sent = DriveMode(command.mode)
    assert (sent in {DriveMode.READY, DriveMode.RUN}) == powered
    np.testing.assert_allclose(command.force, LAST * asked, atol=0.5)
    np.testing.assert_array_equal(tick["tau"], LAST * asked)
    assert tick["command_mode"] == sent
    assert bench.drives.estops == 0


@pytest.mark.parametrize("mode", [Mode.WAITING, Mode.IDLE, Mode.FAULT])
def test_a_reset_goes_to_the_drives_while_they_are_waited_for_and_not_for_ever(bench, mode):
    ticks = bench.cycle.parts.protocol.traits.reset_ticks
    assert stepped(bench, mode)["command_mode"] == DriveMode.OFF
    bench.cycle.reset_tick = bench.tick + 1
    modes = [int(stepped(bench, mode)["command_mode"]) for _ in range(3 * ticks)]
    sent = DriveMode.RESET if mode is Mode.WAITING else DriveMode.OFF
    assert modes == [sent] * ticks + [DriveMode.OFF] * (2 * ticks)


@pytest.mark.parametrize("mode", list(Mode))
def test_drives_are_set_up_while_they_are_waited_for_and_after_a_fault(bench, monkeypatch, mode):
    frame, cycle = Frame(0x7A5, b"\1"), bench.cycle
    monkeypatch.setattr(cycle.end, "set_up", lambda tick: sent_array([frame]))
    cycle.mode = mode
    cycle.control.settle()
    frames = sent_frames(bench.step().frames)
    assert (frames[-1] == frame) == (mode in {Mode.WAITING, Mode.FAULT})


def test_a_platform_that_yields_takes_its_reference_along(cycle, monkeypatch):
    monkeypatch.setattr(cycle_module, "next_mode", lambda mode, *_: mode)
    for mode, yields in ((Mode.PARKING, True), (Mode.PARKING, False), (Mode.HELD, True)):
        cycle.reset()
        cycle.mode, cycle.mode_tick, cycle._yields = mode, 50, yields
        cycle._change_mode(said(), measured(cycle, p=aside(cycle)))
        follows = mode is Mode.PARKING and yields
        there = aside(cycle) if follows else cycle.parts.home_p
        np.testing.assert_array_equal(cycle.motion.sample(60).p, there)
        assert cycle.motion.tick == (50 if follows else 0)
