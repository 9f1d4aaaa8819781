"""Entry into each mode from any mode: reference, forces, brake proof, and hold."""

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
    """A cycle in which every quantity that an entry sets has another value."""
    made.reset()
    made.effort.holding, made.effort.last_tau = 2.0 * LAST, LAST
    made.effort.offset, made.effort.entry_tick = 3.0 * LAST, 7
    made.operating.parks = True
    made.mode_tick = 3
    return made


def entered(cycle: Cycle, mode: Mode, before: Mode) -> Any:
    """Enter a mode in tick 50, away from home and under a load; return the tick."""
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
    """Force (6,) N minus the force of the law at rest."""
    parts = cycle.parts
    return force - tau_at_rest(parts.law, parts.platform, tick, cycle.motion.sample(50), on_it=on_it)


def test_loading_ramps_to_the_static_force_at_the_measured_pose_and_load(cycle):
    entered(cycle, Mode.LOADING, Mode.IDLE)
    statics = cycle.effort.statics(aside(cycle), cycle.parts.home_R, LOAD)
    np.testing.assert_array_equal(cycle.effort.holding, statics)
    rests_at(cycle, aside(cycle))
    assert cycle.proven


def test_law_starts_at_the_measured_pose_with_unproven_brakes_at_brake_release(cycle):
    tick = entered(cycle, Mode.RELEASING, Mode.LOADING)
    np.testing.assert_array_equal(cycle.effort.holding, 2.0 * LAST)
    np.testing.assert_allclose(cycle.effort.offset, offset_from(cycle, tick, 2.0 * LAST, on_it=False))
    assert cycle.effort.entry_tick is None
    rests_at(cycle, aside(cycle))
    assert not cycle.proven


@pytest.mark.parametrize("speed", [0.4, 1.0])
def test_the_approach_begins_at_rest_and_leads_to_the_reference(cycle, speed):
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
def test_law_is_reset_at_the_start_of_tracking_only_without_an_approach(cycle, monkeypatch, before):
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


def test_a_stop_cancels_park_and_unloading_ramps_from_the_last_force(cycle):
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
def test_brakes_count_as_proven_only_after_a_force_ramp_down(cycle, monkeypatch, before, load_s, was, proven):
    monkeypatch.setattr(cycle, "durations", cycle.durations._replace(load=load_s))
    cycle.proven = was
    entered(cycle, Mode.PARKED, before)
    assert cycle.proven is proven


# -- held


@pytest.mark.parametrize("blind", [False, True])
@pytest.mark.parametrize("before", [Mode.TRACKING, Mode.IDLE])
def test_platform_is_held_at_its_measured_pose_or_without_feedback_at_its_reference(cycle, before, blind):
    cycle.faults = Fault.STALE if blind else Fault.BRAKE
    cycle.last = record_of(wrench=OLD_LOAD)
    entered(cycle, Mode.HELD, before)
    p, load = (cycle.parts.home_p, OLD_LOAD) if blind else (aside(cycle), LOAD)
    rests_at(cycle, p)
    np.testing.assert_array_equal(cycle.effort.holding, cycle.effort.statics(p, cycle.parts.home_R, load))


@pytest.mark.parametrize("before", [Mode.PARKING, Mode.LOADING, Mode.UNLOADING])
def test_a_platform_held_from_parking_or_a_brake_test_keeps_its_force(cycle, monkeypatch, before):
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
    assert news[1:] == ["forgotten"], "the check of the drive responses must restart"


def test_platform_that_slips_on_its_brakes_is_held_at_its_measured_pose_and_load(cycle, monkeypatch):
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
def test_the_law_continues_while_parking_after_a_fault_that_allows_a_stop(cycle, fault, yields, latched):
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


def test_parking_without_a_fault_uses_the_law_at_the_last_reference(cycle):
    cycle._yields = True
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 40)
    cycle.mode = Mode.STOPPING
    cycle._enter(Mode.PARKING, measured(cycle))
    rests_at(cycle, aside(cycle))
    assert not cycle._yields
