"""The bench against closed-form solutions."""

import numpy as np
import pytest

from plant_fmu.bench import BRAKE_FORCE_N, Bench
from plant_fmu.config import BenchPlant

OPEN, CALM = np.zeros(6), np.zeros(6)


def bench(**values):
    return Bench(BenchPlant(type="bench", **values))


def test_spring_plant_leg_with_a_linear_spring_alone_moves_as_a_harmonic_oscillator():
    plant = bench(damping_N_s2_m2=0.0, stiffness_N_m3=0.0, mass_kg=200.0, stiffness_N_m=5000.0)
    f = np.array([100.0, -100.0, 50.0, 0.0, 10.0, 200.0])
    w = np.sqrt(5000.0 / 200.0)
    q, dq = plant.step(f, OPEN, CALM, 0.7)
    assert q - 1.6 == pytest.approx(f / 5000.0 * (1 - np.cos(w * 0.7)), abs=1e-12)
    assert dq == pytest.approx(f / 5000.0 * w * np.sin(w * 0.7), abs=1e-12)


def test_spring_plant_leg_comes_to_rest_where_its_springs_balance_the_force():
    plant = bench(damping_N_s2_m2=50_000.0)
    x = 0.2
    f = np.full(6, 5000.0 * x + 20_000.0 * x**3)
    for _ in range(400):
        q, _ = plant.step(f, OPEN, CALM, 0.05)
    # quadratic damping vanishes near rest: the amplitude decreases as 1/t
    assert q - 1.6 == pytest.approx(np.full(6, x), abs=5e-3)


def test_quadratic_damping_limits_the_leg_speed_to_sqrt_of_force_over_damping():
    # almost without damping: v = f t / m
    plant = bench(stiffness_N_m=0.0, stiffness_N_m3=0.0, mass_kg=100.0, damping_N_s2_m2=1e-9)
    _, dq = plant.step(np.full(6, 100.0), OPEN, CALM, 1.0)
    assert dq == pytest.approx(np.ones(6), rel=1e-9)
    moving = bench(stiffness_N_m=0.0, stiffness_N_m3=0.0, mass_kg=100.0, damping_N_s2_m2=50.0)
    # terminal speed under a constant force: f = b v^2
    _, dq = moving.step(np.full(6, 200.0), OPEN, CALM, 20.0)
    assert dq == pytest.approx(np.full(6, 2.0), rel=1e-6)


def test_a_brake_stops_a_leg_with_its_largest_force_and_then_holds():
    plant = bench(damping_N_s2_m2=0.0, stiffness_N_m=0.0, stiffness_N_m3=0.0, mass_kg=200.0)
    plant.step(np.full(6, 2000.0), OPEN, CALM, 0.1)  # v = 1 m/s
    q0, _ = plant.step(OPEN, OPEN, CALM, 1e-4)
    q1, dq = plant.step(OPEN, np.ones(6), CALM, 0.05)
    assert dq == pytest.approx(np.zeros(6), abs=1e-12)
    assert q1 - q0 == pytest.approx(np.full(6, 0.5 * 200.0 / BRAKE_FORCE_N), rel=0.02)
    q2, _ = plant.step(np.full(6, 0.99 * BRAKE_FORCE_N), np.ones(6), CALM, 0.05)
    assert q2 == pytest.approx(q1, abs=1e-12)
    q3, _ = plant.step(np.full(6, 1.01 * BRAKE_FORCE_N), np.ones(6), CALM, 0.05)
    assert (q3 > q2 + 1e-4).all()


def test_opposite_force_on_a_spring_plant_leg_gives_the_opposite_motion():
    """Damping and springs are odd functions: forced, springing back, and with brakes engaged."""
    force = np.array([500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16_000.0])
    ahead, back = bench(), bench()
    for k in range(100):
        f, brake = (force if k < 30 else OPEN), np.full(6, float(k > 80))
        q, dq = ahead.step(f, brake, CALM, 0.02)
        q_back, dq_back = back.step(-f, brake, CALM, 0.02)
        assert q_back - 1.6 == pytest.approx(1.6 - q, abs=1e-9)
        assert dq_back == pytest.approx(-dq, abs=1e-9)
        if k == 29:
            assert (q - 1.6).min() > 0.05


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_engaged_brake_holds_a_leg_against_its_springs(side):
    """At 0.3 m the cubic spring gives 6 N and the linear one 60 N: 0.3 % of the brake's largest force."""
    plant = bench(stiffness_N_m=200.0, stiffness_N_m3=220.0, damping_N_s2_m2=5000.0)
    plant.step(np.full(6, side * 2000.0), OPEN, CALM, 1.0)
    q, _ = plant.step(OPEN, np.ones(6), CALM, 0.05)
    assert (side * (q - 1.6) > 0.25).all()
    again, dq = plant.step(OPEN, np.ones(6), CALM, 0.5)
    assert np.abs(dq).max() < 1e-12
    np.testing.assert_allclose(again, q, rtol=0, atol=1e-12)
