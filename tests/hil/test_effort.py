"""What is asked for in a tick: the law's own, the entry offset, what was learned, and the window where it is held."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import Callee, data_at, of_python
from drivers.frame_array import FRAME
from drivers.signals import LEGS, DriveState, Fault, Mode
from drivers.tick_columns import Record, copy_of
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.contracts.records import record_of
from hil.estimation.external_wrench import ExternalWrench
from hil.loop import effort as effort_module
from hil.loop import modes
from hil.loop.compiled_pass import EFFORT, act
from hil.loop.cycle import Cycle
from hil.loop.learned import LearnedForces
from hil.robot.force_path import ForcePath
from hil.robot.kinematics import leg_lengths
from hil.trajectory.move import GeodesicMove

OWN = np.array([100.0, -200.0, 300.0, -400.0, 500.0, -600.0])
HOLDING = np.array([900.0, 800.0, 700.0, 600.0, 500.0, 400.0])
LEARNED = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
SHORTFALL = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
WRENCH = np.array([0.0, 0.0, -500.0, 10.0, 0.0, 0.0])


FORCES = LearnedForces(np.zeros((3, 6)), -0.1, 0.1, 0.05)


class Law:
    """Asks for the same always, or for what it is told. State: the tick that it saw last."""

    def __init__(self) -> None:
        self.own = OWN
        self.seen: Record | None = None

    def reset(self) -> None:
        """Nothing is kept."""

    def effort(self, tick: Record) -> None:
        self.seen = copy_of(tick)
        tick["tau_law"] = self.own


@pytest.fixture(scope="module")
def parts() -> Any:
    return build_cycle(load("virtual"), 1000.0, 0.01).parts


def a_cycle(parts: Any, **different: Any) -> tuple[Cycle, Law]:
    """Return a cycle with such a law, which stands at a sample with the holding force."""
    law = Law()
    cycle = Cycle(replace(parts, law=law, **different))
    cycle.motion.rest(parts.home_p, parts.home_R, 1)
    cycle.effort.hold(record_of(tick=1), HOLDING, cycle.motion.sample(1))
    return cycle, law


def filled(
    cycle: Cycle, mode: Mode, number: int = 2, *, since: int = 1, free: bool = True, **columns: Any
) -> Record:
    """Return a tick with what is asked for in it, in a mode entered at a tick."""
    tick = record_of(tick=number, drive_state=int(DriveState.RUN if free else DriveState.OFF), **columns)
    cycle.tick, cycle.mode, cycle.mode_tick = tick, mode, since
    cycle.control.settle()
    record = cycle.control.record
    record["tick"] = data_at(tick)
    act(record, tick, np.empty(1, FRAME), EFFORT)
    return tick


def test_at_entry_the_holding_force_is_asked_for_whatever_the_law_asks(parts):
    cycle, _ = a_cycle(parts)
    np.testing.assert_array_equal(filled(cycle, Mode.RELEASING)["tau_asked"], HOLDING)


def test_held_again_the_entry_offset_is_whole_again(parts):
    cycle, _ = a_cycle(parts)
    cycle.effort.entry_tick = 2
    late = 3 + round(parts.engage.blend_s * parts.rate_Hz)
    np.testing.assert_array_equal(filled(cycle, Mode.TRACKING, late)["tau_asked"], OWN)
    cycle.effort.hold(record_of(tick=late + 1), HOLDING, cycle.motion.sample(late + 1))
    np.testing.assert_array_equal(filled(cycle, Mode.HELD, late + 2)["tau_asked"], HOLDING)


def learns(cycle: Cycle) -> list[tuple[int, ...]]:
    """Let LEARNED be what was learned; return what the cycle asks for it, to be filled."""
    asked: list[tuple[int, ...]] = []

    def look(*given: int) -> int:
        asked.append(given[:-1])
        (ctypes.c_double * LEGS).from_address(given[-1])[:] = list(LEARNED)
        return 1

    cycle.control.record["learn"], keeps = of_python(look, *[INTEGER] * 9)
    cycle.control._keeps.append(keeps)
    return asked


def test_what_was_learned_is_added_to_what_is_asked_but_never_where_the_platform_is_held(parts):
    cycle, _ = a_cycle(parts, learned=FORCES)
    learns(cycle)
    moving = filled(cycle, Mode.TRACKING)
    np.testing.assert_array_equal(moving["tau_asked"], HOLDING + LEARNED)
    np.testing.assert_array_equal(moving["tau_learned"], LEARNED)
    held = filled(cycle, Mode.HELD)
    np.testing.assert_array_equal(held["tau_asked"], HOLDING)
    assert not held["tau_learned"].any()


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_where_it_is_held_the_law_goes_no_further_from_the_holding_force_than_the_window_else_as_it_asks(
    parts, way
):
    cycle, law = a_cycle(parts)
    law.own = OWN + way * 1e6
    np.testing.assert_allclose(filled(cycle, Mode.HELD)["tau_asked"], HOLDING + way * cycle.effort.reach_N)
    for mode in sorted(modes.CONTROLLED - {Mode.HELD}):
        np.testing.assert_allclose(filled(cycle, mode)["tau_asked"], HOLDING + way * 1e6)


def test_after_a_reset_what_was_learned_begins_anew_too(parts):
    cycle, _ = a_cycle(parts)
    begun: list[bool] = []
    cycle.effort.learned = SimpleNamespace(reset=lambda: begun.append(True))  # type: ignore[assignment]
    cycle.effort.reset()
    assert begun == [True]


class Predictor:
    """Moves nothing on. State: whether it was last told that the brakes are open."""

    def reset(self) -> None:
        """Nothing is kept."""

    horizon_s = 1e-3
    free: bool | None = None
    path = ForcePath(1e-3, 0.0, 0.0)

    def __init__(self) -> None:
        address, keeps = of_python(self._ahead, *[INTEGER] * 3)
        self.look = Callee(address, 0, keeps)

    def _ahead(self, _context: int, free: int, _tick: int) -> int:
        self.free = bool(free)
        return 0


@pytest.mark.parametrize("free", [True, False])
def test_the_predictor_knows_whether_the_brakes_are_open(parts, free):
    predictor = Predictor()
    cycle, _ = a_cycle(parts, predictor=predictor)
    filled(cycle, Mode.RELEASING, free=free)
    assert predictor.free is free


@pytest.mark.parametrize("number", [3, 10, 500])
def test_a_law_that_looks_ahead_reads_its_table_where_its_force_will_act(parts, number):
    """The path began in tick 2; off the clock's time a table says nothing."""
    cycle, law = a_cycle(parts, predictor=Predictor())
    cycle.motion.start(parts.trajectory, 2)
    filled(cycle, Mode.TRACKING, number)
    assert law.seen is not None
    assert law.seen["t_d"] == pytest.approx(1e-3 * (number - 2) + Predictor.horizon_s, abs=1e-12)
    ahead = leg_lengths(parts.platform, *parts.trajectory.sample(1e-3 * (number - 1))[:2])
    np.testing.assert_allclose(law.seen["q_d"], ahead, rtol=0.0, atol=1e-12)
    filled(cycle, Mode.STOPPING, number)
    assert np.isnan(law.seen["t_d"])
    cycle.motion.settle(number, 0.5)
    filled(cycle, Mode.TRACKING, number + 1)
    assert np.isnan(law.seen["t_d"])


