"""Encoder failures: which rule finds them, when, by the plant's true lengths, and cases that must not alarm."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

from drivers.signals import Doubt, Fault, Mode
from hil.app.check import sensing
from hil.app.check.report import Report
from hil.app.check.subject import looked_at
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from plant_fmu.faults.fault import Fault as PlantFault
from plant_fmu.faults.kinds import BrakeStuckClosed, EncoderFreeze, EncoderJump, FramesLoss, WrenchStep
from tests.broad import broad
from tests.loop.bench import Ran, changed, run

BOUND_m, BOUND_TICKS = 2e-3, 20
"""A failure must be found within one of the two."""
MOVED_m = 1e-4
"""True motion from which the time of a frozen encoder counts."""
POWERED = (
    Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.UNLOADING,
)  # fmt: skip
NAMES, LEGS = ("virtual", "lab"), range(6)
STOP_S = {"virtual": 2.5, "lab": 4.5}
"""Time of the stop: in mid-motion."""
PUSH_N = {"virtual": 3000.0, "lab": 600.0}
"""Push on a platform at hold; on `lab`, ten times the friction of a leg."""


def at_hold(name: str) -> Configuration:
    """A shipped configuration whose reference stays at home."""
    return changed(name, reference={"type": "hold", "duration_s": 60})


@cache
def good(name: str) -> Ran:
    ran = run(load(name), stop_s=STOP_S[name])
    assert ran.ending.success, ran.ending
    return ran


def found(ran: Ran, leg: int) -> int:
    """Tick of the fault; asserts that it reports this leg only."""
    row = ran.rows[ran.struck]
    assert row["faults"] & Fault.ENCODER, ran.ending
    assert row["legs_doubted"] == 1 << leg
    assert ran.ending.mode in {Mode.FAULT, Mode.HELD}
    assert f"leg {leg} " in ran.ending.reason
    return ran.struck


def assert_in_time(ran: Ran, leg: int, since: int) -> None:
    """Assert that the fault came within the bounds after the leg's first true motion since a tick."""
    tick = found(ran, leg)
    moved = np.abs(ran.true[:, leg] - ran.true[since, leg])
    begins = since + int(np.argmax(moved[since:] > MOVED_m))
    late = tick - begins
    assert late <= BOUND_TICKS or moved[: tick + 1][since:].max() <= BOUND_m, f"{late} ticks, {moved[tick]} m"


