"""What a cycle is made of, each in its place, and that a reset puts every part of its memory back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Fault, Mode, Stop
from drivers.tick_columns import new_record
from hil.app.compose import build_cycle
from hil.contracts.records import record_of
from hil.loop.cycle import Cycle
from hil.loop.homing import LastPose
from hil.loop.modes import Durations
from hil.robot.kinematics import leg_lengths
from hil.trajectory.override import PEAK
from tests.hil.test_cycle import Bench
from tests.hil.test_cycle_again import LIVE, VIRTUAL, a_bench

UNLIKE = VIRTUAL.engage.model_copy(
    update={"force_ramp_s": 0.02, "brake_release_s": 0.03, "brake_close_s": 0.07, "stop_s": 0.9}
)


@pytest.fixture
def cycle() -> Cycle:
    return build_cycle(VIRTUAL.model_copy(update={"engage": UNLIKE}), 500.0, 0.01)


def test_stroke_times_and_reactions_of_the_configuration_each_come_to_their_place(cycle):
    stroke, platform = cycle.homing._stroke, VIRTUAL.platform
    assert (stroke.shortest, stroke.longest) == (platform.length_min_m, platform.length_max_m)
    assert cycle.durations == Durations(0.02, 0.03, UNLIKE.closing_s) == cycle.effort.durations
    assert cycle.homing._period_s == cycle.motion.period_s == cycle.effort.period_s == 0.002
    assert cycle.operating.least_s == 0.9
    assert cycle.motion.override.record["limit"] == pytest.approx(PEAK / 0.9)
    parts, reactions = cycle.parts, VIRTUAL.reactions
    np.testing.assert_array_equal(cycle.first.p, parts.trajectory.sample(0.0).p)
    judge: Any = cycle.operating._judged
    assert judge.args == (parts.platform, parts.admission.on_the_way)
    assert cycle._under_control == reactions.led_to("ss1") != reactions.led_to("sto") == cycle._torque_off


def test_where_a_jog_comes_to_rest_is_judged_but_by_the_steering_where_the_reference_is_live(cycle):
    live = build_cycle(VIRTUAL.model_copy(update={"reference": LIVE}), 500.0, 0.01)
    assert cycle.operating.jogging._admission is cycle.parts.admission
    assert live.operating.jogging._admission is None
    assert live.parts.steering is not None


def test_a_reset_of_the_cycle_puts_every_part_of_its_memory_back(cycle, monkeypatch):
    fresh = cycle.end.remembered()
    told: list[str] = []
    names = ("sight", "homing", "effort", "obedience", "operating")
    for name in names:
        monkeypatch.setattr(getattr(cycle, name), "reset", lambda name=name: told.append(name))
    cycle.mode, cycle.mode_tick, cycle.reset_tick = Mode.HELD, 77, 5
    cycle._yields, cycle.proven, cycle.estop = True, False, True
    cycle.faults, cycle.stop_requested = Fault.BRAKE, Stop.MISSED
    cycle.tick = record_of(tick=9, length=1.0)
    cycle.end.state["sent"] = 9
    cycle.motion.rest(np.ones(3), np.eye(3), 8)
    cycle.reset()
    assert sorted(told) == sorted(names)
    assert (cycle.mode, cycle.mode_tick, cycle.reset_tick) == (Mode.WAITING, 0, None)
    assert (cycle._yields, cycle.proven, cycle.estop) == (False, True, False)
    assert (cycle.faults, cycle.stop_requested) == (Fault.NONE, Stop.NONE)
    assert cycle.tick.tobytes() == new_record().tobytes()
    assert cycle.end.remembered() == fresh
    np.testing.assert_array_equal(cycle.motion.sample(3).p, cycle.parts.home_p)
    assert cycle.motion.time(3) == 3 * 0.002


def test_turns_that_drives_have_forgotten_come_to_their_lengths_and_none_to_a_leap_behind_open_brakes():
    parts = a_bench().cycle.parts
    true = leg_lengths(parts.platform, parts.home_p, parts.home_R)
    step = np.full(6, 0.01)
    pose = LastPose(true, np.full(6, 1e-4), step, step, "parked", "hil homing")
    cycle = Cycle(replace(parts, last_pose=pose))
    bench = Bench(cycle=cycle)
    bench.drives.length = true - step * np.array([1, 2, 3, 4, 5, 6])
    bench.until(Mode.RELEASING)
    np.testing.assert_allclose(bench.cycle.tick["length"], true, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(bench.cycle.homing.raw, bench.drives.length, rtol=0.0, atol=1e-6)
    assert cycle.homing.known
    assert not cycle.homing.opened
    bench.step()
    assert cycle.homing.opened
    bench.drives.length = bench.drives.length + step * (np.arange(6) == 4)
    bench.step()
    assert "leg 4: its drive was switched off" in cycle.homing.refusal
