"""An encoder that fails: who notices, when, by the plant's own lengths, and what must not alarm."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from drivers.signals import Doubt, Fault, Mode
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from plant_fmu.faults.fault import Fault as PlantFault
from plant_fmu.faults.kinds import BrakeStuckClosed, EncoderFreeze, EncoderJump, FramesLoss, WrenchStep
from tests.broad import broad
from tests.loop.bench import Ran, changed, run
from tests.loop.pairs import pairwise

BOUND_m, BOUND_TICKS = 2e-3, 20
"""A failure is found within one of the two."""
MOVED_m = 1e-4
"""True motion from which a frozen encoder is counted."""
POWERED = (
    Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.UNLOADING,
)  # fmt: skip
NAMES, LEGS = ("virtual", "lab"), range(6)
STOP_S = {"virtual": 2.5, "lab": 4.5}
"""When the runs are stopped: in mid-motion."""
PUSH_N = {"virtual": 3000.0, "lab": 600.0}
"""On a platform at hold; on `lab`, ten times the friction of a leg."""


def at_hold(name: str) -> Configuration:
    """Return a shipped configuration whose reference stays at home."""
    return changed(name, reference={"type": "hold", "duration_s": 60})


@cache
def good(name: str) -> Ran:
    ran = run(load(name), stop_s=STOP_S[name])
    assert ran.ending.success, ran.ending
    return ran


def found(ran: Ran, leg: int) -> int:
    """Return the tick of the fault, which names the leg and nothing else."""
    row = ran.rows[ran.struck]
    assert row["faults"] & Fault.ENCODER, ran.ending
    assert row["legs_doubted"] == 1 << leg
    assert ran.ending.mode in {Mode.FAULT, Mode.HELD}
    assert f"leg {leg} " in ran.ending.reason
    return ran.struck


def assert_in_time(ran: Ran, leg: int, since: int) -> None:
    """Assert that the fault came within the bounds of the leg's first true motion after a tick."""
    tick = found(ran, leg)
    moved = np.abs(ran.true[:, leg] - ran.true[since, leg])
    begins = since + int(np.argmax(moved[since:] > MOVED_m))
    late = tick - begins
    assert late <= BOUND_TICKS or moved[: tick + 1][since:].max() <= BOUND_m, f"{late} ticks, {moved[tick]} m"


