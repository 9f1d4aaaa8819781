"""Brake failures at every moment: their effect, from the first tick to the last, and the rule that finds
them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveMode, Fault, Mode
from hil.app.configuration.configuration import load
from hil.app.sim.lockstep import Lockstep
from hil.loop.run_end import Course
from hil.signals import Operator, TickInput
from plant_fmu.faults.fault import Fault as PlantFault
from plant_fmu.faults.kinds import BrakeStuckOpen, DriveSilence, EncoderLost
from tests.broad import broad
from tests.loop.bench import Ran, bench, changed, run, until

BOUND_m = 10e-3
"""Largest motion of a leg due to a brake."""
STOP_S = 2.0
"""Time of the stop: on the book's path, in mid-motion."""
LEGS = range(6)


@pytest.fixture(scope="module")
def good() -> Ran:
    return run(load("virtual"), stop_s=STOP_S)


@pytest.fixture
def stuck(good: Ran) -> BrakeStuckOpen:
    return BrakeStuckOpen(leg=2, at_s=good.within(Mode.TRACKING, 0.5))


def assert_held(ran: Ran, legs: Sequence[int], since: Mode) -> None:
    """Assert that the run ends held because of these legs, and that nothing moved far since a mode."""
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert not ran.ending.success
    assert ran.ending.faults == Fault.BRAKE
    assert ran.ending.story is not None
    found = {each.leg for each in ran.ending.story.findings if each.leg is not None}
    assert found
    assert found <= set(legs), ran.ending.reason
    assert "limits.standstill_m" in ran.ending.reason
    held = ran.rows[ran.rows["mode"] == Mode.HELD]
    assert (held["command_mode"] == DriveMode.READY).all(), "the brakes are commanded to close"
    assert np.abs(held["tau"][-1]).max() > 0
    assert ran.moved(ran.first(since)) < BOUND_m
    still = ran.true[-300:]
    assert np.abs(still - still[-1]).max() < 50e-6, "the platform has come to rest"


def test_good_brakes_pass_the_tests_before_and_after_motion_and_the_run_succeeds(good):
    assert good.ending.success, good.ending
    for mode, force_off_s in ((Mode.LOADING, 0.3), (Mode.UNLOADING, 0.1)):
        rows = good.rows[good.rows["mode"] == mode]
        off = (np.abs(rows["tau"]) < 1e-6).all(axis=1)
        assert off.sum() >= 1000 * force_off_s
        assert (rows["command_mode"] == DriveMode.READY).all()
        assert np.abs(rows["q"] - rows["q"][0]).max() < 50e-6
    assert not good.rows["legs_moved"].any()


@pytest.mark.parametrize("legs", broad([[0], [*LEGS], [1], [2], [3], [4], [5]], quick=2), ids=str)
def test_brakes_that_do_not_close_are_detected_and_their_legs_held_by_force(good, legs):
    since = good.within(Mode.TRACKING, 0.5)
    ran = run(load("virtual"), *(BrakeStuckOpen(leg=leg, at_s=since) for leg in legs), stop_s=STOP_S)
    assert_held(ran, legs, Mode.UNLOADING)


OPENS = [
    (Mode.IDLE, 0.5),
    (Mode.LOADING, 0.1),
    (Mode.LOADING, 0.6),
    (Mode.UNLOADING, 0.3),
    (Mode.UNLOADING, 0.9),
]


@pytest.mark.parametrize(
    ("mode", "share", "legs"),
    [
        *((mode, share, (3,)) for mode, share in OPENS),
        *broad([(*each, tuple(LEGS)) for each in OPENS], quick=1),
    ],
    ids=[f"{m.name} {s} {which}" for which in ("one", "all") for m, s in OPENS],
)
def test_brake_that_opens_under_load_is_detected_and_its_leg_held_by_force(good, mode, share, legs):
    since = good.within(mode, share)
    ran = run(load("virtual"), *(BrakeStuckOpen(leg=leg, at_s=since) for leg in legs), stop_s=STOP_S)
    assert_held(ran, legs, Mode.UNLOADING if mode is Mode.UNLOADING else Mode.IDLE)


PD = {"law": "pd", "kp_N_m": 2e6, "kv_N_s_m": 5e4}
"""A law without gravity feed-forward."""


@pytest.mark.parametrize(
    ("name", "controller", "leg"),
    [("virtual", PD, 4), *(pytest.param(name, {}, 2, marks=pytest.mark.long) for name in ("lab", "bench"))],
)
def test_leg_with_an_open_brake_is_held_by_force_under_other_laws_and_robots(name, controller, leg):
    c = changed(name, controller=controller) if controller else load(name)
    good = run(c, stop_s=STOP_S)
    assert good.ending.success, good.ending
    ran = run(c, BrakeStuckOpen(leg=leg, at_s=good.within(Mode.TRACKING, 0.7)), stop_s=STOP_S)
    assert_held(ran, (leg,), Mode.UNLOADING)


def test_brake_weaker_than_its_load_is_detected():
    """3.2 kN of brake under a load of 3.6 kN."""
    ran = run(changed("virtual", plant={"model": {"brake_force_N": 3200}}), stop_s=STOP_S)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.moved(0) < BOUND_m


