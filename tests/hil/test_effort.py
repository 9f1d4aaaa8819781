"""The force requested in a tick: law, entry offset, learned force, ramps, and the window while held."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import Callee, data_at, of_python
from drivers.frame_array import FRAME
from drivers.signals import LEGS, DriveState, Fault, Mode
from drivers.tick_columns import Record, copy_of
from hil.app.compose import build_cycle
from hil.contracts.records import record_of
from hil.estimation.external_wrench import ExternalWrench
from hil.loop import modes
from hil.loop.compiled_pass import EFFORT, act
from hil.loop.cycle import Cycle
from hil.loop.reference import LearnedForces, holding_share, smoothstep, tau_at_rest
from hil.robot.force_path import ForcePath
from hil.robot.kinematics import leg_lengths
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import PoseSample
from tests.hil.cycle_bench import VIRTUAL

OWN = np.array([100.0, -200.0, 300.0, -400.0, 500.0, -600.0])
HOLDING = np.array([900.0, 800.0, 700.0, 600.0, 500.0, 400.0])
LEARNED = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
SHORTFALL = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
WRENCH = np.array([0.0, 0.0, -500.0, 10.0, 0.0, 0.0])
KEPT: list[Any] = []
"""References that keep the callbacks of a test alive."""
FORCES = LearnedForces(np.zeros((3, 6)), -0.1, 0.1, 0.05)


class Law:
    """A law with a constant force. State: the last tick, and the calls."""

    def __init__(self) -> None:
        self.own = OWN
        self.seen: Record | None = None
        self.calls: list[str] = []

    def reset(self) -> None:
        self.calls.append("reset")

    def effort(self, tick: Record) -> None:
        self.calls.append("effort")
        self.seen = copy_of(tick)
        tick["tau_law"] = self.own


@pytest.fixture(scope="module")
def parts() -> Any:
    return build_cycle(VIRTUAL, 1000.0, 0.01).parts


def a_cycle(parts: Any, **different: Any) -> tuple[Cycle, Law]:
    """A cycle with this law, at rest at a sample, with the holding force."""
    law = Law()
    cycle = Cycle(replace(parts, law=law, **different))
    cycle.motion.rest(parts.home_p, parts.home_R, 1)
    cycle.effort.hold(record_of(tick=1), HOLDING, cycle.motion.sample(1))
    law.seen = None
    return cycle, law


def filled(
    cycle: Cycle, mode: Mode, number: int = 2, *, since: int = 1, free: bool = True, **columns: Any
) -> Record:
    """A tick with its requested force, in a mode entered at tick `since`."""
    tick = record_of(tick=number, drive_state=int(DriveState.RUN if free else DriveState.OFF), **columns)
    cycle.tick, cycle.mode, cycle.mode_tick = tick, mode, since
    cycle.control.settle()
    record = cycle.control.record
    record["tick"] = data_at(tick)
    act(record, tick, np.empty(1, FRAME), EFFORT)
    return tick


def learns(cycle: Cycle) -> list[tuple[int, ...]]:
    """Make LEARNED the learned force; return a list that collects the arguments of each call."""
    calls: list[tuple[int, ...]] = []

    def look(*given: int) -> int:
        calls.append(given[:-1])
        (ctypes.c_double * LEGS).from_address(given[-1])[:] = list(LEARNED)
        return 1

    cycle.control.record["learn"], keeps = of_python(look, *[INTEGER] * 9)
    KEPT.append(keeps)
    return calls


class Predictor:
    """Predicts no motion. State: True if the brakes were open in the last tick."""

    horizon_s = 1e-3
    free: bool | None = None
    path = ForcePath(1e-3, 0.0, 0.0)

    def __init__(self) -> None:
        address, keeps = of_python(self._ahead, *[INTEGER] * 3)
        self.look = Callee(address, 0, keeps)

    def reset(self) -> None:
        """Nothing to reset."""

    def _ahead(self, _context: int, free: int, _tick: int) -> int:
        self.free = bool(free)
        return 0


# -- the entry offset


def test_force_offset_at_the_entry_of_the_law_fades_over_blend_s_or_ends_at_once(parts):
    for blend_s, shares in (
        (0.1, {10: 1.0, 35: 1.0 - QUARTER, 60: 0.5, 110: 0.0, 999: 0.0}),
        (0.0, {10: 0.0}),
    ):
        cycle, _ = a_cycle(parts, engage=parts.engage.model_copy(update={"blend_s": blend_s}))
        np.testing.assert_allclose(filled(cycle, Mode.TRACKING, 9)["tau_asked"], HOLDING)
        cycle.effort.entry_tick = 10
        for number, share in shares.items():
            tick = filled(cycle, Mode.TRACKING, number)
            np.testing.assert_allclose(tick["tau_asked"], OWN + share * (HOLDING - OWN), rtol=1e-12)


def test_compensated_wrench_fades_in_as_the_force_offset_at_entry_fades_out(parts):
    cycle, law = a_cycle(parts, wrench=ExternalWrench(None, 1000.0, 1e-3))
    cycle.effort.entry_tick = 10
    blend = round(parts.engage.blend_s * parts.rate_Hz)
    for number, share in ((10, 0.0), (10 + blend // 2, 0.5), (10 + blend, 1.0)):
        tick = filled(cycle, Mode.TRACKING, number, wrench=WRENCH)
        assert law.seen is not None
        np.testing.assert_allclose(law.seen["wrench"], share * WRENCH, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(tick["wrench"], WRENCH)  # safety judges the whole
        np.testing.assert_allclose(tick["tau_asked"], OWN + (1.0 - share) * (HOLDING - OWN))


# -- what is held, and what was learned


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_law_force_of_a_held_platform_stays_within_a_window_about_the_holding_force(parts, way):
    cycle, law = a_cycle(parts)
    law.own = OWN + way * 1e6
    np.testing.assert_allclose(filled(cycle, Mode.HELD)["tau_asked"], HOLDING + way * cycle.effort.reach_N)
    for mode in sorted(modes.CONTROLLED - {Mode.HELD}):
        np.testing.assert_allclose(filled(cycle, mode)["tau_asked"], HOLDING + way * 1e6)


def test_learned_forces_are_added_except_for_a_held_platform(parts):
    cycle, law = a_cycle(parts, learned=FORCES)
    learned = cycle.effort.learned
    assert learned is not None
    assert (learned.forces, learned._trajectory) == (FORCES, parts.trajectory)
    assert learned._record["step"] == pytest.approx(1e-3 / 0.05)
    calls = learns(cycle)
    moving = filled(cycle, Mode.TRACKING, 9, since=4)
    np.testing.assert_array_equal(moving["tau_asked"], HOLDING + LEARNED)
    np.testing.assert_array_equal(moving["tau_learned"], LEARNED)
    moves = data_at(cycle.motion.record), data_at(cycle.motion.override.record)
    assert calls[-1][1:] == (*moves, 9, Mode.TRACKING, 4, 0, Fault.NONE)
    cycle.faults = Fault.DRIVE
    filled(cycle, Mode.PARKING)
    assert calls[-1][-1] == Fault.DRIVE
    held = filled(cycle, Mode.HELD)
    np.testing.assert_array_equal(held["tau_asked"], HOLDING)
    assert not held["tau_learned"].any()
    law.seen, cycle.faults, cycle.effort.holding = None, Fault.STALE, SHORTFALL
    blind = filled(cycle, Mode.HELD, 9)
    np.testing.assert_array_equal(blind["tau_asked"], SHORTFALL)
    assert law.seen is None, "the law must not be called while the force is fixed"
    assert not blind["tau_learned"].any()


# -- what the law sees


@pytest.mark.parametrize("predicts", [True, False])
def test_law_receives_the_force_shortfall_and_its_own_force_is_recorded(parts, predicts):
    predictor = Predictor() if predicts else None
    cycle, law = a_cycle(parts, predictor=predictor)
    for free in (True, False):
        filled(cycle, Mode.RELEASING, free=free)
        assert predictor is None or predictor.free is free, "the predictor knows if the brakes are open"
    cycle.control.record["shortfall"] = SHORTFALL
    np.testing.assert_array_equal(filled(cycle, Mode.TRACKING)["tau_law"], OWN)
    assert law.seen is not None
    np.testing.assert_array_equal(law.seen["shortfall"], SHORTFALL)


@pytest.mark.parametrize("number", [3, 500])
def test_law_with_delay_compensation_reads_learned_forces_at_the_time_its_force_acts(parts, number):
    """The path begins in tick 2; at another speed than the clock's the table has no time."""
    cycle, law = a_cycle(parts, predictor=Predictor())
    cycle.motion.start(parts.trajectory, 2)
    filled(cycle, Mode.TRACKING, number)
    assert law.seen is not None
    assert law.seen["t_d"] == pytest.approx(1e-3 * (number - 2) + Predictor.horizon_s, abs=1e-12)
    filled(cycle, Mode.STOPPING, number)
    assert np.isnan(law.seen["t_d"])
    cycle.motion.settle(number, 0.5)
    filled(cycle, Mode.TRACKING, number + 1)
    assert np.isnan(law.seen["t_d"])