def pairwise(*factors: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Reduced set of cases, always the same, in which every two values of any two factors meet.

    Each next case covers the most pairs that are not yet covered.
    """

    def pairs(case: tuple[int, ...]) -> set[Any]:
        return set(combinations(enumerate(case), 2))

    every = list(product(*(range(len(factor)) for factor in factors)))
    left: set[Any] = set().union(*map(pairs, every))
    cases: list[tuple[Any, ...]] = []
    while left:
        best = max(every, key=lambda case: len(pairs(case) & left))
        left -= pairs(best)
        cases.append(tuple(factor[k] for factor, k in zip(factors, best, strict=True)))
    return cases


JUMPS = [(0, 0.5e-3), (3, -9.5e-3)]
"""Used alternately from mode to mode."""
EVERY_JUMP = [
    *((NAMES[n % 2], mode, *JUMPS[n // 2 % 2]) for n, mode in enumerate(POWERED)),
    *pairwise(NAMES, POWERED, LEGS, (0.5e-3, -0.5e-3, 1e-3, -5e-3, 9.5e-3, -9.5e-3)),
]


@pytest.mark.parametrize(("name", "mode", "leg", "by"), broad(EVERY_JUMP, quick=len(POWERED)))
def test_encoder_jump_is_detected_in_the_same_period_in_every_mode_with_power(name, mode, leg, by):
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
def test_frozen_encoder_is_detected_in_motion_or_when_motion_begins(name, mode, leg):
    at = good(name).within(mode, 0.37)
    frozen = run(load(name), EncoderFreeze(leg=leg, at_s=at), stop_s=STOP_S[name])
    assert_in_time(frozen, leg, round(1e3 * at))


PUSHES = [(0, 0, -1), (1, 0, 0), (0, 1, 0)]


@pytest.mark.parametrize(
    ("name", "along", "leg"),
    broad([("virtual", PUSHES[0], 1), ("lab", PUSHES[2], 1), *pairwise(NAMES, PUSHES, LEGS)], quick=2),
)
def test_frozen_encoder_of_a_platform_at_rest_is_detected_when_a_load_moves_the_platform(name, along, leg):
    """On `lab` friction may hold a leg still as well: a push decides."""
    fx, fy, fz = (PUSH_N[name] * x for x in along)
    push = WrenchStep(force_N=(fx, fy, fz), moment_N_m=(0.0, 0.0, 0.0), at_s=2.8)
    frozen = run(at_hold(name), EncoderFreeze(leg=leg, at_s=2.6), push, stop_s=4.0)
    assert_in_time(frozen, leg, 2800)
    assert frozen.rows["doubt"][-1] == Doubt.STILL
    assert "frozen, or its brake" in frozen.ending.reason


@pytest.mark.parametrize(("name", "leg"), broad([(NAMES[leg % 2 - 1], leg) for leg in LEGS], quick=2))
def test_brake_that_stays_closed_is_detected_before_any_leg_moves_10_mm(name, leg):
    shut = run(load(name), BrakeStuckClosed(leg=leg), stop_s=STOP_S[name])
    found(shut, leg)
    assert np.abs(shut.true - shut.true[0]).max() < 10e-3


@pytest.mark.parametrize("leg", broad([0, 2, 5], quick=1))
def test_frozen_encoder_of_a_leg_without_load_is_detected_when_the_leg_drifts(leg):
    """No control acts on that leg: it drifts slowly, and moves the others by a few per cent of that."""
    frozen = run(at_hold("virtual"), EncoderFreeze(leg=leg, at_s=2.0), stop_s=6.0)
    assert_in_time(frozen, leg, 2000)


@pytest.mark.parametrize("name", NAMES)
def test_encoder_that_freezes_on_closed_brakes_moves_no_leg_and_the_run_succeeds(name):
    at_s = good(name).within(Mode.UNLOADING, 0.37)
    frozen = run(load(name), EncoderFreeze(leg=4, at_s=at_s), stop_s=STOP_S[name])
    assert frozen.ending.success
    assert np.abs(frozen.true[-1] - good(name).true[-1]).max() < MOVED_m


def loads_up_to(c: Configuration, seed: int, end_s: float) -> list[PlantFault]:
    """Short wrench steps whose largest acceleration of a leg at home equals the stated disturbance."""
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
def test_configured_disturbances_and_lost_frames_raise_no_encoder_alarm(name, still, lost, seed, stop_s):
    c = at_hold(name) if still else load(name)
    faults = loads_up_to(c, seed, stop_s)
    if lost:
        faults.append(FramesLoss(probability=lost, at_s=1.0))
    ran = run(c, *faults, stop_s=stop_s, seed=seed)
    assert not ran.rows["legs_doubted"].any(), ran.ending
    assert lost or ran.ending.success, ran.ending


@pytest.mark.parametrize("name", broad(["ideal", "vcan50", "bench"], quick=2))
def test_other_shipped_configurations_raise_no_encoder_alarm(name):
    ran = run(load(name), stop_s=5.0)
    assert ran.ending.success, ran.ending
    assert not ran.rows["legs_doubted"].any()


# -- the smallest jump, where rates are made of lengths ------------------------------------------------------


T = 2.5e-3
COUNT_m = 0.02 / 131072
SKEW_s = 50e-6
"""Default of monitor.rate_skew_us."""
LATE = 0.3
"""Undetected delay of a latch, in periods: 6 v d / T is the largest leap that it causes at a rate v."""
BACK = 9
"""Ticks of force that may still act: transport, three time constants of the drives, and two of a slope."""
LATER = 40
"""Ticks after a jump of three tenths within which no alarm may come."""


def bench_of(name: str, *, still: bool) -> Configuration:
    return at_hold(name) if still else load(name)


@cache
def calm(name: str, still: bool, tick: int) -> Ran:
    return run(bench_of(name, still=still), stop_s=(tick + 2) * T)


def smallest_jump_m(c: Configuration, ran: Ran, tick: int, leg: int) -> float:
    """Smallest jump, m, whose leap exceeds what force, disturbance and noise explain.

    A slope through three lengths leaps by 1.5 J / T. The acceleration may vary by a, which changes the leap
    by a T, and by 4/3 a T as slopes lag. A leap that a late SYNC explains, and that no other leg contradicts,
    counts as time.
    """
    home = pose_arrays(c.platform.home)
    platform = build_platform(c.platform)
    J = jacobian(platform, *home)
    M = Model(platform, leg_spin=c.platform.leg_spin).mass_matrix(*home)
    forces, rates = ran.rows["tau"][tick - BACK : tick], ran.rows["dq"][tick - 3 : tick]
    a = 2.0 * c.monitor.disturbance_m_s2 + 2.0 * np.abs(J @ np.linalg.inv(M) @ J.T) @ np.ptp(forces, axis=0)
    noise = 2.0 * COUNT_m / T + SKEW_s * (a + np.abs(np.diff(rates, axis=0)).max(axis=0) / T)
    leap = a * T * (1.0 + 4.0 / 3.0) + 4.0 * noise
    speed = np.abs(rates[-1])
    most = [leap[other] / speed[other] for other in range(6) if other != leg and speed[other] > 0.0]
    return float((leap[leg] + speed[leg] * min([6.0 * LATE, *most])) * T / 1.5)


CASES = [
    ("virtual-cia402", False, 800, 1, 0.40e-3, 0.60e-3, -1.0),
    ("virtual-cia402", False, 700, 3, 0.15e-3, 0.25e-3, 1.0),
    ("virtual-cia402", True, 800, 0, 0.15e-3, 0.20e-3, -1.0),
    ("lab-cia402", False, 1300, 2, 0.15e-3, 0.60e-3, 1.0),
    ("lab-cia402", False, 1500, 5, 0.60e-3, 0.90e-3, -1.0),
    ("lab-cia402", True, 1300, 4, 0.15e-3, 0.60e-3, 1.0),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "still", "tick", "leg", "least_m", "most_m", "sign"), CASES)
def test_encoder_jump_of_twice_the_printed_smallest_is_detected_and_of_0_3_times_is_not(
    name, still, tick, leg, least_m, most_m, sign
):
    """Half the jump may be found one tick later: the slope then returns, and leaps by 3.5 J / T instead of
    1.5 J / T.
    """
    c = bench_of(name, still=still)
    jump_m = smallest_jump_m(c, calm(name, still, tick), tick, leg)
    assert least_m < jump_m < most_m

    def jumped(times: float, ticks: int) -> Ran:
        jump = EncoderJump(leg=leg, by_m=times * sign * jump_m, at_s=tick * T)
        return run(c, jump, stop_s=(tick + ticks) * T)

    found = jumped(2.0, 4)
    row = found.rows[found.struck]
    assert row["faults"] & Fault.ENCODER, found.ending
    assert row["tick"] - tick <= 1
    assert (row["legs_doubted"], row["doubt"]) == (1 << leg, Doubt.LEAP)
    half = jumped(0.5, 4).rows
    assert not half["faults"][half["tick"] <= tick].any()
    part = jumped(0.3, LATER)
    assert not part.rows["faults"].any()
    assert not part.rows["legs_doubted"].any()


@pytest.mark.parametrize("leg", broad(range(6), quick=1))
def test_encoder_jump_of_a_leg_at_rest_is_not_mistaken_for_a_late_sampling_instant(leg):
    """Its rate, computed from the jump itself, would explain any jump as the motion during a late latch."""
    c = bench_of("virtual-cia402", still=True)
    found = run(c, EncoderJump(leg=leg, by_m=1e-3, at_s=660 * T), stop_s=664 * T)
    row = found.rows[found.struck]
    assert (row["tick"] - 660, row["doubt"]) == (0, Doubt.LEAP), found.ending


def test_printed_smallest_detectable_encoder_jump_at_rest_equals_a_hand_calculation():
    """a = 16 m/s^2: (16 x 2.5e-3 x 7/3 + 4 x (1.22e-4 + 50e-6 x 16)) x 2.5e-3 / 1.5 = 0.162 mm."""
    report = Report(looked_at(load("virtual-cia402")))
    sensing.encoders(report)
    leap = 16.0 * T * 7.0 / 3.0 + 4.0 * (2.0 * COUNT_m / T + SKEW_s * 16.0)
    assert report.figures["encoders"]["jump_m"] == pytest.approx(leap * T / 1.5, rel=1e-6)
    assert any("0.162 mm" in line for line in report.sections["encoders at rest"])