def test_leg_that_falls_after_parking_without_a_brake_test_is_detected_and_held():
    """The ideal configuration parks without a brake test; the legs are watched for a moment before the run
    ends.
    """
    ran = run(load("ideal"), BrakeStuckOpen(leg=1, at_s=0.5), stop_s=1.2)
    assert_held(ran, (1,), Mode.PARKED)


def test_brake_that_closes_too_slowly_is_detected():
    """The brake takes 250 ms, and the controller waits for 100: it is open in the first half of the test."""
    c = load("virtual")
    assert c.plant is not None
    drives = c.plant.drives.model_copy(update={"brake_close_ms": 250.0})
    ran = run(c.model_copy(update={"plant": c.plant.model_copy(update={"drives": drives})}), stop_s=STOP_S)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.moved(ran.first(Mode.UNLOADING)) < BOUND_m


@pytest.mark.parametrize("fault", [DriveSilence, EncoderLost])
def test_brake_test_of_a_leg_without_measurement_is_not_passed_and_holding_forces_return(good, fault):
    """The holding force of all legs returns, and stays constant: control is impossible."""
    ran = run(load("virtual"), fault(leg=5, at_s=good.within(Mode.UNLOADING, 0.4)), stop_s=STOP_S)
    assert (ran.ending.mode, ran.ending.faults) == (Mode.HELD, Fault.STALE)
    assert "leg 5" in ran.ending.reason
    held = ran.rows[ran.rows["mode"] == Mode.HELD]
    before = ran.rows[ran.rows["mode"] == Mode.PARKING][-1]["tau"]
    np.testing.assert_allclose(held["tau"][-1], before, atol=5.0)
    assert ran.moved(ran.first(Mode.PARKING)) < 50e-6


def test_run_that_ends_held_by_force_after_a_brake_fault_replays_to_the_bit(stuck):
    inputs: list[TickInput] = []
    ran = run(load("virtual"), stuck, stop_s=STOP_S, watch=lambda _, inp, __: inputs.append(inp))
    ran.cycle.reset()
    for inp, row in zip(inputs, ran.rows, strict=True):
        ran.cycle.begin(inp.tick)
        assert ran.cycle.step(inp).row.tobytes() == row.tobytes()


# -- the daemon's course -------------------------------------------------------------------------------------


@contextmanager
def held(fault: PlantFault, **sections: Any) -> Iterator[tuple[Lockstep, Course]]:
    """A run that is held, and continues."""
    with bench(changed("virtual", **sections), fault) as lockstep:
        course = Course(lockstep.cycle, STOP_S, stays=True)
        until(lockstep, Mode.HELD, course)
        yield lockstep, course


def test_run_holds_a_leg_with_a_failed_brake_until_release_and_ends_when_all_legs_rest(stuck):
    with held(stuck, plant={"model": {"viscous_friction_N_s_m": 300}}) as (lockstep, course):
        cycle, nodes = lockstep.cycle, lockstep.nodes
        for k in range(3000):
            lockstep.step(course.commands(lockstep.tick + 1, (Operator.STOP,) if k % 500 == 0 else ()))
            assert course.ending(lockstep.tick) is None
        assert cycle.mode is Mode.HELD
        assert "--release" in course.stays_for
        assert "leg 2 moved" in course.stays_for
        lockstep.step(course.commands(lockstep.tick + 1, (Operator.RELEASE,)))
        assert Mode(cycle.mode).name == "FAULT"
        ending, fell, said = None, False, set()
        for _ in range(20_000):
            lockstep.step(course.commands(lockstep.tick + 1))
            fell = fell or np.abs(nodes.snapshot().rate).max() > 0.1
            ending = course.ending(lockstep.tick)
            said.add(course.stays_for)
            if ending is not None:
                break
        assert fell, "the platform was released"
        assert any("still moves" in text for text in said)
        assert ending is not None
        assert (ending.mode, ending.released, ending.success) == (Mode.FAULT, True, False)
        assert np.abs(nodes.snapshot().rate).max() < 0.02


def test_only_an_emergency_stop_ends_a_run_whose_released_leg_never_comes_to_rest(stuck):
    """Without any friction the released leg swings for ever."""
    with held(stuck) as (lockstep, course):
        lockstep.step(course.commands(lockstep.tick + 1, (Operator.RELEASE,)))
        for _ in range(3000):
            lockstep.step(course.commands(lockstep.tick + 1))
            assert course.ending(lockstep.tick) is None
        assert "still moves" in course.stays_for
        lockstep.step(course.commands(lockstep.tick + 1, (Operator.ESTOP,)))
        ending = course.ending(lockstep.tick)
    assert ending is not None
    assert "still moving: leg" in ending.reason


def test_no_operator_command_except_emergency_stop_drops_a_platform_held_by_force(stuck):
    with held(stuck) as (lockstep, _):
        for operator in (Operator.RESET, Operator.ENGAGE, Operator.STOP):
            lockstep.step((operator,))
            lockstep.step()
            assert lockstep.cycle.mode is Mode.HELD
            assert lockstep.cycle.faults == Fault.BRAKE
        lockstep.step((Operator.ESTOP,))
        assert lockstep.cycle.mode is Mode.FAULT
        assert lockstep.cycle.faults & Fault.ESTOP