@pytest.mark.parametrize(("left", "t_d"), [(0, None), (1, 1.5e-3), (2, 0.5e-3), (3, None), (9, None)])
def test_learned_forces_are_read_from_the_first_force_that_acts_on_the_path(parts, left, t_d):
    """The approach ends `left` ticks later; its last force may already act on the path."""
    predictor = Predictor()
    predictor.horizon_s = 2.5e-3
    cycle, law = a_cycle(parts, predictor=predictor)
    rest = cycle.motion.sample(1)
    cycle.motion.start(GeodesicMove(rest.p, rest.R, rest.p, rest.R, 0.0995), 0, then=parts.trajectory)
    filled(cycle, Mode.APPROACH, 100 - left)
    assert law.seen is not None
    assert law.seen["t_d"] == pytest.approx(np.nan if t_d is None else t_d, abs=1e-12, nan_ok=True)


# -- ramps


QUARTER = 0.103515625
"""10/4^3 - 15/4^4 + 6/4^5."""


@pytest.mark.parametrize(
    ("mode", "elapsed_s", "share"),
    [
        (Mode.LOADING, 0.2, 0.0),
        (Mode.LOADING, 0.25, QUARTER),
        (Mode.LOADING, 0.4, 1.0),
        (Mode.UNLOADING, 0.0, 1.0),
        (Mode.UNLOADING, 0.05, 1.0 - QUARTER),
        (Mode.UNLOADING, 0.2, 0.0),
    ],
)
def test_holding_force_ramp_starts_one_ramp_time_late_on_loading_at_once_on_unloading(mode, elapsed_s, share):
    assert holding_share(mode, elapsed_s, 0.2) == pytest.approx(share, abs=1e-12)
    assert [smoothstep(x) for x in (-2.0, 0.25, 0.5, 0.75, 3.0)] == [0.0, QUARTER, 0.5, 1.0 - QUARTER, 1.0]


