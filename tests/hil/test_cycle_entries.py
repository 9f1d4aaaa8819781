"""What each mode begins with, whichever it comes from: reference, forces, proof of the brakes, and hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.signals import Fault, Mode
from hil.app.compose import build_cycle
from hil.contracts.records import record_of
from hil.loop.cycle import Cycle
from hil.loop.reference import tau_at_rest
from tests.hil.cycle_bench import LAST, LIVE, LOAD, VIRTUAL, aside, measured, said

OLD_LOAD = np.array([0.0, 0.0, -300.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def made() -> Cycle:
    return build_cycle(VIRTUAL.model_copy(update={"reference": LIVE}), 1000.0, 0.01)


@pytest.fixture
def cycle(made: Cycle) -> Cycle:
    """Return a cycle whose every mark of an entry differs from what an entry makes it."""
    made.reset()
    made.effort.holding, made.effort.last_tau = 2.0 * LAST, LAST
    made.effort.offset, made.effort.entry_tick = 3.0 * LAST, 7
    made.operating.parks = True
    made.mode_tick = 3
    return made


def entered(cycle: Cycle, mode: Mode, before: Mode) -> Any:
    """Enter a mode in tick 50, aside from home and under a load; return the tick."""
    cycle.mode = before
    tick = measured(cycle, p=aside(cycle), wrench=LOAD)
    cycle._enter(mode, tick)
    assert (cycle.mode, cycle.mode_tick) == (mode, 50)
    return tick


def rests_at(cycle: Cycle, p: Any) -> None:
    """Assert that the reference rests at a position since tick 50."""
    np.testing.assert_array_equal(cycle.motion.sample(60).p, p)
    np.testing.assert_array_equal(cycle.motion.sample(60).R, cycle.parts.home_R)
    assert cycle.motion.tick == 50


def offset_from(cycle: Cycle, tick: Any, force: Any, *, on_it: bool) -> Any:
    """Return what the law at rest leaves of a force (6,) N."""
    parts = cycle.parts
    return force - tau_at_rest(parts.law, parts.platform, tick, cycle.motion.sample(50), on_it=on_it)


def test_force_is_built_up_to_what_holds_the_platform_where_it_is_with_its_load(cycle):
    entered(cycle, Mode.LOADING, Mode.IDLE)
    statics = cycle.effort.statics(aside(cycle), cycle.parts.home_R, LOAD)
    np.testing.assert_array_equal(cycle.effort.holding, statics)
    rests_at(cycle, aside(cycle))
    assert cycle.proven


def test_as_brakes_open_the_law_takes_over_where_the_platform_is_and_none_is_proven(cycle):
    tick = entered(cycle, Mode.RELEASING, Mode.LOADING)
    np.testing.assert_array_equal(cycle.effort.holding, 2.0 * LAST)
    np.testing.assert_allclose(cycle.effort.offset, offset_from(cycle, tick, 2.0 * LAST, on_it=False))
    assert cycle.effort.entry_tick is None
    rests_at(cycle, aside(cycle))
    assert not cycle.proven


@pytest.mark.parametrize("speed", [0.4, 1.0])
def test_the_approach_begins_from_rest_with_the_reference_behind_it(cycle, speed):
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    cycle.operating.speed = speed
    live: Any = cycle.parts.trajectory
    live._live["tick"] = 9
    entered(cycle, Mode.APPROACH, Mode.RELEASING)
    assert live._live["tick"] == 0, "a live reference begins at its start"
    move = cycle.motion.trajectory
    np.testing.assert_array_equal(move.sample(0.0).p, aside(cycle))
    np.testing.assert_allclose(move.sample(99.0).p, cycle.parts.trajectory.sample(0.0).p, atol=1e-12)
    assert (cycle.motion.tick, cycle.motion.then) == (50, cycle.parts.trajectory)
    assert cycle.effort.entry_tick == 50
    np.testing.assert_array_equal(cycle.effort.offset, 3.0 * LAST)
    assert cycle.motion.override.sigma == speed
    assert not cycle.operating.parks


@pytest.mark.parametrize("before", [Mode.APPROACH, Mode.LOADING])
def test_the_law_begins_with_the_reference_where_no_approach_came_before(cycle, monkeypatch, before):
    begun: list[str] = []
    monkeypatch.setattr(cycle.parts.law, "reset", lambda: begun.append("law"))
    cycle.operating.speed = 0.4
    live: Any = cycle.parts.trajectory
    live._live["tick"] = 9
    entered(cycle, Mode.TRACKING, before)
    first = before is Mode.LOADING
    assert live._live["tick"] == (0 if first else 9)
    assert begun == ["law"] * first
    assert (cycle.motion.tick, cycle.motion.trajectory) == (50, cycle.parts.trajectory)
    assert cycle.proven is not first
    assert cycle.effort.entry_tick == (50 if first else 7)
    np.testing.assert_array_equal(cycle.effort.offset, 0.0 * LAST if first else 3.0 * LAST)
    assert cycle.operating.parks is not first


def test_a_stop_parks_no_more_and_the_force_fades_from_the_last_one_sent(cycle):
    entered(cycle, Mode.STOPPING, Mode.TRACKING)
    assert not cycle.operating.parks
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


# -- held


@pytest.mark.parametrize("blind", [False, True])
@pytest.mark.parametrize("before", [Mode.TRACKING, Mode.IDLE])
def test_a_platform_is_held_where_it_is_or_where_it_should_be_if_not_measured(cycle, before, blind):
    cycle.faults = Fault.STALE if blind else Fault.BRAKE
    cycle.last = record_of(wrench=OLD_LOAD)
    entered(cycle, Mode.HELD, before)
    p, load = (cycle.parts.home_p, OLD_LOAD) if blind else (aside(cycle), LOAD)
    rests_at(cycle, p)
    np.testing.assert_array_equal(cycle.effort.holding, cycle.effort.statics(p, cycle.parts.home_R, load))


@pytest.mark.parametrize("before", [Mode.PARKING, Mode.LOADING, Mode.UNLOADING])
def test_on_the_way_to_its_brakes_it_is_held_by_the_force_that_did(cycle, monkeypatch, before):
    cycle.faults = Fault.BRAKE
    news: list[Any] = []
    monkeypatch.setattr(cycle.parts.safety, "resume", lambda force: news.append(force.copy()))
    monkeypatch.setattr(cycle.obedience, "forget", lambda: news.append("forgotten"))
    tick = entered(cycle, Mode.HELD, before)
    force = LAST if before is Mode.PARKING else 2.0 * LAST
    np.testing.assert_array_equal(cycle.effort.holding, force)
    np.testing.assert_array_equal(cycle.motion.sample(60).p, cycle.parts.home_p)
    np.testing.assert_allclose(cycle.effort.offset, offset_from(cycle, tick, force, on_it=True))
    np.testing.assert_array_equal(news[0], force)
    assert news[1:] == ["forgotten"], "the drives are watched again from the start"


def test_what_yields_is_held_where_it_is_with_the_load_it_has(cycle, monkeypatch):
    news: list[str] = []
    monkeypatch.setattr(cycle.obedience, "forget", lambda: news.append("forgotten"))
    cycle._yield(measured(cycle, p=aside(cycle), wrench=LOAD))
    held = cycle.effort.statics(aside(cycle), cycle.parts.home_R, LOAD)
    np.testing.assert_array_equal(cycle.effort.holding, held)
    rests_at(cycle, aside(cycle))
    assert cycle._yields
    assert news == ["forgotten"]


@pytest.mark.parametrize(
    ("fault", "yields"), [(Fault.CERTIFICATE, False), (Fault.FOLLOWING, True), (Fault.DRIVE, True)]
)
@pytest.mark.parametrize("latched", [False, True])
def test_while_parking_the_law_goes_on_after_a_fault_that_a_stop_may_follow(cycle, fault, yields, latched):
    cycle.tick = measured(cycle)
    if latched:
        cycle.mode, cycle.faults = Mode.STOPPING, fault
        cycle._enter(Mode.PARKING, cycle.tick)
    else:
        cycle.mode = Mode.PARKING
        cycle._react(said(), fault)
    assert cycle.mode is Mode.PARKING
    assert cycle._yields is yields
    assert cycle.faults == fault


def test_what_parks_without_a_fault_does_so_by_its_law_where_its_reference_was(cycle):
    cycle._yields = True
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 40)
    cycle.mode = Mode.STOPPING
    cycle._enter(Mode.PARKING, measured(cycle))
    rests_at(cycle, aside(cycle))
    assert not cycle._yields
