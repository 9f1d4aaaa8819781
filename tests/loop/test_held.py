"""Held at every moment: what a brake does that fails, from the first tick to the last, and who notices."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.signals import DriveMode, Fault, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.sim.lockstep import Lockstep
from hil.loop.cycle import Cycle
from hil.loop.run_end import Course, Ending
from hil.signals import Operator, TickInput
from plant_fmu.faults.fault import Fault as PlantFault
from plant_fmu.faults.kinds import BrakeStuckOpen, DriveSilence, EncoderLost
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad

BOUND_m = 10e-3
"""No leg may move by more because of a brake."""
DURATION_S = 2.0
"""When the runs are stopped: on the book's path, in mid-motion."""
LEGS = range(6)


class Ran(NamedTuple):
    ending: Ending
    rows: Any
    true: Any
    """(n, 6) m, the plant's own lengths at each tick."""
    inputs: list[TickInput]
    cycle: Cycle

    def first(self, mode: Mode) -> int:
        return int(np.argmax(self.rows["mode"] == mode))

    def moved(self, since: int) -> float:
        """Return how far the farthest leg was from its place at a tick, m."""
        return float(np.abs(self.true[since:] - self.true[since]).max())


def configuration(name: str, *changes: tuple[str, str]) -> Configuration:
    c = load(name)
    text = c.text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, c.name, c.folder)


def run(c: Configuration, *faults: PlantFault, duration_s: float | None = DURATION_S) -> Ran:
    rate = c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    nodes, plant = build_nodes(c, FaultPlan(faults))
    timing = None if c.bus.layout == "ideal" else BitTiming.of(c.bus)
    lockstep = Lockstep(cycle, nodes, (timing,), c.loop.window_s(rate))
    kept: list[Any] = []
    true: list[Any] = []
    inputs: list[TickInput] = []

    def observe(inp: TickInput, _opening: object, out: Any) -> None:
        kept.append(out.row)
        true.append(nodes.snapshot().length)
        inputs.append(inp)

    try:
        ending = lockstep.run(duration_s, observe)
    finally:
        plant.close()
    return Ran(ending, np.array(kept, kept[0].dtype), np.array(true), inputs, cycle)


@pytest.fixture(scope="module")
def good() -> Ran:
    return run(load("virtual"))


def begins(good: Ran, mode: Mode, share: float = 0.0) -> float:
    """Return a time within a mode of the run without faults, s."""
    ticks = np.flatnonzero(good.rows["mode"] == mode)
    return float(1e-3 * (ticks[0] + share * len(ticks)))


def assert_held(ran: Ran, legs: tuple[int, ...], since: Mode) -> float:
    """Assert that the run ends held, named, without success; return how far a leg moved since a mode, m."""
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert not ran.ending.success
    assert ran.ending.faults == Fault.BRAKE
    assert ran.ending.story is not None
    named = {each.seen.leg for each in ran.ending.story.findings if each.seen.leg is not None}
    assert named
    assert f"leg {', '.join(map(str, sorted(named)))} moved" in ran.ending.reason
    assert named <= set(legs), ran.ending.reason
    assert "limits.standstill_m is 0.5 mm" in ran.ending.reason
    held = ran.rows[ran.rows["mode"] == Mode.HELD]
    assert (held["command_mode"] == DriveMode.READY).all(), "the brakes are asked to close"
    assert np.abs(held["tau"][-1]).max() > 0
    moved = ran.moved(ran.first(since))
    assert moved < BOUND_m, f"{1e3 * moved:.2f} mm"
    still = ran.true[-300:]
    assert np.abs(still - still[-1]).max() < 50e-6, "it has come to rest"
    return moved


def test_a_good_brake_passes_both_tests_and_the_run_is_a_success(good):
    assert good.ending.success, good.ending
    for mode, force_off_s in ((Mode.LOADING, 0.3), (Mode.UNLOADING, 0.1)):
        rows = good.rows[good.rows["mode"] == mode]
        off = (np.abs(rows["tau"]) < 1e-6).all(axis=1)
        assert off.sum() >= 1000 * force_off_s
        assert (rows["command_mode"] == DriveMode.READY).all()
        assert np.abs(rows["q"] - rows["q"][0]).max() < 50e-6
    assert not good.rows["legs_moved"].any()


