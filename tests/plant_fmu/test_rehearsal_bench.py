"""The rehearsal bench: legs with the given figures, and readings of the operator within their errors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.config import DriveSettings
from drivers.legs.protocol import LegsProtocol
from plant_fmu.config import DriveEmulation
from plant_fmu.rehearsal.bench import RehearsalBench, Stand
from plant_fmu.rehearsal.wiring import Wiring

RATED_N = 1000.0
SHORT, LONG = 0.5, 0.8
OPEN, SHUT, CALM = np.zeros(6), np.ones(6), np.zeros(6)
BASE = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.radians([0, 60, 120, 180, 240, 300])])
STAND = Stand(
    mass_kg=4.0,
    friction_N=6.0,
    brake_N=200.0,
    length_min=SHORT,
    length_max=LONG,
    base_joints=BASE,
    platform_joints=0.5 * BASE,
    platform_kg=50.0,
    presses=1.0,
)
DRAWS = 2000
WITHIN = 5.0 / DRAWS**0.5
"""Tolerance of the mean and of the spread of DRAWS numbers, in standard deviations."""


def bench(wiring: Wiring | None = None, stand: Stand = STAND, seed: int = 1) -> RehearsalBench:
    protocol = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))
    settings = DriveSettings(force_limit_N=RATED_N)
    return RehearsalBench(protocol, DriveEmulation(), settings, stand, wiring or Wiring(), seed)


def lengths(b: RehearsalBench) -> list[float]:
    return [b.length(leg) for leg in range(6)]


def gives_way(b: RehearsalBench, force: np.ndarray, brake: np.ndarray) -> list[bool]:
    """True for legs that move under a force that is applied for 10 ms."""
    before = np.array(lengths(b))
    b.cables.step(force, brake, CALM, 0.01)
    return [bool(moved) for moved in np.abs(np.array(lengths(b)) - before) > 1e-9]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_brake_force_of_a_rehearsed_leg_adds_to_its_friction(side):
    """Friction of 6 N, increased by 1 % of 1000 N from leg to leg; brakes of 200 N."""
    extra = tuple(0.01 * leg for leg in range(6))
    holds = 6.0 + 10.0 * np.arange(6)
    for brake, most in ((OPEN, holds), (SHUT, holds + 200.0), (0.5 * SHUT, holds + 100.0)):
        b = bench(Wiring(friction=extra))
        assert gives_way(b, side * (most - 0.5), brake) == [False] * 6
        assert gives_way(b, side * (most + 0.5), brake) == [True] * 6


@pytest.mark.parametrize("leg", range(6))
def test_leg_placed_by_hand_goes_at_most_2_percent_beyond_its_stroke(leg):
    shorter = tuple(0.1 if k == leg else 0.0 for k in range(6))
    for wiring, longest in ((Wiring(), 0.806), (Wiring(shorter=shorter), 0.776)):
        b = bench(wiring)
        for share, length in ((0.0, 0.5), (0.5, 0.65), (-1.0, 0.494), (2.0, longest)):
            before = lengths(b)
            b.do("place", leg, share)
            before[leg] = length
            np.testing.assert_allclose(lengths(b), before, rtol=0, atol=1e-12)
        b.do("place", leg, 0.5)
        b.do("move", leg, -0.01)
        assert b.length(leg) == pytest.approx(0.64)


def drawn(take: Callable[[], float]) -> np.ndarray:
    return np.array([take() for _ in range(DRAWS)])


READINGS: dict[str, tuple[Callable[[RehearsalBench], float], float, float]] = {
    "tape": (lambda b: b.do("measure", 3), 0.65, 2e-4),
    "scales": (lambda b: b.do("weigh"), 100.0, 0.3),
    "a free leg": (lambda b: b.do("read_push", 3), 6.0, 0.018),
    "a leg beyond the hand's most": (lambda b: b.do("read_push", 4), 50.0, 0.15),
    "a leg that holds": (lambda b: b.do("read_held", 5), 50.0, 0.15),
    "gauge": (lambda b: b.do("read_gauge"), 20.0, 0.06),
}
"""Name -> reading, its true value, and its standard deviation: 0.2 mm, or 0.3 % of the value."""


def prepared(seed: int = 1) -> RehearsalBench:
    b = bench(Wiring(payload=2.0, friction=(0.0, 0.0, 0.0, 0.0, 0.1, 0.0)), seed=seed)
    b.do("place", 3, 0.5)
    b.do("push", 5)
    b.do("clamp", 0)
    b._legs.legs["x"][0] += 5e-5  # deflection of the gauge under 2 % of the rated force
    return b


@pytest.mark.parametrize("name", READINGS)
def test_simulated_manual_readings_have_the_errors_of_tape_scales_and_gauge(name):
    take, true, sigma = READINGS[name]
    b = prepared()
    off = (drawn(lambda: take(b)) - true) / sigma
    assert abs(off.mean()) < WITHIN
    assert off.std() == pytest.approx(1.0, abs=WITHIN)
    assert take(prepared()) == take(prepared()) != take(prepared(seed=2))


@pytest.mark.parametrize(
    ("gravity", "presses", "way"),
    [
        *[(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)],
        *[(1.0, 0.31, 1.0), (1.0, 0.29, 0.0), (-1.0, 0.31, -1.0), (-1.0, 0.29, 0.0), (1.0, 0.0, 0.0)],
        *[(1.0, 0.3, 0.0), (1.0, -0.3, 0.0)],
    ],
)
def test_simulated_operator_reads_if_the_platform_weight_compresses_or_pulls_the_legs(gravity, presses, way):
    assert bench(Wiring(gravity=gravity), STAND._replace(presses=presses)).do("read_way") == way
