"""Learned forces: when they act, and their bumpless fading."""

from typing import Any

import numpy as np
import pytest

from drivers.compiled.pointed import data_at
from drivers.signals import Mode
from hil.loop.effort import Learned, step
from hil.loop.motion import Motion
from hil.loop.reference import LearnedForces
from hil.trajectory.move import GeodesicMove
from hil.trajectory.piecewise import PiecewisePolynomial

T, FADE_S, STOP_S = 1e-3, 0.05, 0.2
HERE, EYE = np.zeros(3), np.eye(3)
WAY, START = 500, 100
"""Ticks of the approach, and the tick of its start."""
BEGINS = START + WAY
PEAK = 800.0


def reference() -> PiecewisePolynomial:
    return PiecewisePolynomial(np.array([0.0, 1.0]), np.zeros((1, 6, 6)))


def table(tick: float) -> Any:
    """Forces at a tick of the run: another line for each leg."""
    return PEAK + 0.01 * np.arange(6) * (tick - BEGINS + 400)


def learned_at(
    learned: Learned, tick: int, mode: Mode, mode_tick: int, motion: Motion, *, faulty: bool
) -> Any:
    """Forces (6,) N of a tick; zero without learned forces."""
    tau, moves = np.empty(6), (motion.record, motion.override.record)
    along = int(learned.along(mode, motion))
    acts = step(learned._record, *moves, tick, int(mode), mode_tick, along, int(faulty), data_at(tau))
    return tau if acts else np.zeros(6)


class Run:
    """A motion and the forces learned on it, tick by tick."""

    def __init__(self, path: PiecewisePolynomial | None = None) -> None:
        self.path = reference()
        rows = np.array([table(BEGINS + k) for k in range(-400, 1001)])
        forces = LearnedForces(rows, -0.4, T, FADE_S)
        self.learned = Learned(forces, self.path, T)
        self.motion = Motion(T, HERE, EYE, STOP_S)
        self.mode, self.mode_tick, self.tick = Mode.RELEASING, 0, START - 1
        self.follow = path or self.path
        self.faulty = False
        self.seen: list[Any] = []

    def enter(self, mode: Mode) -> None:
        self.mode, self.mode_tick = mode, self.tick + 1
        tick = self.tick + 1
        if mode is Mode.APPROACH:
            self.motion.start(GeodesicMove(HERE, EYE, HERE, EYE, WAY * T), tick, then=self.follow)
        if mode is Mode.TRACKING:
            self.motion.start(self.follow, tick)

    def go(self, ticks: int, *, speed: float | None = None) -> Any:
        """Run some ticks towards a speed; return their forces (ticks, 6)."""
        found = []
        for _ in range(ticks):
            self.tick += 1
            self.motion.advance(self.tick)
            if speed is not None:
                self.motion.aim(self.tick, speed, go=speed > 0.0)
            tau = learned_at(
                self.learned, self.tick, self.mode, self.mode_tick, self.motion, faulty=self.faulty
            )
            found.append(np.array(tau))
        self.seen += found
        return np.array(found)

    def tracking(self, ticks: int) -> "Run":
        """Follow the reference for some ticks."""
        self.enter(Mode.APPROACH)
        self.go(WAY)
        self.enter(Mode.TRACKING)
        self.go(ticks)
        return self

    def largest_step(self) -> float:
        return float(np.abs(np.diff(np.array(self.seen), axis=0)).max())


BUMPLESS = 1.05 * 1.875 * PEAK * T / FADE_S
"""Steepest step of a fade, N a tick."""


def test_learned_forces_start_in_the_approach_and_follow_path_time() -> None:
    run = Run().tracking(900)
    forces = np.array(run.seen)
    assert not forces[: WAY - 400].any(), "no learned force may act before the recorded approach"
    whole = slice(WAY - 400 + 60, None)
    expected = np.array([table(START + k) for k in range(len(forces))])
    np.testing.assert_allclose(forces[whole], expected[whole], rtol=1e-9)
    assert run.largest_step() < BUMPLESS


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_hold_or_other_speed_fades_learned_forces_out_until_the_next_start(speed: float) -> None:
    run = Run().tracking(300)
    assert run.go(60, speed=speed)[-1] == pytest.approx(np.zeros(6))
    assert not run.go(300, speed=1.0).any(), "learned forces must not start in the middle of the path"
    assert run.motion.override.full
    assert not run.motion.away
    assert run.largest_step() < BUMPLESS
    run.tracking(1)
    assert run.go(1).all()


@pytest.mark.parametrize("where", ["in the approach", "at the start"])
def test_hold_before_the_reference_fades_learned_forces_out_and_in_again(where: str) -> None:
    run = Run()
    run.enter(Mode.APPROACH)
    assert run.go(WAY if where == "at the start" else WAY - 300)[-1].all()
    if where == "at the start":
        run.enter(Mode.TRACKING)
        run.motion.settle(run.tick + 1, 0.0)
    assert not run.go(300, speed=0.0)[-1].any()
    assert run.go(400, speed=1.0)[-1].all()
    assert run.largest_step() < BUMPLESS


def test_learned_forces_fade_in_only_after_the_earlier_ones_have_faded_out() -> None:
    """The speed rises faster than the forces fade; meanwhile the table changes by 4 N a tick."""
    run = Run()
    rows = np.repeat(4.0 * np.arange(1400.0)[:, None], 6, axis=1)
    run.learned = Learned(LearnedForces(rows, -0.4, T, 1.0), run.path, T)
    run.enter(Mode.APPROACH)
    run.go(WAY)
    run.enter(Mode.TRACKING)
    run.motion.settle(run.tick + 1, 0.0)
    run.go(20, speed=0.0)
    run.go(700, speed=1.0)
    assert run.motion.override.full
    assert run.largest_step() < 1.05 * (4.0 + 1.875 * rows.max() * T / 1.0)


def test_no_learned_force_acts_on_another_path() -> None:
    run = Run(path=reference()).tracking(300)
    assert not np.array(run.seen).any()


def test_first_fault_disables_learned_forces_until_a_reset() -> None:
    run = Run().tracking(300)
    run.faulty = True
    run.mode, run.mode_tick = Mode.STOPPING, run.tick + 1
    assert not run.go(60)[-1].any()
    assert run.largest_step() < BUMPLESS
    run.faulty = False
    assert not run.tracking(100).go(1).any()
    run.learned.reset()
    assert run.tracking(100).go(1).all()


def test_last_learned_force_is_kept_while_parking_until_the_brakes_are_closed() -> None:
    run = Run().tracking(1001)
    last = run.seen[-1]
    run.mode, run.mode_tick = Mode.PARKING, run.tick + 1
    np.testing.assert_allclose(run.go(100)[-1], last)
    run.faulty = True
    assert not run.go(60)[-1].any()