@pytest.mark.parametrize(
    "mode", [Mode.WAITING, Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED, Mode.FAULT]
)
@pytest.mark.parametrize("load_s", [0.0, 0.2])
def test_only_loading_and_unloading_request_a_share_of_the_holding_force_without_the_law(parts, mode, load_s):
    cycle, law = a_cycle(parts, engage=parts.engage.model_copy(update={"force_ramp_s": load_s}))
    tick = filled(cycle, mode, 104, since=4, free=False, tau_asked=LEARNED)
    share = {Mode.LOADING: 0.0, Mode.UNLOADING: 0.5}.get(mode) if load_s else None
    np.testing.assert_allclose(tick["tau_asked"], LEARNED if share is None else share * HOLDING)
    assert law.seen is None


@pytest.mark.parametrize("on_it", [False, True])
def test_force_at_rest_is_that_of_a_reset_law_without_external_load(parts, on_it):
    law: Any = Law()
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    there = PoseSample(np.array([0.01, 0.02, 1.0]), np.eye(3), np.zeros(6), np.zeros(6))
    measured: dict[str, Any] = {"q": 1.5, "p": [0.1, 0.2, 0.9], "R": turned, "dq": 0.3, "twist": 0.4}
    tick = record_of(wrench=7.0, tau_law=99.0, **measured)
    before = tick.tobytes()
    np.testing.assert_array_equal(tau_at_rest(law, parts.platform, tick, there, on_it=on_it), OWN)
    assert tick.tobytes() == before, "the tick record must not change"
    assert law.calls == ["reset", "effort", "reset"], "the law must be reset after the call"
    seen = law.seen
    assert not seen["wrench"].any()
    length = leg_lengths(parts.platform, there.p, there.R)
    np.testing.assert_allclose(seen["q_d"], length, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(seen["p_d"], there.p)
    if on_it:
        measured = {"p": there.p, "R": there.R, "q": seen["q_d"], "dq": 0.0, "twist": 0.0}
    for name, value in measured.items():
        np.testing.assert_array_equal(seen[name], np.broadcast_to(value, seen[name].shape))