@pytest.mark.parametrize("leg", broad(LEGS, quick=1))
def test_a_brake_that_does_not_close_when_parking_is_found_and_its_leg_held(good, leg, capsys):
    """Before: 401 mm, PARKED, success."""
    ran = run(load("virtual"), BrakeStuckOpen(leg=leg, at_s=begins(good, Mode.TRACKING, 0.5)))
    moved = assert_held(ran, (leg,), Mode.UNLOADING)
    assert f"leg {leg} moved" in ran.ending.reason
    with capsys.disabled():
        print(f"\nbrake of leg {leg} open when parking: {1e3 * moved:.2f} mm")


def test_six_brakes_that_do_not_close_when_parking_leave_the_platform_on_its_force(good, capsys):
    """Before: 352 mm."""
    since = begins(good, Mode.TRACKING, 0.5)
    ran = run(load("virtual"), *[BrakeStuckOpen(leg=leg, at_s=since) for leg in LEGS])
    moved = assert_held(ran, tuple(LEGS), Mode.UNLOADING)
    with capsys.disabled():
        print(f"\nsix brakes open when parking: {1e3 * moved:.2f} mm")


CLOSED = [
    (Mode.IDLE, 0.5),
    (Mode.LOADING, 0.1),
    (Mode.LOADING, 0.6),
    (Mode.UNLOADING, 0.3),
    (Mode.UNLOADING, 0.9),
]


@pytest.mark.parametrize(
    ("mode", "share", "legs"),
    [
        *((mode, share, (3,)) for mode, share in CLOSED),
        *broad([(*each, tuple(LEGS)) for each in CLOSED], quick=1),
    ],
    ids=[f"{m.name} {s} {which}" for which in ("one", "all") for m, s in CLOSED],
)
def test_a_brake_that_opens_by_itself_under_load_is_caught(good, mode, share, legs, capsys):
    since = begins(good, mode, share)
    ran = run(load("virtual"), *[BrakeStuckOpen(leg=leg, at_s=since) for leg in legs])
    moved = assert_held(ran, legs, Mode.UNLOADING if mode is Mode.UNLOADING else Mode.IDLE)
    with capsys.disabled():
        print(f"\nbrake opens in {mode.name}: {1e3 * moved:.2f} mm")


@pytest.mark.long
@pytest.mark.parametrize("name", ["lab", "bench"])
def test_other_robots_hold_their_legs_too(name, capsys):
    c = load(name)
    good = run(c)
    assert good.ending.success, good.ending
    since = begins(good, Mode.TRACKING, 0.9)
    ran = run(c, BrakeStuckOpen(leg=2, at_s=since))
    moved = assert_held(ran, (2,), Mode.UNLOADING)
    with capsys.disabled():
        print(f"\n{name}: brake of leg 2 open when parking: {1e3 * moved:.2f} mm")


@pytest.mark.parametrize("law", ["{law: pd, kp_N_m: 2.0e+6, kv_N_s_m: 5.0e+4}"])
def test_a_law_without_gravity_holds_as_well(law):
    text = load("virtual").text
    a, b = text.index("\ncontroller:") + 1, text.index("\nmonitor:") + 1
    c = loads(text[:a] + f"controller: {law}\n\n" + text[b:], "pd.yaml", load("virtual").folder)
    good = run(c)
    assert good.ending.success, good.ending
    ran = run(c, BrakeStuckOpen(leg=4, at_s=begins(good, Mode.TRACKING, 0.5)))
    assert_held(ran, (4,), Mode.UNLOADING)


def test_a_brake_that_slips_below_its_load_is_found():
    """3.2 kN of brake under 3.6 kN."""
    ran = run(
        configuration("virtual", ("internal_step_us: 100", "internal_step_us: 100\n    brake_force_N: 3200"))
    )
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.moved(0) < BOUND_m


def test_without_a_ramp_there_is_no_test_and_a_leg_that_falls_is_caught():
    """Theory's layout parks without a brake test; the legs are watched for a moment before the run ends."""
    ran = run(load("ideal"), BrakeStuckOpen(leg=1, at_s=0.5), duration_s=1.2)
    assert_held(ran, (1,), Mode.PARKED)


def test_a_slow_brake_is_found_although_it_closes_in_the_end():
    """250 ms, and the controller waits for 100: the brake is open in the first half of the test."""
    c = load("virtual")
    assert c.plant is not None
    drives = c.plant.drives.model_copy(update={"brake_close_ms": 250.0})
    ran = run(c.model_copy(update={"plant": c.plant.model_copy(update={"drives": drives})}))
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.moved(ran.first(Mode.UNLOADING)) < BOUND_m


