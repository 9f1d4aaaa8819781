"""What each mode begins with, whichever it comes from: reference, forces, proof of the brakes, and the park."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Mode, Stop
from hil.app.compose import build_cycle
from hil.loop import cycle as cycle_module
from hil.loop.cycle import Cycle
from hil.loop.modes import Facts
from hil.signals import Operator
from tests.hil.test_cycle_again import LIVE, VIRTUAL
from tests.hil.test_cycle_decisions import said
from tests.hil.test_cycle_held import LAST, LOAD, aside, measured


@pytest.fixture(scope="module")
def made() -> Cycle:
    return build_cycle(VIRTUAL.model_copy(update={"reference": LIVE}), 1000.0, 0.01)


class Told:
    """What an entry asks of its neighbours, in its order."""

    def __init__(self, cycle: Cycle, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[tuple[Any, ...]] = []
        for owner, names in (
            (cycle.motion, ("start", "stop")),
            (cycle.operating, ("engage", "enter")),
            (cycle.effort, ("hold",)),
            (cycle.parts.law, ("reset",)),
            (cycle.parts.steering, ("trajectory.reset",)),
        ):
            for name in names:
                there: Any = owner
                *way, last = name.split(".")
                for each in way:
                    there = getattr(there, each)
                monkeypatch.setattr(
                    there, last, self.teller(f"{type(owner).__name__}.{name}", getattr(there, last))
                )

    def teller(self, name: str, asked: Any) -> Any:
        def tell(*args: Any, **more: Any) -> Any:
            self.asked.append((name, *args, *more.values()))
            return asked(*args, **more)

        return tell

    def names(self) -> list[str]:
        return [each[0] for each in self.asked]

    def of(self, name: str) -> tuple[Any, ...]:
        (found,) = [each[1:] for each in self.asked if each[0] == name]
        return found


@pytest.fixture
def cycle(made: Cycle) -> Cycle:
    """A cycle whose every mark of an entry is another than an entry makes it."""
    made.reset()
    made.effort.holding, made.effort.last_tau = 2.0 * LAST, LAST
    made.effort.offset, made.effort.entry_tick = 3.0 * LAST, 7
    made.operating.parks = True
    made.mode_tick = 3
    return made


def entered(cycle: Cycle, mode: Mode, before: Mode) -> Any:
    cycle.mode = before
    tick = measured(cycle, p=aside(cycle), wrench=LOAD)
    cycle._enter(mode, tick)
    assert (cycle.mode, cycle.mode_tick) == (mode, 50)
    return tick


def test_the_force_is_built_up_to_what_holds_the_platform_where_it_is_with_the_load_it_has(cycle):
    entered(cycle, Mode.LOADING, Mode.IDLE)
    statics = cycle.effort.statics(aside(cycle), cycle.parts.home_R, LOAD)
    np.testing.assert_array_equal(cycle.effort.holding, statics)
    np.testing.assert_array_equal(cycle.motion.sample(60).p, aside(cycle))
    assert cycle.motion.tick == 50
    assert cycle.proven


def test_as_the_brakes_open_the_law_takes_over_where_the_platform_is_and_no_brake_is_proven(
    cycle, monkeypatch
):
    told = Told(cycle, monkeypatch)
    tick = entered(cycle, Mode.RELEASING, Mode.LOADING)
    asked = told.of("Effort.hold")
    assert asked[0] is tick
    np.testing.assert_array_equal(asked[1], 2.0 * LAST)
    np.testing.assert_array_equal(asked[2].p, aside(cycle))
    assert len(asked) == 3, "the law is asked where the platform was measured"
    assert cycle.effort.entry_tick is None
    np.testing.assert_array_equal(cycle.motion.sample(60).p, aside(cycle))
    assert not cycle.proven


def test_the_approach_begins_from_rest_with_the_reference_behind_it_and_the_entry_offset_fades(
    cycle, monkeypatch
):
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    cycle.proven = False
    told = Told(cycle, monkeypatch)
    entered(cycle, Mode.APPROACH, Mode.RELEASING)
    move, number, then = told.of("Motion.start")
    np.testing.assert_array_equal(move.sample(0.0).p, aside(cycle))
    np.testing.assert_allclose(move.sample(99.0).p, cycle.parts.trajectory.sample(0.0).p, atol=1e-12)
    assert (number, then) == (50, cycle.parts.trajectory)
    assert told.of("Operating.engage") == (50, cycle.motion)
    assert told.names() == ["Steering.trajectory.reset", "Motion.start", "Operating.engage"]
    assert cycle.effort.entry_tick == 50
    np.testing.assert_array_equal(cycle.effort.offset, 3.0 * LAST)
    assert not cycle.operating.parks


@pytest.mark.parametrize("before", [Mode.APPROACH, Mode.LOADING])
@pytest.mark.parametrize("live", [True, False])
def test_the_reference_begins_anew_and_the_law_too_where_no_approach_came_before_it(
    cycle, monkeypatch, before, live
):
    told = Told(cycle, monkeypatch)
    if not live:
        monkeypatch.setattr(cycle, "parts", replace(cycle.parts, steering=None))
    entered(cycle, Mode.TRACKING, before)
    anew = before is Mode.LOADING
    assert sorted(told.names()) == sorted(
        [
            "Motion.start",
            "Operating.enter",
            *[f"{type(cycle.parts.law).__name__}.reset", "Operating.engage"] * anew,
            *["Steering.trajectory.reset"] * (anew and live),
        ]
    )
    assert told.of("Motion.start") == (cycle.parts.trajectory, 50)
    assert told.of("Operating.enter") == (Mode.TRACKING, 50, cycle.motion)
    assert cycle.proven is not anew
    assert cycle.effort.entry_tick == (50 if anew else 7)
    np.testing.assert_array_equal(cycle.effort.offset, 0.0 * LAST if anew else 3.0 * LAST)


def test_a_stop_parks_no_more_and_slows_down_from_its_tick_in_the_time_of_a_stop(cycle, monkeypatch):
    told = Told(cycle, monkeypatch)
    entered(cycle, Mode.STOPPING, Mode.TRACKING)
    assert told.of("Motion.stop") == (50, VIRTUAL.engage.stop_s)
    assert not cycle.operating.parks


def test_the_force_fades_from_the_last_one_that_was_sent(cycle):
    entered(cycle, Mode.UNLOADING, Mode.PARKING)
    np.testing.assert_array_equal(cycle.effort.holding, LAST)


@pytest.mark.parametrize(
    ("before", "load_s", "was", "proven"),
    [
        (Mode.UNLOADING, 0.2, False, True),
        (Mode.UNLOADING, 0.0, False, False),
        (Mode.UNLOADING, 0.0, True, True),
        (Mode.UNLOADING, 0.2, True, True),
        (Mode.IDLE, 0.2, False, False),
        (Mode.WAITING, 0.2, True, True),
    ],
)
def test_the_brakes_are_proven_by_the_unloading_alone(cycle, monkeypatch, before, load_s, was, proven):
    monkeypatch.setattr(cycle, "durations", cycle.durations._replace(load=load_s))
    cycle.proven = was
    entered(cycle, Mode.PARKED, before)
    assert cycle.proven is proven


# -- the way back to the first pose


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("parks", [False, True])
def test_a_park_goes_on_where_one_was_asked_for_and_the_operator_decides(cycle, monkeypatch, mode, parks):
    asked: list[Any] = []
    monkeypatch.setattr(cycle_module, "next_mode", lambda mode, *_: mode)
    monkeypatch.setattr(cycle, "_park", lambda facts, tick: asked.append((facts.elapsed, tick)))
    cycle.mode, cycle.mode_tick, cycle.operating.parks = mode, 49, parks
    tick = measured(cycle)
    cycle._change_mode(said(), tick)
    moves = mode in {Mode.APPROACH, Mode.TRACKING, Mode.STOPPING}
    assert asked == [(pytest.approx(1e-3), tick)] * (parks and moves)


def facts(*operator: Operator, stop: bool = False) -> Facts:
    return Facts(operator, [int(DriveState.RUN)] * 6, False, 0.0, False, stop, False, False)


@pytest.mark.parametrize(
    ("told", "fault", "again"),
    [
        (facts(), Fault.NONE, False),
        (facts(Operator.KEY), Fault.NONE, False),
        (facts(Operator.STOP), Fault.NONE, True),
        (facts(stop=True), Fault.NONE, True),
        (facts(), Fault.SET_UP, True),
    ],
)
def test_on_the_way_back_a_word_a_fault_or_safety_stop_it(cycle, monkeypatch, told, fault, again):
    asked = Told(cycle, monkeypatch)
    cycle.mode, cycle.faults = Mode.STOPPING, fault
    cycle._park(told, measured(cycle))
    assert asked.names() == ["Motion.stop"] * again
    assert cycle.mode_tick == (50 if again else 3)
    assert cycle.operating.parks is not again


@pytest.mark.parametrize("lacks", ["", "go", "rest", "a judgement"])
def test_the_way_back_begins_from_rest_once_it_is_judged_and_goes_to_the_first_pose(
    cycle, monkeypatch, lacks
):
    cycle.mode = Mode.TRACKING
    cycle.operating.go = lacks != "go"
    monkeypatch.setattr(type(cycle.motion), "resting", lacks != "rest")
    ways: list[Any] = []
    move = SimpleNamespace(duration_s=1.0)

    def way(*asked: Any) -> Any:
        ways.append(asked)
        return None if lacks == "a judgement" else move

    monkeypatch.setattr(cycle.operating, "way", way)
    told = Told(cycle, monkeypatch)
    cycle._park(facts(Operator.STOP, stop=True), measured(cycle))
    asked = lacks in {"", "a judgement"}
    assert ways == [("park", 50, cycle.motion, cycle.first)] * asked
    begins = not lacks
    assert (cycle.mode, cycle.mode_tick) == ((Mode.STOPPING, 50) if begins else (Mode.TRACKING, 3))
    if begins:
        assert told.asked == [
            ("Motion.start", move, 50),
            ("Operating.enter", Mode.STOPPING, 50, cycle.motion),
        ]
    else:
        assert told.asked == []


def test_a_stop_that_safety_asked_for_once_is_told_to_the_park_too(cycle, monkeypatch):
    asked: list[Any] = []
    monkeypatch.setattr(cycle_module, "next_mode", lambda mode, *_: mode)
    monkeypatch.setattr(cycle, "_park", lambda facts, _tick: asked.append(facts.stop))
    cycle.mode, cycle.mode_tick, cycle.stop_requested = Mode.STOPPING, 49, Stop.MISSED
    cycle._change_mode(said(), measured(cycle))
    assert asked == [True]