@pytest.mark.parametrize(("left", "t_d"), [(0, None), (1, 1.5e-3), (2, 0.5e-3), (3, None), (9, None)])
def test_a_law_that_looks_ahead_reads_its_table_from_the_first_force_that_acts_along_the_path(
    parts, left, t_d
):
    """The approach ends so many ticks later; its last force may act on the path already."""
    predictor = Predictor()
    predictor.horizon_s = 2.5e-3
    cycle, law = a_cycle(parts, predictor=predictor)
    rest = cycle.motion.sample(1)
    cycle.motion.start(GeodesicMove(rest.p, rest.R, rest.p, rest.R, 0.0995), 0, then=parts.trajectory)
    filled(cycle, Mode.APPROACH, 100 - left)
    assert law.seen is not None
    assert law.seen["t_d"] == pytest.approx(np.nan if t_d is None else t_d, abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("predicts", [True, False])
def test_the_law_sees_what_the_limits_took_of_its_last_force(parts, predicts):
    cycle, law = a_cycle(parts, predictor=Predictor() if predicts else None)
    cycle.control.record["shortfall"] = SHORTFALL
    filled(cycle, Mode.TRACKING)
    assert law.seen is not None
    np.testing.assert_array_equal(law.seen["shortfall"], SHORTFALL)


def test_the_external_wrench_comes_in_as_the_entry_offset_goes_out(parts):
    cycle, law = a_cycle(parts, wrench=ExternalWrench(None, 1000.0, 1e-3))
    cycle.effort.entry_tick = 10
    blend = round(parts.engage.blend_s * parts.rate_Hz)
    for number, share in ((10, 0.0), (10 + blend // 2, 0.5), (10 + blend, 1.0)):
        tick = filled(cycle, Mode.TRACKING, number, wrench=WRENCH)
        assert law.seen is not None
        np.testing.assert_allclose(law.seen["wrench"], share * WRENCH, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(tick["wrench"], WRENCH)  # safety judges the whole
        np.testing.assert_allclose(tick["tau_asked"], OWN + (1.0 - share) * (HOLDING - OWN))


def test_a_reset_forgets_every_force_and_when_one_began_to_fade(parts):
    cycle, _ = a_cycle(parts)
    names = ("holding", "offset", "last_tau")
    for name in names:
        setattr(cycle.effort, name, HOLDING)
    cycle.effort.entry_tick = 7
    cycle.effort.reset()
    assert [getattr(cycle.effort, name).any() for name in names] == [False] * 3
    assert cycle.effort.entry_tick is None


@pytest.mark.parametrize("faulty", [False, True])
def test_what_was_learned_is_asked_for_the_tick_and_its_mode_and_told_of_a_fault(parts, faulty):
    cycle, _ = a_cycle(parts, learned=FORCES)
    asked = learns(cycle)
    cycle.faults = Fault.DRIVE if faulty else Fault.NONE
    for cycle._yields in (False, True):
        filled(cycle, Mode.PARKING, 9, since=4)
    moves = data_at(cycle.motion.record), data_at(cycle.motion.override.record)
    assert [each[1:] for each in asked] == [(*moves, 9, Mode.PARKING, 4, 0, cycle.faults)] * 2


def test_a_force_that_is_fixed_is_the_holding_force_and_neither_law_nor_what_was_learned_acts(parts):
    cycle, law = a_cycle(parts, learned=FORCES)
    law.seen = None
    learns(cycle)
    cycle.effort.holding, cycle.effort.offset = SHORTFALL, OWN
    cycle.faults = Fault.STALE
    tick = filled(cycle, Mode.HELD, 9)
    np.testing.assert_array_equal(tick["tau_asked"], SHORTFALL)
    assert law.seen is None
    assert not tick["tau_learned"].any()


@pytest.mark.parametrize(
    "mode", [Mode.WAITING, Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED, Mode.FAULT]
)
@pytest.mark.parametrize("load_s", [0.0, 0.2])
def test_without_the_law_only_a_ramp_asks_for_a_share_of_the_holding_force(parts, mode, load_s):
    cycle, law = a_cycle(parts, engage=parts.engage.model_copy(update={"force_ramp_s": load_s}))
    law.seen = None
    tick = filled(cycle, mode, 104, since=4, free=False, tau_asked=LEARNED)
    share = {Mode.LOADING: 0.0, Mode.UNLOADING: 0.5}.get(mode) if load_s else None
    np.testing.assert_allclose(tick["tau_asked"], LEARNED if share is None else share * HOLDING)
    assert law.seen is None


@pytest.mark.parametrize("predicts", [True, False])
def test_the_tick_has_the_laws_own_force_whatever_it_saw(parts, predicts):
    cycle, _ = a_cycle(parts, predictor=Predictor() if predicts else None)
    np.testing.assert_array_equal(filled(cycle, Mode.TRACKING)["tau_law"], OWN)


def test_the_entry_offset_fades_over_the_blend_and_without_one_is_gone_at_once(parts):
    for blend_s, shares in (
        (0.1, {10: 1.0, 35: 1.0 - 0.103515625, 60: 0.5, 110: 0.0, 999: 0.0}),
        (0.0, {10: 0.0}),
    ):
        engage = parts.engage.model_copy(update={"blend_s": blend_s})
        cycle, _ = a_cycle(parts, engage=engage)
        np.testing.assert_allclose(filled(cycle, Mode.TRACKING, 9)["tau_asked"], HOLDING)
        cycle.effort.entry_tick = 10
        for number, share in shares.items():
            tick = filled(cycle, Mode.TRACKING, number)
            np.testing.assert_allclose(tick["tau_asked"], OWN + share * (HOLDING - OWN), rtol=1e-12)


def test_what_holds_a_platform_is_the_books_force_for_its_weight_and_more_where_a_load_hangs_on_it(parts):
    cycle, _ = a_cycle(parts)
    home = parts.home_p, parts.home_R
    np.testing.assert_allclose(cycle.effort.statics(*home, np.zeros(6)), 3618.625746, atol=1e-4)
    assert cycle.effort.statics(*home, WRENCH).min() > 3618.7
    assert cycle.effort.reach_N == float(parts.safety.limits["force_window_N"])


@pytest.mark.parametrize("on_it", [None, False, True])
def test_the_entry_offset_is_what_the_law_leaves_of_the_holding_force_where_the_platform_was_measured(
    parts, monkeypatch, on_it
):
    cycle, law = a_cycle(parts)
    tick, sample, asked = record_of(tick=9), cycle.motion.sample(9), list[Any]()
    monkeypatch.setattr(effort_module, "tau_at_rest", lambda *of, on_it: asked.append((*of, on_it)) or OWN)  # type: ignore[func-returns-value]
    cycle.effort.entry_tick = 4
    cycle.effort.hold(tick, HOLDING, sample, **({} if on_it is None else {"on_it": on_it}))
    ((asked_of, *of),) = asked
    assert asked_of.law is law
    assert of == [parts.platform, tick, sample, bool(on_it)]
    np.testing.assert_array_equal(cycle.effort.offset, HOLDING - OWN)
    np.testing.assert_array_equal(cycle.effort.holding, HOLDING)
    assert cycle.effort.entry_tick is None


def test_learned_forces_act_on_the_reference_of_the_loop_and_come_and_go_in_their_own_time(parts):
    assert a_cycle(parts)[0].effort.learned is None
    cycle, _ = a_cycle(parts, learned=FORCES)
    assert cycle.effort.learned is not None
    assert cycle.effort.learned.forces is FORCES
    assert cycle.effort.learned._trajectory is parts.trajectory
    assert cycle.effort.learned._record["step"] == pytest.approx(1e-3 / 0.05)