@pytest.mark.parametrize("fault", [DriveSilence, EncoderLost])
def test_a_leg_that_is_not_measured_during_the_test_is_no_proof(good, fault):
    """The holding force of all legs comes back, and stays as it is: nothing can be controlled."""
    ran = run(load("virtual"), fault(leg=5, at_s=begins(good, Mode.UNLOADING, 0.4)))
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.ending.faults == Fault.STALE
    assert "leg 5" in ran.ending.reason
    held = ran.rows[ran.rows["mode"] == Mode.HELD]
    before = ran.rows[ran.rows["mode"] == Mode.PARKING][-1]["tau"]
    np.testing.assert_allclose(held["tau"][-1], before, atol=5.0)
    assert ran.moved(ran.first(Mode.PARKING)) < 50e-6


def test_a_run_that_is_held_replays_to_the_bit(good):
    ran = run(load("virtual"), BrakeStuckOpen(leg=0, at_s=begins(good, Mode.TRACKING, 0.5)))
    cycle = ran.cycle
    cycle.reset()
    for inp, row in zip(ran.inputs, ran.rows, strict=True):
        cycle.begin(inp.tick)
        assert cycle.step(inp).row.tobytes() == row.tobytes()


# -- the daemon's course -----------------------------------------------------------------------------------


FRICTION = ("viscous_friction_N_s_m: 0", "viscous_friction_N_s_m: 300")


def stuck(good: Ran) -> BrakeStuckOpen:
    return BrakeStuckOpen(leg=2, at_s=begins(good, Mode.TRACKING, 0.5))


def held(fault: PlantFault, *changes: tuple[str, str]) -> tuple[Lockstep, Any, Course]:
    """Return a run that is held, and goes on."""
    c = configuration("virtual", *changes)
    cycle = build_cycle(c, 1000.0, 0.01)
    nodes, plant = build_nodes(c, FaultPlan([fault]))
    lockstep = Lockstep(cycle, nodes, (BitTiming.of(c.bus),), c.loop.window_s(1000.0))
    course = Course(cycle, DURATION_S, stays=True)
    while cycle.mode is not Mode.HELD:
        lockstep.step(course.commands(lockstep.tick + 1))
        assert course.ending(lockstep.tick) is None
    return lockstep, plant, course


def test_the_daemon_holds_until_it_is_told_to_release_and_then_stays_until_all_is_at_rest(good):
    lockstep, plant, course = held(stuck(good), FRICTION)
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
    rest = np.abs(nodes.snapshot().rate).max()
    plant.close()
    assert fell, "it was let go"
    assert any("still moves" in text for text in said)
    assert ending is not None
    assert (ending.mode, ending.released, ending.success) == (Mode.FAULT, True, False)
    assert rest < 0.02


def test_a_platform_that_never_comes_to_rest_is_left_when_the_operator_asks_twice(good):
    """Without any friction the leg that was let go of swings for ever."""
    lockstep, plant, course = held(stuck(good))
    lockstep.step(course.commands(lockstep.tick + 1, (Operator.RELEASE,)))
    for _ in range(3000):
        lockstep.step(course.commands(lockstep.tick + 1))
        assert course.ending(lockstep.tick) is None
    assert "still moves" in course.stays_for
    lockstep.step(course.commands(lockstep.tick + 1, (Operator.ESTOP,)))
    ending = course.ending(lockstep.tick)
    plant.close()
    assert ending is not None
    assert "still moving: leg" in ending.reason


def test_an_emergency_stop_acts_on_a_held_platform_too(good):
    """Not a second Ctrl-C, which the panel turns into a stop: the frame itself, from whoever has one."""
    lockstep, plant, _ = held(stuck(good))
    lockstep.step((Operator.ESTOP,))
    assert lockstep.cycle.mode is Mode.FAULT
    assert lockstep.cycle.faults & Fault.ESTOP
    plant.close()


def test_reset_does_not_drop_a_held_platform(good):
    lockstep, plant, _ = held(stuck(good))
    for operator in (Operator.RESET, Operator.ENGAGE, Operator.STOP):
        lockstep.step((operator,))
        lockstep.step()
        assert lockstep.cycle.mode is Mode.HELD
        assert lockstep.cycle.faults == Fault.BRAKE
    plant.close()
