"""Where a platform that is held stays, and by what force; and which modes end for lack of rest."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Mode
from hil.app.compose import build_cycle
from hil.contracts.records import record_of
from hil.loop.cycle import Cycle
from hil.safety.motion import REST_m_s
from tests.hil.test_cycle_again import VIRTUAL

LOAD = np.array([100.0, -50.0, -700.0, 20.0, 10.0, -5.0])
OLD_LOAD = np.array([0.0, 0.0, -300.0, 0.0, 0.0, 0.0])
LAST = np.array([3100.0, 3200.0, 3300.0, 3400.0, 3500.0, 3600.0])
QUIET: Any = SimpleNamespace(tick=50, operator=(), setpoints=(), orders=())


@pytest.fixture(scope="module")
def made() -> Cycle:
    return build_cycle(VIRTUAL, 1000.0, 0.01)


@pytest.fixture
def cycle(made: Cycle) -> Cycle:
    made.reset()
    return made


def measured(cycle: Cycle, **columns: Any) -> Any:
    """A tick in which all legs are heard, at rest at home."""
    parts = cycle.parts
    home = {"p": parts.home_p, "R": parts.home_R, "J": np.eye(6), "age": 0, "tick": 50}
    return record_of(**home | {"drive_state": int(DriveState.RUN)} | columns)


def aside(cycle: Cycle) -> Any:
    return cycle.parts.home_p + np.array([0.01, -0.02, 0.03])


@pytest.mark.parametrize("blind", [False, True])
@pytest.mark.parametrize("before", [Mode.TRACKING, Mode.IDLE])
def test_it_is_held_where_it_is_with_the_load_it_has_or_where_it_should_be_if_it_is_not_measured(
    cycle, before, blind
):
    cycle.mode, cycle.faults = before, Fault.STALE if blind else Fault.BRAKE
    cycle.last = record_of(wrench=OLD_LOAD)
    cycle._enter(Mode.HELD, measured(cycle, p=aside(cycle), wrench=LOAD))
    p, load = (cycle.parts.home_p, OLD_LOAD) if blind else (aside(cycle), LOAD)
    np.testing.assert_array_equal(cycle.motion.sample(60).p, p)
    np.testing.assert_array_equal(cycle.effort.holding, cycle.effort.statics(p, cycle.parts.home_R, load))
    assert (cycle.mode, cycle.mode_tick) == (Mode.HELD, 50)


@pytest.mark.parametrize("before", [Mode.PARKING, Mode.LOADING, Mode.UNLOADING])
def test_on_the_way_to_or_from_its_brakes_it_is_held_by_the_force_that_did_and_stays_where_it_should_be(
    cycle, before
):
    cycle.mode, cycle.faults = before, Fault.BRAKE
    cycle.effort.last_tau, cycle.effort.holding = LAST, 2.0 * LAST
    cycle._enter(Mode.HELD, measured(cycle, p=aside(cycle), wrench=LOAD))
    np.testing.assert_array_equal(cycle.effort.holding, LAST if before is Mode.PARKING else 2.0 * LAST)
    np.testing.assert_array_equal(cycle.motion.sample(60).p, cycle.parts.home_p)


def test_what_begins_to_hold_is_told_to_safety_and_the_drives_are_watched_anew(cycle, monkeypatch):
    told: list[Any] = []
    monkeypatch.setattr(cycle.parts.safety, "resume", lambda force: told.append(force.copy()))
    monkeypatch.setattr(cycle.obedience, "forget", lambda: told.append("anew"))
    asked: list[Any] = []
    monkeypatch.setattr(cycle.effort, "hold", lambda *what, on_it: asked.append((*what, on_it)))
    cycle.mode, cycle.faults = Mode.PARKING, Fault.BRAKE
    cycle.effort.last_tau = LAST
    tick = measured(cycle, p=aside(cycle))
    cycle._enter(Mode.HELD, tick)
    ((seen, force, sample, on_it),) = asked
    assert (seen is tick, on_it) == (True, True), "the law is asked as if the platform were on its reference"
    np.testing.assert_array_equal(force, LAST)
    np.testing.assert_array_equal(sample.p, cycle.parts.home_p)
    np.testing.assert_array_equal(told[0], LAST)
    assert told[1:] == ["anew"]
    cycle._yield(measured(cycle))
    assert told[2:] == ["anew"]


def test_what_yields_is_held_where_it_is_with_the_load_it_has(cycle):
    cycle._yield(measured(cycle, p=aside(cycle), wrench=LOAD))
    held = cycle.effort.statics(aside(cycle), cycle.parts.home_R, LOAD)
    np.testing.assert_array_equal(cycle.effort.holding, held)
    np.testing.assert_array_equal(cycle.motion.sample(60).p, aside(cycle))
    np.testing.assert_array_equal(cycle.motion.sample(60).R, cycle.parts.home_R)
    assert cycle.motion.tick == 50
    assert cycle._yields


@pytest.mark.parametrize(
    ("fault", "yields"), [(Fault.CERTIFICATE, False), (Fault.FOLLOWING, True), (Fault.DRIVE, True)]
)
@pytest.mark.parametrize("latched", [False, True])
def test_while_parking_the_law_goes_on_after_a_fault_that_a_stop_along_the_path_may_follow(
    cycle, fault, yields, latched
):
    cycle.tick = measured(cycle)
    if latched:
        cycle.mode, cycle.faults = Mode.STOPPING, fault
        cycle._enter(Mode.PARKING, cycle.tick)
    else:
        cycle.mode = Mode.PARKING
        cycle._react(QUIET, fault)
    assert cycle.mode is Mode.PARKING
    assert cycle._yields is yields
    assert cycle.faults == fault


def test_what_parks_without_a_fault_does_so_by_its_law_and_rests_where_its_reference_was(cycle):
    cycle.mode, cycle._yields = Mode.STOPPING, True
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 40)
    cycle._enter(Mode.PARKING, measured(cycle))
    np.testing.assert_array_equal(cycle.motion.sample(60).p, aside(cycle))
    assert cycle.motion.tick == 50
    assert not cycle._yields


# -- the fault that comes of waiting


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_legs_that_do_not_rest_long_after_the_motion_has_ended_are_waited_for_no_longer(
    cycle, monkeypatch, mode, way
):
    asked: list[tuple[int, float]] = []
    monkeypatch.setattr(cycle.motion, "overdue", lambda tick, s: not asked.append((tick, s)))  # type: ignore[func-returns-value]
    monkeypatch.setattr(cycle.motion, "finished", lambda tick: tick == 50)
    cycle.mode = mode
    rates = way * REST_m_s * (np.arange(6) == 5)
    assert cycle._restless(measured(cycle, dq=rates)) == (
        mode in {Mode.APPROACH, Mode.TRACKING, Mode.STOPPING}
    )
    assert not cycle._restless(measured(cycle, dq=0.999 * rates))
    assert set(asked) <= {(50, 1.0)}
    if mode is Mode.TRACKING:
        cycle.operating.go = False
        assert not cycle._restless(measured(cycle, dq=rates)), "on hold it may wait"


@pytest.mark.parametrize(
    ("under_control", "mode"), [(Fault.NONE, Mode.PARKING), (Fault.FOLLOWING, Mode.PARKING)]
)
def test_legs_that_do_not_rest_are_braked_even_where_following_leads_to_a_stop(
    cycle, monkeypatch, under_control, mode
):
    monkeypatch.setattr(cycle, "_under_control", under_control)
    monkeypatch.setattr(cycle.motion, "overdue", lambda *_: True)
    cycle.mode = Mode.STOPPING
    cycle._change_mode(QUIET, measured(cycle, dq=1.0))
    assert (cycle.mode, cycle.faults, cycle.mode_tick) == (mode, Fault.FOLLOWING, 50)