JUMPS = [(0, 0.5e-3), (3, -9.5e-3)]
"""In turn from mode to mode."""
EVERY_JUMP = [
    *((NAMES[n % 2], mode, *JUMPS[n // 2 % 2]) for n, mode in enumerate(POWERED)),
    *pairwise(NAMES, POWERED, LEGS, (0.5e-3, -0.5e-3, 1e-3, -5e-3, 9.5e-3, -9.5e-3)),
]


@pytest.mark.parametrize(("name", "mode", "leg", "by"), broad(EVERY_JUMP, quick=len(POWERED)))
def test_a_jump_is_found_in_its_tick_in_every_mode(name, mode, leg, by):
    """Six lengths always fit some pose."""
    at = good(name).within(mode, 0.37)
    jumped = run(load(name), EncoderJump(leg=leg, by_m=by, at_s=at), stop_s=STOP_S[name])
    assert found(jumped, leg) - round(1e3 * at) <= 1
    assert jumped.rows["doubt"][-1] == Doubt.JUMP
    assert jumped.rows["doubt_value"][-1] == pytest.approx(by, abs=2e-6)
    assert not np.bitwise_or.reduce(jumped.rows["faults"]) & Fault.BRAKE, "a length that jumped is no motion"


MOVES = (Mode.RELEASING, Mode.TRACKING, Mode.STOPPING)
FREEZES = [*((NAMES[n % 2], mode, 2) for n, mode in enumerate(MOVES)), *pairwise(NAMES, MOVES, LEGS)]


@pytest.mark.parametrize(("name", "mode", "leg"), broad(FREEZES, quick=3))
def test_a_frozen_encoder_is_found_in_motion_and_when_motion_begins(name, mode, leg):
    at = good(name).within(mode, 0.37)
    frozen = run(load(name), EncoderFreeze(leg=leg, at_s=at), stop_s=STOP_S[name])
    assert_in_time(frozen, leg, round(1e3 * at))


PUSHES = [(0, 0, -1), (1, 0, 0), (0, 1, 0)]


@pytest.mark.parametrize(
    ("name", "along", "leg"),
    broad([("virtual", PUSHES[0], 1), ("lab", PUSHES[2], 1), *pairwise(NAMES, PUSHES, LEGS)], quick=2),
)
def test_a_frozen_encoder_at_hold_is_found_when_a_load_moves_the_platform(name, along, leg):
    """On `lab` friction may hold a leg still as well: a push decides."""
    fx, fy, fz = (PUSH_N[name] * x for x in along)
    push = WrenchStep(force_N=(fx, fy, fz), moment_N_m=(0.0, 0.0, 0.0), at_s=2.8)
    frozen = run(at_hold(name), EncoderFreeze(leg=leg, at_s=2.6), push, stop_s=4.0)
    assert_in_time(frozen, leg, 2800)
    assert frozen.rows["doubt"][-1] == Doubt.STILL
    assert "frozen, or its brake" in frozen.ending.reason


@pytest.mark.parametrize(("name", "leg"), broad([(NAMES[leg % 2 - 1], leg) for leg in LEGS], quick=2))
def test_a_brake_that_does_not_open_is_found_before_a_leg_has_moved_by_10_mm(name, leg):
    shut = run(load(name), BrakeStuckClosed(leg=leg), stop_s=STOP_S[name])
    found(shut, leg)
    assert np.abs(shut.true - shut.true[0]).max() < 10e-3


@pytest.mark.parametrize("leg", broad([0, 2, 5], quick=1))
def test_a_frozen_encoder_without_a_load_is_found_when_the_leg_drifts_away(leg):
    """Nothing controls that leg: it leaves its place slowly, and moves the others by a few per cent of that."""
    frozen = run(at_hold("virtual"), EncoderFreeze(leg=leg, at_s=2.0), stop_s=6.0)
    assert_in_time(frozen, leg, 2000)


@pytest.mark.parametrize("name", NAMES)
def test_an_encoder_that_freezes_on_closed_brakes_is_not_observable_and_leaves_no_error(name):
    at_s = good(name).within(Mode.UNLOADING, 0.37)
    frozen = run(load(name), EncoderFreeze(leg=4, at_s=at_s), stop_s=STOP_S[name])
    assert frozen.ending.success
    assert np.abs(frozen.true[-1] - good(name).true[-1]).max() < MOVED_m


def loads_up_to(c: Configuration, seed: int, end_s: float) -> list[PlantFault]:
    """Return short wrench steps, the largest acceleration of a leg at home being the stated disturbance."""
    generator = np.random.default_rng(seed)
    platform = build_platform(c.platform)
    home = pose_arrays(c.platform.home)
    J = jacobian(platform, *home)
    legs = J @ np.linalg.inv(Model(platform, leg_spin=c.platform.leg_spin).mass_matrix(*home))
    steps: list[PlantFault] = []
    t = 1.0
    while t < end_s:
        w = J.T @ generator.standard_normal(6)
        if generator.random() < 0.5:  # along one axis
            w = np.eye(6)[generator.integers(6)] * generator.choice([-1.0, 1.0])
        w *= c.monitor.disturbance_m_s2 / np.abs(legs @ w).max()
        for_s = generator.uniform(4e-3, 20e-3)
        steps.append(WrenchStep(force_N=w[:3].tolist(), moment_N_m=w[3:].tolist(), at_s=t, for_s=for_s))
        t += for_s + generator.uniform(0.05, 0.3)
    return steps


CALM = [(name, still, lost) for lost in (0.03, 0.0) for still in (True, False) for name in ("lab", "virtual")]


@pytest.mark.parametrize(
    ("name", "still", "lost", "seed", "stop_s"),
    broad([(*CALM[0], 0, 5.0), *((*case, seed, 60.0) for seed, case in enumerate(CALM, 1))], quick=1),
)
def test_loads_up_to_the_stated_disturbance_and_lost_frames_alarm_nobody(name, still, lost, seed, stop_s):
    c = at_hold(name) if still else load(name)
    faults = loads_up_to(c, seed, stop_s)
    if lost:
        faults.append(FramesLoss(probability=lost, at_s=1.0))
    ran = run(c, *faults, stop_s=stop_s, seed=seed)
    assert not ran.rows["legs_doubted"].any(), ran.ending
    assert lost or ran.ending.success, ran.ending


@pytest.mark.parametrize("name", broad(["ideal", "vcan50", "bench"], quick=2))
def test_the_other_shipped_configurations_alarm_nobody(name):
    ran = run(load(name), stop_s=5.0)
    assert ran.ending.success, ran.ending
    assert not ran.rows["legs_doubted"].any()
