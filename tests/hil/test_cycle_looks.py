"""Ticks in which the cycle has to decide though neither its drives nor its operator have any news for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Fault, Mode, Stop
from hil.app.compose import build_cycle
from hil.loop.cycle import Cycle
from hil.loop.homing import LastPose
from hil.robot.kinematics import leg_lengths
from hil.signals import Operator
from hil.trajectory.move import GeodesicMove
from tests.hil.test_cycle import Bench, held_to
from tests.hil.test_cycle_again import BRISK, VIRTUAL, a_bench


def test_what_is_not_measured_any_more_while_it_parks_is_held_by_the_force_of_the_tick_before():
    bench = Bench()
    bench.until(Mode.APPROACH)
    bench.step((Operator.STOP,))
    while bench.cycle.mode is not Mode.PARKING:
        bench.step()
        assert bench.tick < 5000
    bench.drives.silent = {2}
    while bench.cycle.mode is Mode.PARKING:
        last = bench.cycle.tick["tau"].copy()
        bench.drives.length = bench.drives.length + 1e-6  # which the law pushes against
        bench.step()
    assert bench.cycle.mode is Mode.HELD
    np.testing.assert_array_equal(bench.cycle.effort.holding, last)
    bench.step()
    np.testing.assert_array_equal(bench.cycle.tick["tau_asked"], last)


@pytest.mark.parametrize("cause", ["a stop", "a fault"])
def test_the_way_back_to_the_first_pose_ends_where_safety_asks_for_a_stop(cause):
    reactions = VIRTUAL.reactions.model_copy(update={"following": "ss1"})
    bench = a_bench(reactions=reactions)
    bench.until(Mode.APPROACH)
    cycle = bench.cycle
    home = cycle.motion.sample(bench.tick)
    cycle.motion.start(GeodesicMove(home.p, home.R, home.p, home.R, 1.0), bench.tick)
    cycle.operating.go = cycle.operating.parks = True
    cycle.mode = Mode.STOPPING
    cycle.control.settle()
    for _ in range(3):
        bench.step()
    assert cycle.operating.parks, "it is on its way"
    if cause == "a stop":
        with held_to(bench, stop_on_recorder_loss=1):
            bench.step(recorder_alive=False)
        assert cycle.stop_requested is Stop.RECORDER
    else:
        with held_to(bench, following_error_m=-1.0):
            bench.step()
        assert cycle.faults == Fault.FOLLOWING
    assert cycle.operating.parks
    bench.step()
    assert (cycle.mode, cycle.mode_tick) == (Mode.STOPPING, bench.tick)
    assert not cycle.operating.parks


@pytest.fixture
def parts() -> Any:
    return made()


def made() -> Any:
    """Return the parts of a cycle that is quickly under way."""
    return build_cycle(VIRTUAL.model_copy(update={"engage": BRISK}), 1000.0, 0.01).parts


def test_a_drive_whose_turns_are_no_longer_known_is_waited_for_again(parts):
    true = leg_lengths(parts.platform, parts.home_p, parts.home_R)
    step = np.full(6, 0.01)
    pose = LastPose(true, np.full(6, 1e-4), step, step, "parked", "hil homing")
    bench = Bench(cycle=Cycle(replace(parts, last_pose=pose)))
    bench.until(Mode.IDLE)
    for _ in range(5):
        bench.step()
    modes = [bench.cycle.mode]
    bench.drives.length = true + 0.006 * (np.arange(6) == 3)
    bench.step()
    assert bench.cycle.homing.refusal
    assert [*modes, bench.cycle.mode] == [Mode.IDLE, Mode.WAITING]


class Failing:
    """A law that meets an error."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def reset(self) -> None:
        """Nothing is kept."""

    def effort(self, tick: Any) -> None:
        if tick["tick"] >= 100:
            raise self.error
        tick["tau_law"] = 0.0


def test_a_law_that_raises_is_a_latched_fault(parts):
    error = ZeroDivisionError("a defect")
    bench = Bench(cycle=Cycle(replace(parts, law=Failing(error))))
    bench.until(Mode.IDLE)
    bench.step((Operator.ENGAGE,))
    while not bench.cycle.faults:
        assert bench.tick < 1000
        bench.step()
    assert bench.cycle.faults == Fault.LAW
    assert bench.cycle.effort.law.keeps.raised is error
    assert np.isnan(bench.cycle.tick["tau_law"]).all()


def test_ctrl_c_in_a_law_ends_the_step_in_which_it_came(parts):
    bench = Bench(cycle=Cycle(replace(parts, law=Failing(KeyboardInterrupt()))))
    with pytest.raises(KeyboardInterrupt):
        bench.until(Mode.TRACKING)
    bench.cycle.reset()
    bench.step()
    assert bench.cycle.mode is Mode.WAITING
